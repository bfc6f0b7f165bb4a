"""The distance from a fault to an object's standstill, and the room for a blind stop.

    distance <= v t + b t^2 / 2 + (v + b t)^2 / (2 a) + margin,  t = timeout + reaction

with the speed v at the fault, and b the acceleration that it may have until it notices. The bound
is stated here once, apart from the bodies and controllers that must keep it.

An object that no longer knows where it is holds its steering and brakes as hard as its body can,
on the arc that it is on. A reference must leave room for that within the fence: the object refuses
one that doesn't, and the manager dispatches none.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import Size
from ssp_core.run_file.model import Limits
from ssp_core.safety.fence import way_excess_m
from ssp_core.vocabulary import ObjectClass

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
    """The stop of an object.

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
        """Return the farthest that the object may get from the fault on.

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
        """Return the longest time from the fault to standstill, s; arguments as for distance_m."""
        return timeout_s + self.reaction_s + abs(speed_mps) / self.deceleration_mps2


def stopping_of(cls: ObjectClass, limits: Limits, step_s: float, slows_s: float = 0.0) -> Stopping:
    """Return how an object target of a class stops on a site.

    Args:
        cls: with a body; KeyError for UNKNOWN.
        limits: of the site; give the deceleration of a stop.
        step_s: how often the object judges its state, s.
        slows_s: measured from the command to stop to the slowing of its body; counts where it is
            more than the brakes' lag of the class, s.
    """
    deceleration = min(
        limits.stop_deceleration_mps2, SERVICE_BRAKE_MPS2[cls], limits.acceleration_mps2
    )
    return Stopping(_STEPS_TO_REACT * step_s + max(BRAKE_LAG_S[cls], slows_s), deceleration)


# References must leave this much more room than an object that drives them, which is never exactly
# on its reference: to each side, and in the way that a stop takes.
SLACK_M = 0.2
SLACK_STOP_M = 0.2
# An arc is swept from place to place. They are so far apart at most, and nearer where it bends, so
# that chords stay within 5 mm of it. There are no more of them than this: an object that may drive
# on blindly for a kilometre leaves any fence.
_ARC_M = 4.0
_SAGITTA_M = 0.005
_MOST_PLACES = 512
# An object that turns less than this on its way needs no telling of arc and chord apart.
STRAIGHT_RAD = 1e-9
# What the emergency brake of each class can be relied upon for, m/s^2.
EMERGENCY_BRAKE_MPS2: dict[ObjectClass, float] = {
    ObjectClass.CAR: 8.5,
    ObjectClass.TRUCK: 6.5,
    ObjectClass.BUS: 6.5,
    ObjectClass.MOTORCYCLE: 8.5,
    ObjectClass.CYCLIST: 5.0,
    ObjectClass.PEDESTRIAN: 5.0,
}


def grown(size: Size) -> Size:
    """Return the extent with the slack that a reference must leave around it."""
    return Size(
        size.front_m + SLACK_M, size.rear_m + SLACK_M, size.width_m + 2.0 * SLACK_M, size.height_m
    )


def blind_s(limits: Limits) -> float:
    """Return for how long localisation may be silent, s."""
    return max(limits.state_age_s, limits.frozen_s)


def blind_stopping(
    cls: ObjectClass, limits: Limits, step_s: float, slows_s: float = 0.0
) -> Stopping:
    """Return how an object of a class stops once it has noticed that it is blind."""
    usual = stopping_of(cls, limits, step_s, slows_s)
    return Stopping(usual.reaction_s, EMERGENCY_BRAKE_MPS2[cls])


def arc_places(way_m: float, curvature_1pm: float) -> int:
    """Count the places on an arc, its end among them, that are enough to sweep it."""
    bends = math.sqrt(abs(curvature_1pm) / (8.0 * _SAGITTA_M))
    return 2 + int(min(way_m * max(1.0 / _ARC_M, bends), _MOST_PLACES))


def blind_excess_m(
    columns: FloatArray,
    cls: ObjectClass,
    size: Size,
    limits: Limits,
    fence: Sequence[tuple[float, float]],
    step_s: float,
    slows_s: float = 0.0,
) -> FloatArray:
    """Compute how far blind stops from a reference's points would lead outside, m; shape (n,).

    All that an object sweeps on such a stop counts, from where it is on.

    Args:
        columns: reference points, shape (7, n) with n >= 1.
        cls: of the object; walkers stop straight on.
        size: of the object.
        limits: of the run.
        fence: polygon, m, frame map.
        step_s: how often the object judges its state.
        slows_s: see ``stopping_of``.
    """
    _, x, y, yaw, speed, _, curvature = columns
    if cls is ObjectClass.PEDESTRIAN:
        curvature = np.zeros(len(speed))
    stop = blind_stopping(cls, limits, step_s, slows_s)
    way = speed * (blind_s(limits) + stop.reaction_s) + stop.margin_m
    way += speed**2 / (2.0 * stop.deceleration_mps2) + SLACK_STOP_M
    places = arc_places(float(way.max()), float(np.abs(curvature).max()))
    # From where the slack behind the object ends at its rear: there is no way to the back.
    along = SLACK_M + (way[:, None] - SLACK_M) * np.linspace(0.0, 1.0, places)
    half = 0.5 * curvature[:, None] * along
    bend = np.abs(half) > STRAIGHT_RAD
    chord = along * np.where(bend, np.sin(half) / np.where(bend, half, 1.0), 1.0)
    heading = yaw[:, None] + half
    excess = way_excess_m(
        x[:, None] + chord * np.cos(heading),
        y[:, None] + chord * np.sin(heading),
        heading + half,
        grown(size),
        fence,
    )
    worst: FloatArray = excess.max(axis=1)
    return worst
