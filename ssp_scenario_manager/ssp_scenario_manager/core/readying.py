"""Manoeuvres that are planned before their trigger fires, so that dispatch is a look-up.

A lane change or a braking begins where the object will be at execute_at, which is known when the
instant of firing is. While a trigger's condition is about to change, the manoeuvre is planned after
each judged state for a trigger that fires at the next one, one step later. It is used when that
comes true, by the stamps alone; whatever else happens is planned then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath, TriggerSpec
from ssp_scenario_manager.core.conditions import Quantity
from ssp_scenario_manager.core.dispatch import Address, manoeuvre_reference
from ssp_scenario_manager.core.triggers import TriggerWatch

# A condition is about to change when its value goes on as it did for so many states.
_STATES_AHEAD = 3.0


@dataclass(frozen=True, slots=True)
class _Planned:
    """A manoeuvre for one execute_at, from one reference."""

    reference: Reference
    current: Reference


class Readiness:
    """Planned manoeuvres of a run, by trigger. Reads no clock.

    Args:
        spec: the run.
    """

    def __init__(self, spec: RunSpec) -> None:
        self._spec = spec
        self._values: dict[str, tuple[float, ...]] = {}
        self._planned: dict[str, _Planned] = {}

    def plan(
        self,
        watches: Iterable[TriggerWatch],
        references: Mapping[str, Reference],
        now_ns: int,
    ) -> None:
        """Plans for the next state what may be fired by it.

        Args:
            watches: triggers that can fire.
            references: that are being driven, by object.
            now_ns: session time of the state that was just judged.
        """
        step_ns = seconds_to_ns(self._spec.step_s)
        for watch in watches:
            trigger = watch.spec
            if isinstance(trigger.manoeuvre, FollowPath):
                continue
            asked = watch.values
            values = tuple(value for _, value in asked)
            before, self._values[trigger.id] = self._values.get(trigger.id), values
            current = references.get(trigger.object_id)
            if current is None or before is None or not _is_near(asked, before):
                continue
            at_ns = now_ns + step_ns + seconds_to_ns(trigger.lead_time_s)
            planned = self._plan(trigger, current, at_ns)
            if planned is not None:
                self._planned[trigger.id] = planned

    def _plan(self, trigger: TriggerSpec, current: Reference, at_ns: int) -> _Planned | None:
        target = next(t for t in self._spec.targets if t.id == trigger.object_id)
        address = Address("", target.id, self._spec.event_version, "manoeuvre", 0, at_ns)
        # What can't be driven is told of when it is asked for.
        with suppress(ValueError):
            reference = manoeuvre_reference(
                address, trigger.manoeuvre, None, current, target.approach
            )
            reference.row_bytes()
            return _Planned(reference, current)
        return None

    def take(
        self, trigger: TriggerSpec, address: Address, current: Reference | None
    ) -> Reference | None:
        """The planned manoeuvre, if it is what the trigger that fires now asks for.

        Its execute_at may differ by half a step from what the stamps say: states of a live session
        don't come exactly a step apart.
        """
        planned = self._planned.pop(trigger.id, None)
        if planned is None or planned.current is not current:
            return None
        at_ns = planned.reference.execute_at_ns
        if abs(at_ns - address.execute_at_ns) > seconds_to_ns(self._spec.step_s) // 2:
            return None
        return replace(
            planned.reference,
            reference_id=address.reference_id,
            dispatched_ns=address.dispatched_ns,
        )


def _is_near(asked: Sequence[tuple[Quantity, float]], before: Sequence[float]) -> bool:
    """A single condition holds, or would within a few states if its value went on as it did."""
    for (quantity, now), then in zip(asked, before, strict=False):
        if not (math.isfinite(now) and math.isfinite(then)):
            continue
        left = quantity.threshold - now
        if quantity.relation != "<":
            left = -left
        # What is left to go is negative as long as the condition doesn't hold.
        if left >= 0.0 or abs(left) <= _STATES_AHEAD * abs(now - then):
            return True
    return False
