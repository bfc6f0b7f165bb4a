"""Throttle, brake and steering wheel for a vehicle whose body isn't ours.

Our trackers and drivers command acceleration and curvature of one of our bodies. The pedals press
what makes another vehicle move as that body would: forward by the response that was measured
before the run (gain and lag of each pedal and of the wheel), and back by what it does instead.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyState, Command, step_body
from ssp_ot_controller.control.tracker import lag_share

# How quickly a lasting difference to the wanted acceleration and curvature is taken out, 1/s.
_ACCELERATION_1PS, _CURVATURE_1PS = 1.5, 1.5
# It is taken for drag, a slope or a wrong gain up to these bounds.
_MOST_MPS2, _MOST_1PM = 3.0, 0.05
# Below this speed the yaw rate says nothing about the curvature.
_MIN_CURVATURE_SPEED_MPS = 2.0
# A response is read from values over this time, since a simulator's aren't smooth.
_SMOOTH_S = 0.1
_LONGEST_LAG_S = 2.0
# A fit may see further than the measurement did by this factor.
_BEYOND_SEEN = 1.5


@dataclass(frozen=True, slots=True)
class Response:
    """The answer of a vehicle to its pedals and its wheel.

    Args:
        throttle_mps2, brake_mps2: at full throttle and full brake, > 0.
        steer_1pm: curvature to the left at a whole turn of the wheel to the left, > 0.
        throttle_lag_s, brake_lag_s, steer_lag_s: time constants, >= 0.
    """

    throttle_mps2: float
    throttle_lag_s: float
    brake_mps2: float
    brake_lag_s: float
    steer_1pm: float
    steer_lag_s: float


def first_order(values: Sequence[float], dt_s: float) -> tuple[float, float]:
    """Return gain and time constant, s, of a response to a step that came before the values.

    Args:
        values: measured at each end of a step of ``dt_s``.
        dt_s: time between two values, s.
    """
    width = max(1, round(_SMOOTH_S / dt_s))
    if len(values) <= 2 * width:
        return 0.0, 0.0
    smooth: FloatArray = np.convolve(np.asarray(values), np.ones(width) / width, "valid")
    peak = float(smooth.max())
    if peak <= 0.0:
        return 0.0, 0.0
    before, after = smooth[:-1], smooth[1:]
    spread = float(((before - before.mean()) ** 2).sum())
    share = 0.0
    if spread > 1e-12:
        share = float(((before - before.mean()) * (after - after.mean())).sum()) / spread
    share = min(max(share, 0.0), math.exp(-dt_s / _LONGEST_LAG_S))
    gain = float((after - share * before).mean()) / (1.0 - share)
    lag_s = -dt_s / math.log(share) if share > 1e-9 else 0.0
    return min(max(gain, peak), _BEYOND_SEEN * peak), lag_s


class Pedals:
    """Pedals and wheel of one vehicle.

    Args:
        lag_scale: of the run's disturbance: the body that is followed has lags so much longer.
    """

    def __init__(
        self, object_class: ObjectClass, response: Response, dt_s: float, lag_scale: float = 1.0
    ) -> None:
        self._class, self._response = object_class, response
        self._dt_s, self._lag_scale = dt_s, lag_scale
        # What our body would have now, and the lasting differences to it.
        self._acceleration_mps2 = 0.0
        self.curvature_1pm = 0.0
        self._drag_mps2 = 0.0
        self._pull_1pm = 0.0
        self._follows = False

    def press(self, body: BodyState, command: Command) -> tuple[float, float, float]:
        """Give throttle and brake, 0 to 1, and the wheel, -1 to 1 to the right, for a step.

        Args:
            body: the vehicle as it moves now.
            command: for the body that it follows.
        """
        self._learn(body)
        own = replace(
            body,
            speed_mps=max(0.0, body.speed_mps),
            acceleration_mps2=self._acceleration_mps2,
            curvature_1pm=self.curvature_1pm,
        )
        target = step_body(self._class, own, command, self._dt_s, lag_scale=self._lag_scale)
        steer = self._turn(target.curvature_1pm)
        if target.speed_mps == 0.0 or command.emergency_stop:
            self._acceleration_mps2 = target.acceleration_mps2
            self._drag_mps2, self._follows = 0.0, False
            return 0.0, 1.0, steer
        r = self._response
        now, soon = self._acceleration_mps2, target.acceleration_mps2
        lag_s = r.throttle_lag_s if soon + self._drag_mps2 >= 0.0 else r.brake_lag_s
        needed = now + (soon - now) / lag_share(lag_s, self._dt_s) + self._drag_mps2
        throttle = min(max(needed / r.throttle_mps2, 0.0), 1.0)
        brake = min(max(-needed / r.brake_mps2, 0.0), 1.0)
        self._follows = max(throttle, brake) < 1.0
        self._acceleration_mps2 = min(max(soon, -r.brake_mps2), r.throttle_mps2)
        return throttle, brake, steer

    def _learn(self, body: BodyState) -> None:
        if self._follows:
            off = self._acceleration_mps2 - body.acceleration_mps2
            learnt = self._drag_mps2 + _ACCELERATION_1PS * self._dt_s * off
            self._drag_mps2 = min(max(learnt, -_MOST_MPS2), _MOST_MPS2)
        if body.speed_mps > _MIN_CURVATURE_SPEED_MPS:
            turned = self.curvature_1pm - body.yaw_rate_radps / body.speed_mps
            learnt = self._pull_1pm + _CURVATURE_1PS * self._dt_s * turned
            self._pull_1pm = min(max(learnt, -_MOST_1PM), _MOST_1PM)

    def _turn(self, soon_1pm: float) -> float:
        r, now_1pm = self._response, self.curvature_1pm
        self.curvature_1pm = soon_1pm
        share = lag_share(r.steer_lag_s, self._dt_s)
        needed = now_1pm + (soon_1pm - now_1pm) / share + self._pull_1pm
        return -min(max(needed / r.steer_1pm, -1.0), 1.0)


# Less than this, and a vehicle is taken not to answer at all.
_LEAST_MPS2, _LEAST_1PM = 0.3, 0.01


def response_problems(response: Response, stop_mps2: float, reaction_s: float) -> list[str]:
    """List why a vehicle can't be led within a site's limits, each with the figure.

    Args:
        response: of the vehicle to its pedals.
        stop_mps2: with which the site has its objects stop.
        reaction_s: the site's bound from an abort until an object becomes slower.
    """
    r, problems = response, []
    if r.throttle_mps2 < _LEAST_MPS2:
        problems.append(f"full throttle gives {r.throttle_mps2:.2f} m/s^2")
    if r.brake_mps2 < stop_mps2:
        problems.append(
            f"full brake gives {r.brake_mps2:.2f} m/s^2, limits.stop_deceleration_mps2 is "
            f"{stop_mps2:g}"
        )
    if r.brake_lag_s > reaction_s:
        problems.append(
            f"its brake takes {r.brake_lag_s:.2f} s, limits.stop_reaction_s is {reaction_s:g}"
        )
    if r.steer_1pm < _LEAST_1PM:
        problems.append(f"its wheel, turned by a tenth, gives {0.1 * r.steer_1pm:.4f} 1/m")
    return problems
