"""The state of one run of a session: newest states, references, and the verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.event import PhaseWatch
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.fence import KnownRoom, box_excess_m, moved_excess_m
from ssp_core.safety.limits import (
    Continuity,
    LimitViolation,
    follow,
    has_stood,
    outside_geofence,
    state_contradicts,
)
from ssp_core.safety.start_heading import StartHeading, start_heading
from ssp_core.vocabulary import Phase, Verdict
from ssp_scenario_manager.dispatch.adaptation import Adaptations
from ssp_scenario_manager.dispatch.references import (
    ADAPTED,
    Address,
    PendingReferences,
    is_fatal,
)
from ssp_scenario_manager.session.limits import Violation, of_object
from ssp_scenario_manager.triggers.evaluator import TriggerWatch


def blind_text(limits: Limits) -> str:
    """Describe how far an object may drive before it knows that its link is cut."""
    return (
        f"blind distance on link loss: {limits.speed_mps * limits.heartbeat_s:.1f} m "
        f"({limits.speed_mps:g} m/s for {limits.heartbeat_s:g} s)"
    )


@dataclass
class Run:
    """The run's file and path, what was sent and answered, and what its watches remember."""

    spec: RunSpec
    path: Polyline
    started_ns: int | None = None
    references: dict[str, Reference] = field(default_factory=dict)
    answers: PendingReferences = field(default_factory=PendingReferences)
    adaptations: Adaptations = field(default_factory=Adaptations)
    watches: list[TriggerWatch] = field(default_factory=list)
    phase_watch: PhaseWatch = field(default_factory=PhaseWatch)
    phase_starts: dict[Phase, int] = field(default_factory=dict)
    armed: bool = False
    resolved_ns: int | None = None
    contact_ns: int | None = None  # of a driven VUT, the first one
    triggers_judged_ns: int = -1
    failed_trigger: Violation | None = None
    judged_ns: int = -1
    own_abort_ns: dict[str, int] = field(default_factory=dict)
    # Refusals of objects that had left RUNNING; their own word for that may be on its way.
    unexplained: dict[str, Violation] = field(default_factory=dict)
    sent: int = 0
    late_vut_states: int = 0
    verdict: Verdict = Verdict.NONE
    reasons: list[str] = field(default_factory=list)
    closed: bool = False
    continuity: dict[str, Continuity] = field(default_factory=dict)
    motion: dict[str, ConsistencyWatch] = field(default_factory=dict)
    headings: dict[str, StartHeading] = field(default_factory=dict)
    rooms: dict[str, KnownRoom] = field(default_factory=dict)
    _breaks: list[Violation] = field(default_factory=list)
    _blamed: set[tuple[SafetyCode, str]] = field(default_factory=set)
    _given: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        limits = self.spec.limits
        for one in (self.spec.vut, *self.spec.targets):
            self.motion[one.id] = ConsistencyWatch(Bounds.of(one.id, one.cls, limits))
            if (heading := start_heading(one, limits)) is not None:
                self.headings[one.id] = heading

    @cached_property
    def target_ids(self) -> frozenset[str]:
        """Ids of the object targets."""
        return frozenset(target.id for target in self.spec.targets)

    def elapsed_s(self, now_ns: int) -> float:
        """Return the session time since the start, 0 before it."""
        return 0.0 if self.started_ns is None else ns_to_seconds(now_ns - self.started_ns)

    @property
    def blind_text(self) -> str:
        """Return blind_text of this run."""
        return blind_text(self.spec.limits)

    # -- verdict -------------------------------------------------------------------------------

    def blame(self, violation: Violation) -> bool:
        """Take a limit that was passed as a reason of the verdict; the first one gives it.

        Returns:
            False when this limit of this object is a reason already.
        """
        if (violation.code, violation.object_id) in self._blamed:
            return False
        self._blamed.add((violation.code, violation.object_id))
        self.reason(violation.verdict, violation.text, violation.stamp_ns)
        return True

    def reason(self, verdict: Verdict, text: str, now_ns: int) -> None:
        """Add a reason with its time in the run; the verdict is that of the first.

        A person who aborts twice gives one reason, and what comes after the end gives none.
        """
        if self.closed or text in self._given:
            return
        self._given.add(text)
        if not self.reasons:
            self.verdict = verdict
        if self.started_ns is not None:
            text += f" at {ns_to_seconds(now_ns - self.started_ns):.2f} s"
        self.reasons.append(text)

    def close(self) -> None:
        """Close the run; it was valid if nothing spoke against it, and nothing will any more."""
        if self.verdict is Verdict.NONE:
            self.verdict = Verdict.VALID
        self.closed = True

    def end_early(self, requested_by: str, now_ns: int) -> None:
        """Note that a run that ends before its event is resolved isn't valid."""
        if self.resolved_ns is None:
            reached = self.phase_watch.phase.name.lower()
            text = f"stopped by {requested_by} before resolution, in {reached}"
            self.reason(Verdict.ABORTED, text, now_ns)

    # -- states --------------------------------------------------------------------------------

    def see(self, state: ObjectState) -> None:
        """Judge a state that arrived by those before it."""
        memory = self.continuity.get(state.object_id, Continuity())
        self.continuity[state.object_id], passed = follow(memory, state, self.spec.limits)
        if memory.before is not None and self.continuity[state.object_id].before is state:
            crossed = self._crossed_fence(memory.before, state)
            passed += [] if crossed is None else [crossed]
        found = []
        if passed:
            found = [of_object(p, state.object_id, state.stamp_ns) for p in passed]
        watch = self.motion.get(state.object_id)
        if watch is not None and state.is_finite:
            watch.see(state)
            if (contradicts := watch.contradiction) is not None:
                found.append(
                    of_object(
                        state_contradicts(watch),
                        state.object_id,
                        state.stamp_ns,
                        contradicts.text,
                    )
                )
            heading = self.headings.get(state.object_id)
            if heading is not None and self.started_ns is not None:
                turned = heading.see(state, stands=has_stood(state, watch))
                found.append(of_object(turned, state.object_id, state.stamp_ns))
        if found:
            self._breaks += [violation for violation in found if violation is not None]

    def _crossed_fence(self, before: ObjectState, state: ObjectState) -> LimitViolation | None:
        """Find the violation of an object that was outside between two states.

        Each state is judged itself.
        """
        moved_m = math.hypot(state.x_m - before.x_m, state.y_m - before.y_m)
        if self.is_well_inside(state, moved_m):
            return None
        excess_m = moved_excess_m(before.pose, state.box, self.spec.geofence)
        if excess_m > 0.0 and box_excess_m(state.box, self.spec.geofence) > 0.0:
            return None
        return outside_geofence(excess_m)

    def is_well_inside(self, state: ObjectState, moved_m: float = 0.0) -> bool:
        """Tell whether an object is known to be inside the fence, and so was on its way.

        Args:
            state: with finite values.
            moved_m: from where it was before.
        """
        room = self.rooms.get(state.object_id)
        if room is None:
            room = self.rooms[state.object_id] = KnownRoom(self.spec.geofence)
        return room.holds(state.x_m, state.y_m, state.size.reach_m + moved_m)

    @property
    def has_breaks(self) -> bool:
        """Tell whether a state doesn't follow from earlier ones; the next step ends the run."""
        return bool(self._breaks)

    def take_breaks(self) -> list[Violation]:
        """Take out what ``see`` has found since the last call, in an order of its own.

        States of one step arrive in any order; what is decided must not depend on it.
        """
        taken, self._breaks = self._breaks, []
        return sorted(taken, key=lambda v: (v.stamp_ns, v.object_id, v.code))

    # -- references ----------------------------------------------------------------------------

    def address(self, object_id: str, purpose: str, now_ns: int, lead_s: float) -> Address:
        """Return the address of the next reference."""
        self.sent += 1
        return Address(
            reference_id=f"{object_id}-{self.sent}",
            object_id=object_id,
            event_version=self.spec.event_version,
            purpose=purpose,
            dispatched_ns=now_ns,
            execute_at_ns=now_ns + seconds_to_ns(lead_s),
        )

    def send(self, reference: Reference) -> Reference:
        """Remember that an answer is due."""
        self.answers.expect(reference)
        return reference

    def send_again(self, now_ns: int) -> list[Reference]:
        """Return the references whose answer may have been lost, to be sent again."""
        return self.answers.again(now_ns, self.spec.step_s)

    def answer(
        self, reference_id: str, accepted: bool, code: int, message: str, now_ns: int
    ) -> Violation | None:
        """Take an object's answer to a reference: a refusal is a violation, a repeat is none.

        A refused adapted reference is none where the object can go on without it.
        """
        reference = self.answers.take(reference_id, accepted=accepted)
        if reference is None:
            return None
        if accepted:
            known = self.references.get(reference.object_id)
            if known is None or reference.dispatched_ns >= known.dispatched_ns:
                self.references[reference.object_id] = reference
        fatal = not accepted and is_fatal(reference, code)
        if reference.purpose == ADAPTED and not fatal:
            self.adaptations.answer(reference_id, accepted=accepted, message=message)
        if not fatal:
            return None
        return Violation(
            SafetyCode.REFERENCE_REFUSED, reference.object_id, float(code), 0.0, now_ns, message
        )
