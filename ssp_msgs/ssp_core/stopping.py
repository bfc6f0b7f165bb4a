"""How far an object may go from a fault to its standstill: one bound for tests and judges.

    distance <= v t + b t^2 / 2 + (v + b t)^2 / (2 a) + margin,  t = timeout + reaction

with the speed v at the fault, and b the acceleration that it may have until it notices.

The bound is stated here once, apart from the bodies and controllers that must keep it.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.run_spec import Limits
from ssp_core.vocab import ObjectClass

# For noise of localisation and for the creeping end of a stop.
MARGIN_M = 0.3
# A fault that falls between two steps is seen at the next, and answered by the one after it.
_STEPS_TO_REACT = 2
# From the command to brake to the full deceleration, as time lost (drive and brakes' lag), s.
BRAKE_LAG_S: dict[ObjectClass, float] = {
    ObjectClass.CAR: 0.25,
    ObjectClass.TRUCK: 0.45,
    ObjectClass.BUS: 0.45,
    ObjectClass.MOTORCYCLE: 0.20,
    ObjectClass.CYCLIST: 0.25,
    ObjectClass.PEDESTRIAN: 0.10,
}
# What the service brake of each class can be relied upon for, m/s^2.
SERVICE_BRAKE_MPS2: dict[ObjectClass, float] = {
    ObjectClass.CAR: 7.0,
    ObjectClass.TRUCK: 5.0,
    ObjectClass.BUS: 5.0,
    ObjectClass.MOTORCYCLE: 7.0,
    ObjectClass.CYCLIST: 3.5,
    ObjectClass.PEDESTRIAN: 3.0,
}


@dataclass(frozen=True, slots=True)
class Stopping:
    """How an object stops.

    Args:
        reaction_s: from the instant at which a limit is passed to the full deceleration, as time
            lost at the speed of that instant, s.
        deceleration_mps2: that is then held to standstill, > 0.
        margin_m: stated allowance, m.
    """

    reaction_s: float
    deceleration_mps2: float
    margin_m: float = MARGIN_M

    def distance_m(self, speed_mps: float, timeout_s: float, gain_mps2: float = 0.0) -> float:
        """The farthest that the object may get from the fault on.

        Args:
            speed_mps: at the fault, m/s; without a gain the highest until the object noticed it.
            timeout_s: how long the fault may go unnoticed (a heartbeat's limit, say), s.
            gain_mps2: how fast it may speed up meanwhile (limits.acceleration_mps2), m/s^2.
        """
        blind_s = timeout_s + self.reaction_s
        reached = abs(speed_mps) + gain_mps2 * blind_s
        blind_m = 0.5 * (abs(speed_mps) + reached) * blind_s
        return blind_m + reached**2 / (2.0 * self.deceleration_mps2) + self.margin_m

    def duration_s(self, speed_mps: float, timeout_s: float) -> float:
        """The longest time from the fault to standstill, s; arguments as for distance_m."""
        return timeout_s + self.reaction_s + abs(speed_mps) / self.deceleration_mps2


def stopping_of(cls: ObjectClass, limits: Limits, step_s: float) -> Stopping:
    """How an object target of a class stops on a site.

    Args:
        cls: with a body; KeyError for UNKNOWN.
        limits: of the site; give the deceleration of a stop.
        step_s: how often the object judges its state, s.
    """
    deceleration = min(
        limits.stop_deceleration_mps2, SERVICE_BRAKE_MPS2[cls], limits.acceleration_mps2
    )
    return Stopping(_STEPS_TO_REACT * step_s + BRAKE_LAG_S[cls], deceleration)
