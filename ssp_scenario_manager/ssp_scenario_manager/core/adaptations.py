"""The manoeuvres of a run that are being adapted, from their dispatch to their end."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Adaptation, TriggerSpec
from ssp_scenario_manager.core.adapt import Adapting, Decision, answered, begin, decide
from ssp_scenario_manager.core.adapt_bounds import Bounds
from ssp_scenario_manager.core.pace import Pace
from ssp_scenario_manager.core.routine import routine_of

# So many refusals in a row, and the link is too slow for adapting.
MOST_REFUSED = 3
# The longest time between dispatch and execute_at of an adapted reference.
MOST_LEAD_S = 0.4


@dataclass(frozen=True, slots=True)
class Fired:
    """A trigger whose manoeuvre is to be adapted.

    Args:
        trigger: with an adaptation.
        manoeuvre: that was dispatched.
        before: the reference that the object drove then; None: it stood.
    """

    trigger: TriggerSpec
    manoeuvre: Reference
    before: Reference | None


@dataclass(frozen=True, slots=True)
class Wish:
    """A decision about one manoeuvre."""

    fired: Fired
    adaptation: Adaptation
    decision: Decision


class Adaptations:
    """What is remembered of them; the deciding is in ``adapt``."""

    def __init__(self) -> None:
        self._fired: dict[str, Fired] = {}
        self._going_on: dict[str, Adapting] = {}
        self._sent: dict[str, tuple[str, Pace]] = {}
        self._notes: list[str] = []

    def fire(self, trigger: TriggerSpec, manoeuvre: Reference, before: Reference | None) -> None:
        """A manoeuvre is dispatched; one without an adaptation is let be."""
        if trigger.adaptation is not None:
            self._fired[trigger.id] = Fired(trigger, manoeuvre, before)

    def judge(self, spec: RunSpec, path: Polyline, vut: ObjectState, now_ns: int) -> list[Wish]:
        """Judges every manoeuvre on a state of the VUT, in the order in which they fired."""
        wishes = []
        for fired in list(self._fired.values()):
            wish = fired.trigger.adaptation
            if fired.manoeuvre.dispatched_ns == now_ns:
                continue  # It is on its way out; nothing may hold it up.
            known = self._known(fired, spec, path, vut.stamp_ns)
            if wish is None or known is None:
                continue
            decision = decide(known, wish, self._bounds(fired, spec), vut, path, now_ns)
            self._going_on[fired.trigger.id] = decision.adapting
            wishes.append(Wish(fired, wish, decision))
        return wishes

    @staticmethod
    def _bounds(fired: Fired, spec: RunSpec) -> Bounds:
        target = next(t for t in spec.targets if t.id == fired.trigger.object_id)
        return Bounds(spec.limits, spec.geofence, target, spec.step_s)

    def _known(self, fired: Fired, spec: RunSpec, path: Polyline, now_ns: int) -> Adapting | None:
        trigger, wish = fired.trigger, fired.trigger.adaptation
        if trigger.id in self._going_on or wish is None:
            return self._going_on.get(trigger.id)
        target = next(t for t in spec.targets if t.id == trigger.object_id)
        manoeuvre = fired.manoeuvre
        routine = routine_of(
            fired.before, manoeuvre, manoeuvre.dispatched_ns, target, spec.vut, path
        )
        if routine is None:
            del self._fired[trigger.id]
            self._notes.append(f"{target.id} doesn't come into the VUT's corridor: no adaptation")
            return None
        return begin(routine, manoeuvre.dispatched_ns, wish.lead_time_s)

    def send(self, reference_id: str, wish: Wish) -> None:
        """An adapted reference is dispatched, at the pace of a decision."""
        if wish.decision.pace is not None:
            self._sent[reference_id] = (wish.fired.trigger.id, wish.decision.pace)

    def answer(self, reference_id: str, *, accepted: bool, message: str) -> None:
        """An object's answer to an adapted reference that doesn't end the run."""
        trigger_id, pace = self._sent.pop(reference_id)
        known = answered(
            self._going_on[trigger_id],
            pace,
            accepted=accepted,
            most_lead_ns=seconds_to_ns(MOST_LEAD_S),
        )
        if not accepted and not known.over and known.refused >= MOST_REFUSED:
            known = known.ended(f"{reference_id} was refused: {message}")
            self._notes.append(f"adaptation ends: {known.over}")
        self._going_on[trigger_id] = known

    def take_notes(self) -> list[str]:
        """Takes out what people should know."""
        notes, self._notes = self._notes, []
        return notes
