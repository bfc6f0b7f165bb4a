"""Room for a blind stop: an object that no longer knows where it is, and holds its steering.

Nothing was judged for as long as localisation may be silent; then the object brakes as hard as its
body can, on the arc that it is on. A reference must leave room for that within the fence. The
object refuses one that doesn't, and the manager dispatches none.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssp_core.fence import row_excess_m
from ssp_core.geometry import FloatArray
from ssp_core.run_spec import Limits
from ssp_core.state import Size
from ssp_core.stopping import Stopping, stopping_of
from ssp_core.vocab import ObjectClass

# References must leave this much more room than an object that drives them, which is never exactly
# on its reference: to each side, and in the way that a stop takes.
SLACK_M = 0.2
SLACK_STOP_M = 0.2
# Places on an arc are looked at so far apart, and at no more of them: whoever may drive on blindly
# for a kilometre leaves any fence.
_ARC_M = 4.0
_MOST_PLACES = 256
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
    """The extent with the slack that a reference must leave around it."""
    return Size(
        size.front_m + SLACK_M, size.rear_m + SLACK_M, size.width_m + 2.0 * SLACK_M, size.height_m
    )


def blind_s(limits: Limits) -> float:
    """For how long localisation may be silent, s."""
    return max(limits.state_age_s, limits.frozen_s)


def blind_stopping(cls: ObjectClass, limits: Limits, step_s: float) -> Stopping:
    """How an object of a class stops once it has noticed that it is blind."""
    usual = stopping_of(cls, limits, step_s)
    return Stopping(usual.reaction_s, EMERGENCY_BRAKE_MPS2[cls])


def blind_excess_m(
    columns: FloatArray,
    cls: ObjectClass,
    size: Size,
    limits: Limits,
    fence: Sequence[tuple[float, float]],
    step_s: float,
) -> FloatArray:
    """How far a blind stop from each of a reference's points would end outside, m; shape (n,).

    Args:
        columns: reference points, shape (7, n) with n >= 1.
        cls: of the object; walkers stop straight on.
        size: of the object.
        limits: of the site.
        fence: polygon, m, frame map.
        step_s: how often the object judges its state.
    """
    _, x, y, yaw, speed, _, curvature = columns
    if cls is ObjectClass.PEDESTRIAN:
        curvature = np.zeros(len(speed))
    stop = blind_stopping(cls, limits, step_s)
    way = speed * (blind_s(limits) + stop.reaction_s) + stop.margin_m
    way += speed**2 / (2.0 * stop.deceleration_mps2) + SLACK_STOP_M
    places = 2 + int(min(way.max() / _ARC_M, _MOST_PLACES))
    shares = np.linspace(0.0, 1.0, places)[1:]
    along = way[:, None] * shares
    half = 0.5 * curvature[:, None] * along
    bend = np.abs(half) > STRAIGHT_RAD
    chord = along * np.where(bend, np.sin(half) / np.where(bend, half, 1.0), 1.0)
    heading = yaw[:, None] + half
    excess = row_excess_m(
        (x[:, None] + chord * np.cos(heading)).ravel(),
        (y[:, None] + chord * np.sin(heading)).ravel(),
        (heading + half).ravel(),
        grown(size),
        fence,
    ).reshape(len(speed), -1)
    worst: FloatArray = excess.max(axis=1)
    return worst
