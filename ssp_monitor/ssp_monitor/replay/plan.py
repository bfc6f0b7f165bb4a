"""Which topics of a bag are published, as what, and which are left out and why."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from ssp_core import names
from ssp_core.bag.reader import TopicInfo
from ssp_core.errors import InputError
from ssp_monitor.core.pattern import Pattern
from ssp_monitor.core.topics import CLOCK_TYPE
from ssp_monitor.replay.commands import is_command, is_command_name
from ssp_monitor.replay.offer import Offer, offer_of

DEFAULT_CLOCK_HZ = 100.0
FRAME_TYPES = frozenset(
    (
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "foxglove_msgs/msg/CompressedVideo",
    )
)
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+\Z")
_MOST_NAME = 246  # what the middleware takes
# Says why a type can't be published here, with the hash that the bag has for it; None: it can.
Missing = Callable[[str, str], str | None]


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a person asked for.

    Args:
        topics: names or expressions; empty: all.
        exclude: names or expressions.
        remap: recorded name to the name to publish under.
        commands: topics that may move objects too.
        clock_hz: of a /clock that is made here; 0: none is; None: only where none is recorded.
        strict: a topic that can't be published is an error.
    """

    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    remap: Mapping[str, str] | None = None
    commands: bool = False
    clock_hz: float | None = None
    strict: bool = False


@dataclass(frozen=True, slots=True)
class Line:
    """One topic that is published.

    Args:
        recorded: its name in the bag.
        topic: its name now.
    """

    recorded: str
    topic: str
    msgtype: str
    offer: Offer
    count: int


@dataclass(frozen=True, slots=True)
class LeftOut:
    """One topic that was wanted, or not unwanted, and isn't published."""

    topic: str
    count: int
    why: str
    is_command: bool = False


@dataclass(frozen=True, slots=True)
class Plan:
    """What is published.

    Args:
        clock_hz: of a /clock that is made here; 0: the recorded one, or none.
        clock_recorded: the bag's own /clock is among the lines.
    """

    lines: tuple[Line, ...]
    left_out: tuple[LeftOut, ...]
    clock_hz: float
    clock_recorded: bool

    @property
    def frames(self) -> frozenset[str]:
        """Recorded names of topics with camera frames."""
        return frozenset(line.recorded for line in self.lines if line.msgtype in FRAME_TYPES)


def make_plan(recorded: Mapping[str, TopicInfo], wishes: Wishes, missing: Missing) -> Plan:
    """The plan for a bag's topics.

    Raises:
        InputError: a wish names nothing in the bag, nothing is left, or, if strict, a topic can't
            be published.
    """
    remap = _remapped(recorded, wishes.remap or {})
    wanted = _matching(recorded, wishes.topics, "--topics") if wishes.topics else set(recorded)
    wanted -= _matching(recorded, wishes.exclude, "--exclude")
    if not wanted:
        raise InputError("names no topic that is left", field="--topics and --exclude")
    lines, left_out = [], []
    for name in sorted(wanted):
        info, topic = recorded[name], remap.get(name, name)
        if topic == names.CLOCK and wishes.clock_hz is not None:
            continue
        # A new name could make a command of what was none, whatever its type.
        renamed = topic != name and is_command_name(topic)
        command = is_command(name, info.msgtype) or renamed
        if command and not wishes.commands:
            left_out.append(LeftOut(name, info.count, "may move objects", is_command=True))
        elif (why := _obstacle(topic, info, missing)) is not None:
            left_out.append(LeftOut(name, info.count, why))
        else:
            offer = offer_of(name, info.offered_qos)
            lines.append(Line(name, topic, info.msgtype, offer, info.count))
    _check(lines, left_out, wishes)
    clock_recorded = any(line.topic == names.CLOCK for line in lines)
    clock_hz = DEFAULT_CLOCK_HZ if wishes.clock_hz is None else wishes.clock_hz
    return Plan(tuple(lines), tuple(left_out), 0.0 if clock_recorded else clock_hz, clock_recorded)


def _matching(recorded: Mapping[str, TopicInfo], wishes: tuple[str, ...], field: str) -> set[str]:
    """Topics that are named or, where a wish is no topic's name, in whose names it is found."""
    found: set[str] = set()
    for wish in wishes:
        exact = {name for name in (wish, names.absolute(wish)) if name in recorded}
        if not exact:
            pattern = Pattern(wish, field)
            exact = {name for name in recorded if pattern.found_in(name)}
        if not exact:
            some = ", ".join(sorted(recorded)[:6])
            raise InputError(
                "is found in no topic of the bag",
                field=field,
                value=wish,
                remedy=f"it has {some}{', ...' if len(recorded) > 6 else ''}",
            )
        found |= exact
    return found


def _remapped(recorded: Mapping[str, TopicInfo], remap: Mapping[str, str]) -> dict[str, str]:
    found = {}
    for wish, topic in remap.items():
        name = wish if wish in recorded else names.absolute(wish)
        if name not in recorded:
            raise InputError("is no topic of the bag", field="--remap", value=wish)
        if not is_name(names.absolute(topic)):
            raise InputError("is no topic name", field="--remap", value=topic)
        found[name] = names.absolute(topic)
    return found


def is_name(topic: str) -> bool:
    """Whether the middleware takes it as the absolute name of a topic."""
    return len(topic) <= _MOST_NAME and _NAME.match(topic) is not None


def _obstacle(topic: str, info: TopicInfo, missing: Missing) -> str | None:
    if not is_name(topic):
        return "is no name of a ROS topic; --remap gives it another"
    if topic == names.CLOCK and info.msgtype != CLOCK_TYPE:
        return f"has the type {info.msgtype}, which is none for /clock"
    return missing(info.msgtype, info.type_hash)


def _check(lines: list[Line], left_out: list[LeftOut], wishes: Wishes) -> None:
    unable = [one for one in left_out if not one.is_command]
    if wishes.strict and unable:
        raise InputError(
            "can't be published: " + "; ".join(f"{one.topic} {one.why}" for one in unable),
            field="--strict",
        )
    kinds: dict[str, str] = {}
    for line in lines:
        if kinds.setdefault(line.topic, line.msgtype) != line.msgtype:
            raise InputError(
                f"gives {line.topic} two types, {kinds[line.topic]} and {line.msgtype}",
                field="--remap",
            )
    if not lines:
        raise InputError(
            "leaves nothing to publish: "
            + "; ".join(f"{one.topic} {one.why}" for one in left_out[:5]),
            field="bag",
            remedy="--commands publishes also what may move objects"
            if any(one.is_command for one in left_out)
            else None,
        )
