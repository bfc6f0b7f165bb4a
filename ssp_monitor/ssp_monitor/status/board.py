"""The newest of everything that was heard of a session, as plain values, and how old each is.

This file owns what is known: a board begins empty and never begins anew; a source's newest word
replaces the one before, and a session that is loaded begins the run's own time anew.

Here and wherever a board is looked at, ``at_ns`` and ``now_ns`` are of this host's steady clock.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.object_rules import ReceivedRules
from ssp_core.safety.publishers import LINKS_FRESH_S
from ssp_core.vocabulary import Phase, SessionPhase, Verdict


@dataclass(frozen=True, slots=True)
class LatestState:
    """The newest state of one object.

    Args:
        at_ns: when it arrived, ns on this host's steady clock.
    """

    state: ObjectState
    at_ns: int


@dataclass(frozen=True, slots=True)
class SessionFact:
    """One transition of the session (SessionState.msg).

    Args:
        stamp_ns: session time.
        event: what caused it.
        run_id: of the loaded run, or empty.
        scenario: of the loaded run, or empty.
        verdict: none before the end.
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
class StateOnPage:
    """The session state that a page shows, which a press on it is meant for.

    Args:
        state: SessionState.STATE_*.
        since_ns: its stamp.
        made_ns: when what the page shows was made, on the steady clock of its server.
    """

    state: int
    since_ns: int
    made_ns: int

    def __str__(self) -> str:
        return f"{self.state}@{self.since_ns}@{self.made_ns}"

    @staticmethod
    def parse(text: object) -> StateOnPage:
        """Read what ``str`` gives. Raise ValueError for another text or value."""
        form = r"([1-9]\d?)@(\d{1,19})@(\d{1,19})"
        match = re.fullmatch(form, text) if isinstance(text, str) else None
        if match is None:
            raise ValueError("it doesn't say which state the page showed, and when")
        return StateOnPage(*map(int, match.groups()))


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
    """The recorder's facts on a topic that it lost messages of, or doesn't hear."""

    name: str
    lost: int
    dropped: int


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
    strangers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened, for the list of events.

    Args:
        kind: session, phase, trigger, safety, fault or refused.
        stamp_ns: session time.
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
    """The outcome of a command.

    Args:
        accepted: the manager does it.
        text: why not, or what it said.
        missing: everything that keeps the command from being accepted.
        answered: False: no answer came, so that nothing is known.
        state: of the session after it, where somebody answered.
    """

    accepted: bool
    text: str = ""
    missing: tuple[str, ...] = ()
    answered: bool = True
    state: str = ""


MOST_EVENTS = 120
# More objects than any session has; a stray publisher must not fill the memory.
MOST_OBJECTS = 500
# A stamp that is this much older is no straggler: the session, or a replay, has begun again.
_BEGUN_AGAIN_NS = 1_000_000_000
# The session's last states: everything stands.
OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)


T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class LatestReport(Generic[T]):
    """The newest word of one source.

    Args:
        at_ns: when it arrived; None: never.
    """

    value: T
    at_ns: int | None = None

    def age_s(self, now_ns: int) -> float:
        """Return how long ago it arrived; inf: never."""
        return age_s(now_ns, self.at_ns)


@dataclass(slots=True)
class ManagerStatus:
    """The manager's heartbeats: when the newest arrived, and what it says.

    Args:
        stamp_ns: session time.
        session_token: of the newest one that could be read; may be empty.
        strangers: those that it has found, which it says with its links.
    """

    at_ns: int | None = None
    stamp_ns: int | None = None
    session_token: str = ""
    strangers: LatestReport[tuple[str, ...]] = LatestReport(())

    def silent_s(self, now_ns: int) -> float:
        """Return the time since the newest heartbeat; inf: there was none."""
        return age_s(now_ns, self.at_ns)


@dataclass(slots=True)
class SessionStatus:
    """The session's newest transition, the event's phase, and the run's own time.

    Args:
        fact: None: no transition was heard.
        started_ns: session time at which the run began; None before it.
        ended_ns: session time of its end.
    """

    fact: SessionFact | None = None
    at_ns: int | None = None
    phase: Phase = Phase.UNKNOWN
    started_ns: int | None = None
    ended_ns: int | None = None

    @property
    def state(self) -> SessionPhase:
        """The state after the newest transition; UNKNOWN before the first."""
        return SessionPhase.UNKNOWN if self.fact is None else self.fact.state

    def hear(self, fact: SessionFact, at_ns: int) -> Event:
        """Take a transition, which begins or ends the run's own time; return it as an event."""
        before = self.fact
        self.fact, self.at_ns = fact, at_ns
        if fact.state in (SessionPhase.IDLE, SessionPhase.LOADED):
            self.started_ns = self.ended_ns = None
            self.phase = Phase.UNKNOWN
        elif fact.state is SessionPhase.RUNNING:
            self.started_ns, self.ended_ns = fact.stamp_ns, None
        elif fact.state in OVER and self.ended_ns is None:
            self.ended_ns = fact.stamp_ns
        was = before.state.name if before is not None else ""
        return Event(
            "session",
            fact.stamp_ns,
            f"{was} → {fact.state.name}" if was else fact.state.name,
            f"{fact.event}: {fact.reason}" if fact.reason else fact.event,
        )

    def elapsed_s(self, now_ns: int | None) -> float | None:
        """Return the session time since the start of the run, until its end; None before it.

        Args:
            now_ns: session time; None: unknown.
        """
        if self.started_ns is None:
            return None
        until_ns = self.ended_ns if self.ended_ns is not None else now_ns
        if until_ns is None or until_ns < self.started_ns:
            return 0.0
        return (until_ns - self.started_ns) / 1e9


class EventList:
    """The newest events, numbered from 1; iteration gives number and event, the oldest first.

    Attributes:
        count: how many there were; the oldest ones are forgotten when there are too many.
    """

    def __init__(self) -> None:
        self.count = 0
        self._events: deque[tuple[int, Event]] = deque(maxlen=MOST_EVENTS)

    def add(self, event: Event) -> None:
        """Add one more event."""
        self.count += 1
        self._events.append((self.count, event))

    def __iter__(self) -> Iterator[tuple[int, Event]]:
        return iter(self._events)

    def __reversed__(self) -> Iterator[tuple[int, Event]]:
        return reversed(self._events)


@dataclass(slots=True)
class Board:
    """Takes facts as they come. Every ``at_ns`` is ns on this host's steady clock.

    Args:
        vut_refused: why no state is made of the VUT's newest fix; empty: one is made.
        motion: what the run's participants state, held against their places.
        camera: what is wrong with its newest picture, and when the newest good one came.
        offered: commands whose services were found; None: they aren't looked for.
    """

    run: RunSpec | None = None
    objects: dict[str, LatestState] = field(default_factory=dict)
    session: SessionStatus = field(default_factory=SessionStatus)
    manager: ManagerStatus = field(default_factory=ManagerStatus)
    links: LatestReport[dict[str, LinkFact]] = field(default_factory=lambda: LatestReport({}))
    rules: ReceivedRules = field(default_factory=ReceivedRules)
    recorder: LatestReport[RecorderFact | None] = LatestReport(None)
    vut_refused: LatestReport[str] = LatestReport("")
    bodies: dict[str, tuple[BodyStatus, int]] = field(default_factory=dict)
    motion: dict[str, ConsistencyWatch] = field(default_factory=dict)
    camera: LatestReport[str] = LatestReport("")
    replay: bool = False
    offered: frozenset[str] | None = None
    events: EventList = field(default_factory=EventList)

    def __post_init__(self) -> None:
        if self.run is None:
            return
        for one in (self.run.vut, *self.run.targets):
            bounds = Bounds.of(one.id, one.cls, self.run.limits)
            self.motion[one.id] = ConsistencyWatch(bounds)

    def hear_states(self, states: Iterable[ObjectState], at_ns: int) -> None:
        """Take the newest states; one that was overtaken on its way is dropped."""
        for state in states:
            latest_state = self.objects.get(state.object_id)
            if latest_state is None and len(self.objects) >= MOST_OBJECTS:
                continue
            if latest_state is not None:
                back_ns = latest_state.state.stamp_ns - state.stamp_ns
                if at_ns < latest_state.at_ns or 0 < back_ns <= _BEGUN_AGAIN_NS:
                    continue
            self.objects[state.object_id] = LatestState(state, at_ns)
            watch = self.motion.get(state.object_id)
            if watch is not None and state.is_finite:
                watch.see(state)

    def hear_session(self, fact: SessionFact, at_ns: int) -> None:
        """Take a transition, which becomes an event."""
        self.events.add(self.session.hear(fact, at_ns))

    def hear_phase(self, phase: Phase, event: Event) -> None:
        """Take the beginning of a phase of the event."""
        self.session.phase = phase
        self.events.add(event)

    def hear_links(
        self, links: dict[str, LinkFact], at_ns: int, strangers: tuple[str, ...] = ()
    ) -> None:
        """Take the manager's measurements of all links, and the strangers that it has found."""
        self.links = LatestReport(links, at_ns)
        self.manager.strangers = LatestReport(strangers, at_ns)

    def hear_recorder(self, fact: RecorderFact, at_ns: int) -> None:
        """Take the recorder's report on itself."""
        self.recorder = LatestReport(fact, at_ns)

    def hear_localisation(self, reason: str, at_ns: int) -> None:
        """Take the reason why no state is made of the VUT's newest fix; empty: one is made."""
        self.vut_refused = LatestReport(reason, at_ns)

    def hear_body(self, status: BodyStatus, at_ns: int) -> None:
        """Take the report of a live object's process on its body (BodyStatus.msg)."""
        if status.object_id in self.bodies or len(self.bodies) < MOST_OBJECTS:
            self.bodies[status.object_id] = status, at_ns

    @property
    def elapsed_s(self) -> float | None:
        """Session time since the start of the run, None before it."""
        return self.session.elapsed_s(self.manager.stamp_ns)


@dataclass
class Newest:
    """The newest message of each source that wasn't taken yet; taking decodes and removes it.

    Args:
        decode: gives the states of a message; raises ValueError for bytes that are none.
    """

    decode: Callable[[bytes], Iterable[ObjectState]]
    _waiting: dict[str, tuple[bytes, int]] = field(default_factory=dict)

    def put(self, source: str, data: bytes, at_ns: int) -> None:
        """Keep a message with its time of arrival on the steady clock."""
        self._waiting[source] = (data, at_ns)

    def take(self) -> tuple[list[tuple[list[ObjectState], int]], list[str]]:
        """Return the messages since the last time, with times of arrival.

        The second list has the reasons why the others can't be read.
        """
        waiting, self._waiting = self._waiting, {}
        states, problems = [], []
        for source, (data, at_ns) in waiting.items():
            try:
                states.append((list(self.decode(data)), at_ns))
            except ValueError as error:
                problems.append(f"{source}: {error}")
        return states, problems


# Older than this, nothing of a source is told as if it were now.
STALE_S = 1.0
# Of a state, without a run file: as sites without a limit of their own have it.
DEFAULT_STATE_AGE_S = 0.3


def age_s(now_ns: int, at_ns: int | None) -> float:
    """Return how long ago something was heard; inf: never."""
    return math.inf if at_ns is None else max(0, now_ns - at_ns) / 1e9


def links_of(board: Board, now_ns: int) -> dict[str, LinkFact]:
    """Return the links as they are now; empty if the manager hasn't sent any lately."""
    return board.links.value if board.links.age_s(now_ns) <= LINKS_FRESH_S else {}


def object_age_s(board: Board, latest_state: LatestState, now_ns: int) -> float:
    """Return an object's age: the worst of what arrival, stamp and manager say of it.

    A state that was held up on its way arrives late and looks new by its arrival alone.
    """
    age = age_s(now_ns, latest_state.at_ns)
    manager = board.manager
    if manager.stamp_ns is not None and manager.silent_s(now_ns) <= STALE_S:
        age = max(age, (manager.stamp_ns - latest_state.state.stamp_ns) / 1e9)
    link = links_of(board, now_ns).get(latest_state.state.object_id)
    if link is not None and math.isfinite(link.state_age_s):
        age = max(age, link.state_age_s)
    return age
