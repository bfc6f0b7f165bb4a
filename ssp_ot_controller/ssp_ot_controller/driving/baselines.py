"""The baseline drivers of METHOD 8.10, which need no frames.

All of them follow the centre line of their lane. A privileged one sees true states, and stands in
no rank.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import ObjectState
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.driven import COMMANDED
from ssp_core.run_file.values import Positive, Strict
from ssp_core.vocabulary import Role
from ssp_core.world.driver import Answer, PlanDriver, Question
from ssp_ot_controller.bodies.dynamics import LIMITS

HORIZON_S = 5.0
_POINT_S = 0.1
_LEAST_CLOSING_MPS = 0.05


def lane_plan(
    question: Question, deceleration_mps2: float = 0.0, speed_mps: float | None = None
) -> Answer:
    """Return a plan along the lane at a speed, or braking from it to a standstill.

    Args:
        question: gives speed and lane.
        deceleration_mps2: constant, 0 keeps the speed.
        speed_mps: None: the present one.
    """
    t: FloatArray = _POINT_S * np.arange(round(HORIZON_S / _POINT_S) + 1, dtype=np.float64)
    speed = max(question.speed_mps if speed_mps is None else speed_mps, 0.0)
    driven_s = np.minimum(t, speed / deceleration_mps2) if deceleration_mps2 > 0.0 else t
    way = speed * driven_s - 0.5 * deceleration_mps2 * driven_s**2
    x, y = _along(Polyline(question.route_m), way)
    return Answer(Trajectory(tuple(t.tolist()), tuple(x.tolist()), tuple(y.tolist())))


def _along(lane: Polyline, way_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return x and y of a lane after ways from beside the VUT, shape (n,).

    Between the lane's points the curve bends as the lane does. On the straight pieces of the
    polyline a plan that begins anew with each question would never turn, and a VUT that tracks it
    would drift outwards.
    """
    # Imported here: a driver that isn't asked for a plan along a lane needs none of it.
    from scipy.interpolate import CubicSpline  # type: ignore[import-untyped]  # no types

    begin_m, _ = lane.project_beyond(0.0, 0.0)
    stations_m = begin_m + way_m
    x, y = lane.places(stations_m)
    if len(lane.points) > 3:
        bent = (stations_m >= lane.stations_m[0]) & (stations_m <= lane.stations_m[-1])
        x[bent], y[bent] = CubicSpline(lane.stations_m, lane.points)(stations_m[bent]).T
    return x, y


class _Keeping:
    """Keeps the speed of its first question along its lane.

    The speed of each question instead would be fed back through the tracker with a delay of L to
    2 L, and swing more and more from about 1 s on.
    """

    def __init__(self) -> None:
        self._held_mps: float | None = None

    def keep(self, question: Question) -> Answer:
        """Return the plan that keeps the speed."""
        if self._held_mps is None:
            self._held_mps = question.speed_mps
        return lane_plan(question, speed_mps=self._held_mps)


class ConstantVelocity(_Keeping):
    """Keeps its speed along its lane."""

    privileged = False

    class Options(Strict):
        """It has none."""

    def __init__(self, options: Options) -> None:
        super().__init__()
        self._options = options

    def answer(self, question: Question) -> Answer:
        """Answer one question."""
        return self.keep(question)


class _Braking:
    """Brakes with a constant deceleration from the first question on."""

    privileged = False

    class Options(Strict):
        """Strength of its braking."""

        deceleration_mps2: Positive

    def __init__(self, options: Options) -> None:
        self._options = options

    def answer(self, question: Question) -> Answer:
        """Answer one question."""
        return lane_plan(question, self._options.deceleration_mps2)


class StopAtOnce(_Braking):
    """Brakes to a standstill from the first question on."""

    class Options(_Braking.Options):
        """Strength of its braking."""

        deceleration_mps2: Positive = 3.0


class AlwaysBrake(_Braking):
    """Slows gently from the first question on, whatever happens."""

    class Options(_Braking.Options):
        """Strength of its braking."""

        deceleration_mps2: Positive = 1.0


class Oracle(_Keeping):
    """Brakes with all that the VUT's brakes give, from when the event becomes observable on."""

    privileged = True

    class Options(Strict):
        """It has none."""

    def __init__(self, options: Options) -> None:
        super().__init__()
        self._options = options

    def answer(self, question: Question) -> Answer:
        """Answer one question."""
        privileged_truth = question.privileged
        keeps = self.keep(question)
        if privileged_truth is None or privileged_truth.observable_ns is None:
            return keeps
        if question.stamp_ns < privileged_truth.observable_ns:
            return keeps
        vut = next(s for s in privileged_truth.truths if s.role is Role.VUT)
        return lane_plan(question, LIMITS[vut.object_class].deceleration_mps2)


class Aeb(_Keeping):
    """Brakes to a standstill once an object in its corridor comes nearer than a TTC."""

    privileged = True

    class Options(Strict):
        """Its sensor's range and its threshold."""

        range_m: Positive = Field(60.0, description="farther bumpers aren't perceived")
        ttc_s: Positive = Field(1.6, description="it brakes at or below this")
        deceleration_mps2: Positive = 7.0

    def __init__(self, options: Options) -> None:
        super().__init__()
        self._options = options
        self._brakes = False

    def answer(self, question: Question) -> Answer:
        """Answer one question; once it has braked, it brakes on."""
        if question.privileged is not None:
            self._brakes = self._brakes or self._must(question.privileged.truths, question)
        keeps = self.keep(question)
        return lane_plan(question, self._options.deceleration_mps2) if self._brakes else keeps

    def _must(self, truths: tuple[ObjectState, ...], question: Question) -> bool:
        lane = Polyline(question.route_m)
        vut = next(s for s in truths if s.role is Role.VUT)
        half_m = corridor_half_m(vut.size.width_m)
        for other in truths:
            if other is vut:
                continue
            corners = [
                lane.project_beyond(*vut.pose.to_local(x, y)) for x, y in other.box.corners()
            ]
            stations, offsets = [s for s, _ in corners], [offset for _, offset in corners]
            if max(offsets) < -half_m or min(offsets) > half_m:
                continue
            gap_m = min(stations) - vut.size.front_m
            along_mps = other.speed_mps * float(np.cos(other.yaw_rad - vut.yaw_rad))
            closing_mps = question.speed_mps - along_mps
            ahead = max(stations) > 0.0 and gap_m <= self._options.range_m
            soon = max(gap_m, 0.0) <= self._options.ttc_s * closing_mps
            if ahead and soon and closing_mps > _LEAST_CLOSING_MPS:
                return True
        return False


BASELINES: dict[str, Any] = {
    "constant_velocity": ConstantVelocity,
    "stop_at_once": StopAtOnce,
    "always_brake": AlwaysBrake,
    "oracle": Oracle,
    "aeb": Aeb,
}


def known_names() -> list[str]:
    """Return the names of all drivers of ours."""
    return sorted([*BASELINES, *COMMANDED])


def is_baseline(name: str) -> bool:
    """Tell whether a name is that of a driver of ours."""
    return name in BASELINES or name in COMMANDED


def make_driver(name: str, options: Mapping[str, Any]) -> PlanDriver | None:
    """Return a baseline, see ssp_core.world.driver.make_driver."""
    kind: Any = BASELINES.get(name)
    if not is_baseline(name):
        names = ", ".join(known_names())
        raise InputError("is no driver", field="driver", value=name, remedy=f"there is {names}")
    if kind is None:
        if options:
            raise InputError(
                "takes no options",
                field=f"driver {name}",
                value=", ".join(options),
                remedy="leave them out",
            )
        return None
    driver: PlanDriver = kind(parse_model(kind.Options, dict(options), f"the options of {name}"))
    return driver
