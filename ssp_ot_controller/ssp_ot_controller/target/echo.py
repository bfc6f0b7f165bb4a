"""Answers to heartbeats, by which the manager measures clocks and links (HeartbeatReply.msg).

They are on the system clock, outside the steps: an object whose link is disturbed answers as late
as its messages would be, and stamps with the clock that it would have.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.run_file.model import RunSpec
from ssp_ot_controller.sil.disturbance import LinkSizes

# In lockstep a manager may beat a thousand times a second; more answers would measure nothing more.
_PERIOD_S = 0.01


@dataclass(frozen=True, slots=True)
class Reply:
    """One answer; fields as in HeartbeatReply.msg.

    Args:
        sequence: of the heartbeat.
        object_ids: that it is given for, sorted.
        sent_ns: when the heartbeat was sent, on the manager's clock.
        received_ns: when it came, on the objects' clock.
        replied_ns: when the answer leaves, on the objects' clock; None: now.
        offset_ns: of the objects' clock, for an answer that leaves now.
    """

    sequence: int
    object_ids: tuple[str, ...]
    sent_ns: int
    received_ns: int
    replied_ns: int | None
    offset_ns: int = 0


class Echo:
    """Answers of one process, and those that are still under way. Reads no clock."""

    def __init__(self) -> None:
        self._answered_ns: int | None = None
        self._under_way: deque[tuple[int, Reply]] = deque()

    def on_heartbeat(
        self,
        sequence: int,
        sent_ns: int,
        links: Mapping[str, LinkSizes],
        system_ns: int,
        steady_ns: int,
    ) -> list[Reply]:
        """The answers that leave at once; others are handed out by ``due``.

        Args:
            sequence: of the heartbeat.
            sent_ns: when it was sent, on the manager's clock.
            links: clock and delays of each object.
            system_ns: when it came, on this machine's clock.
            steady_ns: the same on the steady clock.
        """
        if self._answered_ns is not None and steady_ns - self._answered_ns < seconds_to_ns(
            _PERIOD_S
        ):
            return []
        self._answered_ns = steady_ns
        groups: dict[LinkSizes, list[str]] = {}
        for object_id, link in sorted(links.items()):
            groups.setdefault(link, []).append(object_id)
        at_once = []
        for link, ids in groups.items():
            if link.cut:
                continue
            offset_ns = seconds_to_ns(link.clock_offset_s)
            received_ns = system_ns + seconds_to_ns(link.down_s) + offset_ns
            late_ns = seconds_to_ns(link.down_s) + seconds_to_ns(link.up_s)
            reply = Reply(
                sequence,
                tuple(ids),
                sent_ns,
                received_ns,
                received_ns if late_ns else None,
                offset_ns,
            )
            if late_ns:
                self._under_way.append((steady_ns + late_ns, reply))
            else:
                at_once.append(reply)
        return at_once

    def due(self, steady_ns: int) -> list[Reply]:
        """Answers that arrive by now, in the order in which they were given."""
        arrived = [reply for due_ns, reply in self._under_way if due_ns <= steady_ns]
        if arrived:
            self._under_way = deque(entry for entry in self._under_way if entry[0] > steady_ns)
        return arrived


def answers_late(run: RunSpec, object_ids: Iterable[str]) -> bool:
    """True when the run delays messages of one of these objects at any time."""
    links = [run.disturbance_of(object_id) for object_id in object_ids]
    delayed = any(link.state_delay_s or link.command_delay_s for link in links)
    return delayed or any(fault.kind == "link_delay" for fault in run.faults)
