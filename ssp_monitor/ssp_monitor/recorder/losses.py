"""Counts messages that were published and never arrived, by sequences and publishers' counts."""

from __future__ import annotations

from collections.abc import Mapping, Set
from contextlib import suppress
from dataclasses import dataclass, field

from rosbags.interfaces import Nodetype

from ssp_core import names
from ssp_core.bag.types import typestore
from ssp_core.cdr.codec import START
from ssp_core.cdr.messages import leading_stamp_ns
from ssp_core.cdr.steps import decode_heartbeat, decode_tick_head
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.transforms import TF_TYPE

# A warning names so many topics.
MOST_NAMED = 5


@dataclass(slots=True)
class Arrivals:
    """The arrivals of one topic, by publisher, and what is missing.

    What a publisher sent before its first message that arrived is no loss: it may have been sent
    before anybody listened.

    Args:
        gaps: messages missing between two that arrived.
        middleware_losses: messages that the middleware says it could not deliver.
        behind: messages missing behind the last one that arrived.
        returned: how often a publisher spoke again after another one had; of one that ended and
            one that took its place it is never.
    """

    received: int = 0
    gaps: int = 0
    middleware_losses: int = 0
    behind: int = 0
    returned: int = 0
    _newest: bytes = b""
    _last: dict[bytes, int] = field(default_factory=dict)

    @property
    def lost(self) -> int:
        return max(self.gaps, self.middleware_losses) + self.behind

    @property
    def publishers(self) -> int:
        """Count the different publishers that were heard."""
        return len(self._last)

    def note(self, publisher: bytes, sequence: int) -> int:
        """Note a message that arrived and return how many are missing right before it.

        Args:
            publisher: what tells its publisher from others; a restarted one is another.
            sequence: the publisher's number for it, 0 where there is none; one that is not above
                the last one comes from a count that started over.
        """
        self.received += 1
        if not sequence:
            return 0
        last = self._last.get(publisher)
        self._last[publisher] = sequence
        if publisher != self._newest:
            self.returned += last is not None
            self._newest = publisher
        if last is None or sequence <= last + 1:
            return 0
        missing = sequence - last - 1
        self.gaps += missing
        return missing

    def claimed(self, sent: int) -> None:
        """Note at the end that the topic's publisher claims to have sent at least so many.

        With several publishers it proves nothing, since the claim is one publisher's; with none
        heard, since it may have been sent before anybody listened.
        """
        if len(self._last) == 1:
            (last,) = self._last.values()
            self.behind = max(0, sent - last)


# What comes now and then while a session waits is no loss once nothing more was for so long.
SETTLED_S = 2.0


class LossesOfRun:
    """Leaves out what was lost while a session waited, which may be for hours on a busy machine.

    What is still being lost counts: with it nothing may be armed. From arming on all counts, and
    for good once the run has begun. Reads no clock.
    """

    def __init__(self) -> None:
        self.before = 0
        self._total = 0
        self._changed_s = 0.0
        self._waits = True
        self._ran = False

    def session_is(self, state: SessionPhase) -> None:
        """Take the session's state."""
        self._ran |= state is SessionPhase.RUNNING
        self._waits = state < SessionPhase.ARMED and not self._ran

    def look(self, total: int, now_s: float) -> None:
        """Take all messages lost so far, as often as the recorder tells of itself."""
        if total != self._total:
            self._total, self._changed_s = total, now_s
        if self._waits and now_s - self._changed_s >= SETTLED_S:
            self.before = total

    def of(self, total: int) -> int:
        """Return the run's share of all messages lost so far."""
        return max(0, total - self.before)


class RivalWatch:
    """Finds topics with one publisher on which two speak in turn, while a session is under way.

    Args:
        alone: names of topics that have one publisher.
    """

    def __init__(self, alone: Set[str]) -> None:
        self._alone = alone
        self._before: Mapping[str, int] | None = None
        self._rivals: set[str] = set()

    def begin(self, returned: Mapping[str, int]) -> None:
        """Begin to watch a session that is armed; what came before is of earlier publishers."""
        if self._before is None:
            self._before = returned

    @property
    def is_on(self) -> bool:
        """Tell whether a session is under way."""
        return self._before is not None

    def end(self) -> None:
        """Stop watching, once the session is over; later publishers say nothing of it."""
        self._before = None

    def look(self, returned: Mapping[str, int]) -> tuple[str, ...]:
        """Return all topics that were found by now, as sentences.

        Args:
            returned: by topic, as Arrivals counts.
        """
        before = self._before
        if before is not None:
            self._rivals |= {
                name
                for name, count in returned.items()
                if name in self._alone and count > before.get(name, 0)
            }
        return tuple(
            f"{name} has messages of two publishers in turn" for name in sorted(self._rivals)
        )


def losses_beside(counts: Mapping[str, int], own: Set[str]) -> list[str]:
    """Describe losses that don't make a run invalid, so that nothing else tells of them.

    Args:
        counts: messages that are missing, by topic.
        own: the run's topics; without any, all topics must be complete, and there is no sentence.
    """
    others = {name: n for name, n in sorted(counts.items()) if n and name not in own}
    if not own or not others:
        return []
    some = ", ".join(list(others)[:MOST_NAMED]) + (", ..." if len(others) > MOST_NAMED else "")
    return [f"{sum(others.values())} messages of topics beside the run's are missing: {some}"]


TICK, HEARTBEAT = names.absolute(names.WORLD_TICK), names.absolute(names.HEARTBEAT)
SOURCES = frozenset({TICK, HEARTBEAT})


def claims(last: Mapping[str, bytes]) -> dict[str, int]:
    """Return by topic how many messages its publisher has sent at the least.

    The world doesn't count the states of the VUT that it repeats before a run, so that its number
    may be lower than the truth; it is never higher.

    Args:
        last: the last message of each topic of SOURCES that has one. One that can't be read says
            nothing.
    """
    sent: dict[str, int] = {}
    with suppress(KeyError, ValueError):
        states = decode_tick_head(last[TICK]).vut_states_sent
        sent[names.absolute(names.state_topic(names.VUT_ID))] = states
    with suppress(KeyError, ValueError):
        for object_id, references in decode_heartbeat(last[HEARTBEAT]).references_sent.items():
            sent[names.absolute(names.reference_topic(object_id))] = references
    return sent


_STAMPED = ("std_msgs/msg/Header", "builtin_interfaces/msg/Time")


def stamp_at(msgtype: str) -> int | None:
    """Find the first stamp of a message of this type; None: it doesn't begin with one.

    A Header or a bare Time stands behind the encapsulation, that of a first transform behind their
    number.

    Raises:
        KeyError: the type is not known.
    """
    if msgtype == TF_TYPE:
        return START + 4
    fields = typestore().fielddefs[msgtype][1]
    if not fields:
        return None
    kind, what = fields[0][1]
    return START if kind == Nodetype.NAME and what in _STAMPED else None


@dataclass(slots=True)
class SimulatedTime:
    """Gives each message of a simulated session its time: its own stamp, or the newest one seen.

    The newest stamp, not that of /clock, so that the result doesn't depend on the order in which
    two topics happen to be read.
    """

    newest_ns: int = 0

    def of(self, cdr: bytes, at: int | None) -> int:
        """Return the time of a message, ns."""
        stamp_ns = None if at is None else leading_stamp_ns(cdr, at)
        if stamp_ns is None:
            return self.newest_ns
        self.newest_ns = max(self.newest_ns, stamp_ns)
        return stamp_ns
