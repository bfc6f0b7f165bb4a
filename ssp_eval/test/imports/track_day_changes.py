"""A track day's messages changed: other clocks, units, places and frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from foreign_recordings import Message, TrackDay, header, pose

from ssp_core.cli import main

OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")
DECLARED = (
    "--domain",
    "physical",
    "--declared-by",
    "A. Engineer",
    "--declared-on",
    "2026-03-01",
    "--place",
    "north track",
)


def run(bag: Path, out: Path, *options: object) -> int:
    return main(["import-bag", str(bag), *OBJECTS, *map(str, options), "--out", str(out)])


def messages_of(day: TrackDay, change: Callable[[Message], Message | None]) -> list[Message]:
    """The day's messages, each changed or left out."""
    return [new for m in day.messages() if (new := change(m)) is not None]


def restamped(shift_ns: Callable[[int], int], topic: str) -> Callable[[Message], Message]:
    """Another clock on one topic: a shift by the time since the day began."""

    def change(m: Message) -> Message:
        if m[0] != topic:
            return m
        ns = m[3].header.stamp.sec * 10**9 + m[3].header.stamp.nanosec
        began_ns = 1_700_000_000 * 10**9
        head = header(ns + shift_ns(ns - began_ns), m[3].header.frame_id)
        return (m[0], m[1], m[2], replace(m[3], header=head))

    return change


def twisted(factor: float) -> Callable[[Message], Message]:
    """The object's speeds in another unit."""

    def change(m: Message) -> Message:
        if m[0] != "/ot1/odom":
            return m
        twist = m[3].twist.twist
        linear = replace(twist.linear, x=twist.linear.x * factor)
        return (
            *m[:3],
            replace(m[3], twist=replace(m[3].twist, twist=replace(twist, linear=linear))),
        )

    return change


def moved(
    place: Callable[[float, float, float], tuple[float, float, float]],
) -> Callable[[Message], Message]:
    """The object's poses (x, y, yaw) changed."""

    def change(m: Message) -> Message:
        if m[0] != "/ot1/odom":
            return m
        p = m[3].pose.pose
        x, y, yaw = place(
            p.position.x, p.position.y, 2 * math.atan2(p.orientation.z, p.orientation.w)
        )
        return (*m[:3], replace(m[3], pose=replace(m[3].pose, pose=pose(x, y, yaw))))

    return change


def framed(frame_id: str) -> Callable[[Message], Message]:
    def change(m: Message) -> Message:
        if m[0] != "/ot1/odom":
            return m
        return (*m[:3], replace(m[3], header=replace(m[3].header, frame_id=frame_id)))

    return change


def once_back(m: Message) -> Message:
    """One stamp of the VUT's lies half a second early."""
    at_ns = 1_700_000_005 * 10**9
    return (
        restamped(lambda t: -500_000_000 if t == 5 * 10**9 else 0, "/vut/odom")(m)
        if m[2] > at_ns
        else m
    )


def for_a_while(change: Callable[[Message], Message]) -> Callable[[Message], Message]:
    """A change of the messages from 5.0 to 6.2 s."""
    since_ns, until_ns = (1_700_000_000 * 10**9 + round(s * 1e9) for s in (5.0, 6.2))
    return lambda m: change(m) if since_ns <= m[2] < until_ns else m


def of_all(topics: Sequence[str], shift_ns: Callable[[int], int]) -> Callable[[Message], Message]:
    """Another time on several topics, by stamp and by receipt."""

    def change(m: Message) -> Message:
        if m[0] not in topics:
            return m
        by_ns = shift_ns(m[2] - 1_700_000_000 * 10**9)
        topic, kind, ns, message = restamped(lambda _: by_ns, m[0])(m)
        return topic, kind, ns + by_ns, message

    return change
