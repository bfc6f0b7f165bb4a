"""The newest of everything that was heard: what a snapshot of the page is made of."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Phase, SessionPhase
from ssp_monitor.watch.facts import Event, Heard, LinkFact, RecorderFact, SessionFact

MOST_EVENTS = 120
# More objects than any session has; a stray publisher must not fill the memory.
MOST_OBJECTS = 500
# A stamp that is this much older is no straggler: the session, or a replay, has begun again.
_BEGUN_AGAIN_NS = 1_000_000_000
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED)


@dataclass
class Board:
    """Takes facts as they come. Every ``at_ns`` is ns on this host's steady clock.

    Args:
        run: the run file, where the page was given one.
        offered: commands whose services were found; None: nobody looks for them.
    """

    run: RunSpec | None = None
    objects: dict[str, Heard] = field(default_factory=dict)
    session: SessionFact | None = None
    session_at_ns: int | None = None
    phase: Phase = Phase.UNKNOWN
    manager_at_ns: int | None = None
    manager_stamp_ns: int | None = None
    started_ns: int | None = None
    ended_ns: int | None = None
    links: dict[str, LinkFact] = field(default_factory=dict)
    links_at_ns: int | None = None
    recorder: RecorderFact | None = None
    recorder_at_ns: int | None = None
    camera_at_ns: int | None = None
    camera_fault: str = ""
    replay: bool = False
    offered: frozenset[str] | None = None
    events: deque[tuple[int, Event]] = field(default_factory=lambda: deque(maxlen=MOST_EVENTS))
    events_seen: int = 0

    def hear_states(self, states: Iterable[ObjectState], at_ns: int) -> None:
        """Newest states; one that was overtaken on its way is dropped.

        Args:
            states: as they came.
            at_ns: when, steady clock.
        """
        for state in states:
            known = self.objects.get(state.object_id)
            if known is None and len(self.objects) >= MOST_OBJECTS:
                continue
            if known is not None:
                back_ns = known.state.stamp_ns - state.stamp_ns
                if at_ns < known.at_ns or 0 < back_ns <= _BEGUN_AGAIN_NS:
                    continue
            self.objects[state.object_id] = Heard(state, at_ns)

    def hear_session(self, fact: SessionFact, at_ns: int) -> None:
        """A transition; it also becomes an event, and begins or ends the run's own time."""
        before = self.session
        self.session, self.session_at_ns = fact, at_ns
        if fact.state in (SessionPhase.IDLE, SessionPhase.LOADED):
            self.started_ns = self.ended_ns = None
            self.phase = Phase.UNKNOWN
        elif fact.state is SessionPhase.RUNNING:
            self.started_ns, self.ended_ns = fact.stamp_ns, None
        elif fact.state in _OVER and self.ended_ns is None:
            self.ended_ns = fact.stamp_ns
        was = before.state.name if before is not None else ""
        self.tell(
            Event(
                "session",
                fact.stamp_ns,
                f"{was} → {fact.state.name}" if was else fact.state.name,
                f"{fact.event}: {fact.reason}" if fact.reason else fact.event,
            )
        )

    def hear_phase(self, phase: Phase, event: Event) -> None:
        """The beginning of a phase of the event."""
        self.phase = phase
        self.tell(event)

    def hear_links(self, links: dict[str, LinkFact], at_ns: int) -> None:
        self.links, self.links_at_ns = links, at_ns

    def hear_recorder(self, fact: RecorderFact, at_ns: int) -> None:
        self.recorder, self.recorder_at_ns = fact, at_ns

    def tell(self, event: Event) -> None:
        """One more event; the oldest one is forgotten when there are too many."""
        self.events_seen += 1
        self.events.append((self.events_seen, event))

    @property
    def elapsed_s(self) -> float | None:
        """Session time since the start of the run, None before it."""
        if self.started_ns is None:
            return None
        until_ns = self.ended_ns if self.ended_ns is not None else self.manager_stamp_ns
        if until_ns is None or until_ns < self.started_ns:
            return 0.0
        return (until_ns - self.started_ns) / 1e9
