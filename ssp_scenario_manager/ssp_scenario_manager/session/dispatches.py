"""The references of one run: numbered, sent, sent again, and answered.

This file owns which references are due and which were accepted; ``dispatch.references`` makes them.
Reads no clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Hold, TriggerSpec
from ssp_core.safety.codes import SafetyCode
from ssp_scenario_manager.dispatch import references
from ssp_scenario_manager.dispatch.adaptation import Adaptations, AdaptedManoeuvre
from ssp_scenario_manager.dispatch.planned_motion import Pace, play
from ssp_scenario_manager.dispatch.references import (
    ADAPTED,
    Address,
    PendingReferences,
    is_fatal,
)
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.triggers.evaluator import Firing


class CannotFire(Exception):
    """The reason why a trigger that fired can't send what it should."""


class Dispatches:
    """The references that a run has sent, and what came of them.

    Attributes:
        adaptations: of the manoeuvres that were dispatched.
    """

    def __init__(self, spec: RunSpec) -> None:
        self.adaptations = Adaptations()
        self._spec = spec
        self._sent = 0
        self._pending = PendingReferences()
        self._accepted: dict[str, Reference] = {}  # the newest one of each object

    @property
    def due(self) -> tuple[Reference, ...]:
        """List the references that haven't been answered, in the order of dispatch."""
        return self._pending.due

    def approaches(self, now_ns: int) -> list[Reference]:
        """Send all objects on their approach; one without an approach stands."""
        sent = []
        for target in self._spec.targets:
            if target.approach is not None:
                address = self._address(target.id, "approach", now_ns, references.APPROACH_LEAD_S)
                sent.append(self._send(references.approach_reference(address, target.approach)))
        return sent

    def fire(
        self,
        trigger: TriggerSpec,
        firing: Firing,
        targets: Mapping[str, ObjectState],
        now_ns: int,
    ) -> list[outbox.Outgoing]:
        """Return the reference that a trigger sends, if any, and its decision record.

        Raises:
            CannotFire: the object was never heard, states no numbers, or can't drive the manoeuvre
                from where it is.
        """
        target = next(t for t in self._spec.targets if t.id == trigger.object_id)
        if target.id not in targets:
            raise CannotFire(f"{target.id} was never heard")
        record = outbox.TriggerDecision(
            stamp_ns=firing.fired_ns,
            trigger_id=trigger.id,
            condition=firing.condition,
            threshold=firing.threshold,
            samples=firing.samples,
            crossing_ns=firing.crossing_ns,
            dispatched_ns=now_ns,
            object_ids=(),
            reference_ids=(),
        )
        if isinstance(trigger.manoeuvre, Hold):
            return [record]
        address = self._address(target.id, "manoeuvre", now_ns, trigger.lead_time_s)
        current = self._accepted.get(target.id)
        state = None
        if current is None:  # looked up only where it is needed: it may have to be decoded first
            if not targets[target.id].is_finite:
                raise CannotFire(f"{target.id} states no finite position or motion")
            state = targets[target.id].extrapolated(firing.fired_ns)
        try:
            reference = references.manoeuvre_reference(
                address, trigger.manoeuvre, state, current, target.approach
            )
        except ValueError as error:
            raise CannotFire(f"its manoeuvre can't be driven: {error}") from error
        self._send(reference)
        self.adaptations.fire(trigger, reference, current)
        sent = replace(
            record, object_ids=(reference.object_id,), reference_ids=(reference.reference_id,)
        )
        return [reference, sent]

    def adapt(self, adapted: AdaptedManoeuvre, pace: Pace, now_ns: int) -> Reference:
        """Send a manoeuvre that goes on at another pace."""
        lead_s = ns_to_seconds(pace.start_ns - now_ns)
        address = self._address(adapted.target.id, ADAPTED, now_ns, lead_s)
        points = play(adapted.planned_motion.columns, pace)
        self.adaptations.send(address.reference_id, adapted, pace)
        return self._send(references.reference(address, points))

    def send_again(self, now_ns: int) -> list[Reference]:
        """Return the references whose answer may have been lost, to be sent again."""
        return self._pending.again(now_ns, self._spec.step_s)

    def answer(
        self, reference_id: str, accepted: bool, code: int, message: str, now_ns: int
    ) -> Violation | None:
        """Take an object's answer to a reference: a refusal is a violation, a repeat is none.

        A refused adapted reference is none where the object can go on without it.
        """
        reference = self._pending.take(reference_id, accepted=accepted)
        if reference is None:
            return None
        if accepted:
            last_reference = self._accepted.get(reference.object_id)
            if last_reference is None or reference.dispatched_ns >= last_reference.dispatched_ns:
                self._accepted[reference.object_id] = reference
        fatal = not accepted and is_fatal(reference, code)
        if reference.purpose == ADAPTED and not fatal:
            self.adaptations.answer(reference_id, accepted=accepted, message=message)
        if not fatal:
            return None
        return Violation(
            SafetyCode.REFERENCE_REFUSED, reference.object_id, float(code), 0.0, now_ns, message
        )

    def _address(self, object_id: str, purpose: str, now_ns: int, lead_s: float) -> Address:
        self._sent += 1
        return Address(
            reference_id=f"{object_id}-{self._sent}",
            object_id=object_id,
            event_version=self._spec.event_version,
            purpose=purpose,
            dispatched_ns=now_ns,
            execute_at_ns=now_ns + seconds_to_ns(lead_s),
        )

    def _send(self, reference: Reference) -> Reference:
        """Remember that an answer is due."""
        self._pending.expect(reference)
        return reference
