"""What the page hears, as plain values: the messages of a session without ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import SessionPhase, Verdict


@dataclass(frozen=True, slots=True)
class Heard:
    """The newest state of one object.

    Args:
        state: as its source sent it.
        at_ns: when it arrived, ns on this host's steady clock.
    """

    state: ObjectState
    at_ns: int


@dataclass(frozen=True, slots=True)
class SessionFact:
    """One transition of the session (SessionState.msg).

    Args:
        stamp_ns: session time.
        state: after it.
        event: what caused it.
        reason: for people.
        run_id: of the loaded run, or empty.
        scenario: of the loaded run, or empty.
        verdict: none before the end.
        reasons: of the verdict.
    """

    stamp_ns: int
    state: SessionPhase
    event: str = ""
    reason: str = ""
    run_id: str = ""
    scenario: str = ""
    verdict: Verdict = Verdict.NONE
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LinkFact:
    """One object's link as the manager measures it (LinkStatus.msg); NaN: not measured."""

    offset_s: float = math.nan
    delay_s: float = math.nan
    state_age_s: float = math.nan
    received: int = 0
    lost: int = 0


@dataclass(frozen=True, slots=True)
class TopicFact:
    """What the recorder has of a topic that it lost something of, or doesn't hear."""

    name: str
    messages: int
    lost: int
    dropped: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class RecorderFact:
    """The recorder's word about itself (RecorderStatus.msg)."""

    ready: bool
    bag: str = ""
    failure: str = ""
    messages: int = 0
    bytes: int = 0
    lost: int = 0
    dropped: int = 0
    missing: tuple[str, ...] = ()
    files: int = 1
    queue_bytes: int = 0
    queue_limit_bytes: int = 0
    free_bytes: int = 0
    write_bytes_per_s: float = 0.0
    disk_left_s: float = math.inf
    flush_age_s: float = 0.0
    warnings: tuple[str, ...] = ()
    topics: tuple[TopicFact, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for the list of events.

    Args:
        kind: session, phase, trigger, safety, fault or refused.
        stamp_ns: session time.
        title: in few words.
        text: more of it, may be empty.
        object_id: whom it is about, may be empty.
        measured: NaN where nothing was measured.
        limit: NaN where there is none.
        unit: of both.
    """

    kind: str
    stamp_ns: int
    title: str
    text: str = ""
    object_id: str = ""
    measured: float = math.nan
    limit: float = math.nan
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a command.

    Args:
        accepted: the manager does it.
        text: why not, or what it said.
        missing: everything that keeps the command from being accepted.
        answered: False: nobody answered, so that nothing is known.
        state: of the session after it, where somebody answered.
    """

    accepted: bool
    text: str = ""
    missing: tuple[str, ...] = ()
    answered: bool = True
    state: str = ""
