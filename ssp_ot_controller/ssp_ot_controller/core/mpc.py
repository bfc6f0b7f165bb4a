"""Linear model-predictive tracking with OSQP: the same errors as the regulators, within limits.

Models and weights are those of core.gains, with the regulator's cost-to-go at the horizon: where no
limit is in reach it is that regulator with full preview. What it adds is that limits of drive,
brakes and steering, and how quickly they may change, are kept in the plan instead of being cut off
from the command. Where the solver gives no plan, the regulators' command is taken and counted.

It needs the package osqp (extra ``mpc``), which is imported when the first tracker is made.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse  # type: ignore[import-untyped] # has no types
from scipy.linalg import solve_discrete_are  # type: ignore[import-untyped] # has no types

from ssp_core.errors import HostError
from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.state import ObjectState
from ssp_core.vocab import ObjectClass
from ssp_ot_controller.core.bodies import BodyLimits, Command
from ssp_ot_controller.core.gains import (
    DEFAULT_GAINS,
    MAX_GAIN_SPEED_MPS,
    MIN_GAIN_SPEED_MPS,
    TrackerGains,
    lag_share,
)
from ssp_ot_controller.core.track import Point, Track
from ssp_ot_controller.core.tracking import Tracker, TrackingError

HORIZON_S = 0.6
# Problems are set up for speeds this far apart; in between the nearest one serves.
_SPEED_STEP_MPS = 0.5
_SOLVED = 1
_SETTINGS: dict[str, Any] = {
    "verbose": False,
    "eps_abs": 1e-6,
    "eps_rel": 1e-6,
    "max_iter": 1000,
    # Nothing is kept from one plan to the next: the same problem gives the same plan every time.
    "warm_starting": False,
    "adaptive_rho": False,
    "rho": 1.0,
    "polishing": False,
}


def _osqp() -> Any:
    try:
        import osqp  # type: ignore[import-not-found,import-untyped,unused-ignore] # no types
    except ImportError:
        raise HostError(
            "the tracker mpc needs the package osqp: pip install 'ssp[mpc]', or take tracker lqr"
        ) from None
    return osqp


class _Problem:
    """min sum x'Qx + r u^2 + x_N'P x_N with x' = A x + B u + E w, bounds on u and on its changes.

    Args:
        a: shape (3, 3).
        b: shape (3, 1).
        e: shape (3, 1); takes the disturbance that is known ahead.
        cost: diagonal of Q.
        effort: r.
        steps: of the horizon.
    """

    def __init__(
        self,
        a: FloatArray,
        b: FloatArray,
        e: FloatArray,
        cost: tuple[float, float, float],
        effort: float,
        steps: int,
    ) -> None:
        q = np.diag(cost)
        p = solve_discrete_are(a, b, q, np.array([[effort]]))
        free = np.zeros((3 * steps, 3))
        by_u, by_w = np.zeros((3 * steps, steps)), np.zeros((3 * steps, steps))
        power = np.eye(3)
        for i in range(steps):
            for j in range(steps - i):
                row = slice(3 * (i + j), 3 * (i + j) + 3)
                by_u[row, j : j + 1] = power @ b
                by_w[row, j : j + 1] = power @ e
            power = a @ power
            free[3 * i : 3 * i + 3] = power
        weights = np.kron(np.eye(steps), q)
        weights[-3:, -3:] = p
        hessian = by_u.T @ weights @ by_u + effort * np.eye(steps)
        self._linear_x: FloatArray = by_u.T @ weights @ free
        self._linear_w: FloatArray = by_u.T @ weights @ by_w
        change = np.eye(steps)[1:] - np.eye(steps)[:-1]
        osqp = _osqp()
        self._solver = osqp.OSQP()
        self._solver.setup(
            sparse.csc_matrix(np.triu(hessian)),
            np.zeros(steps),
            sparse.csc_matrix(np.vstack((np.eye(steps), change))),
            np.full(2 * steps - 1, -1.0),
            np.full(2 * steps - 1, 1.0),
            **_SETTINGS,
        )

    def plan(
        self, x: FloatArray, known: FloatArray, least: float, most: float, change: float
    ) -> float | None:
        """The first command, None when the solver finds no plan.

        Args:
            x: state, shape (3,).
            known: what the reference asks for now and after each step, shape (steps + 1,); the
                command is this plus the plan.
            least: smallest command.
            most: largest command.
            change: largest change of the command from step to step.
        """
        w, wanted = known[:-1] - known[1:], known[1:]
        linear = self._linear_x @ x + self._linear_w @ w
        lower = np.concatenate((least - wanted, -change - np.diff(wanted)))
        upper = np.concatenate((most - wanted, change - np.diff(wanted)))
        # A reference beyond the limits leaves no room: then the nearest limit is the plan.
        lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
        self._solver.update(q=linear, l=lower, u=upper)
        result = self._solver.solve(raise_error=False)
        first = float(result.x[0])
        if result.info.status_val != _SOLVED or not np.isfinite(first):
            return None
        return float(wanted[0]) + first


class MpcTracker(Tracker):
    """As Tracker, but vehicles plan ahead within their limits. Walkers walk as ever.

    Args:
        object_class: decides the law.
        limits: of the body; those of the class when None.
        dt_s: time for which a command is held.
        gains: weights.

    Raises:
        HostError: osqp isn't installed.
        KeyError: a class without a body (UNKNOWN).
    """

    def __init__(
        self,
        object_class: ObjectClass,
        limits: BodyLimits | None = None,
        dt_s: float = 0.02,
        gains: TrackerGains = DEFAULT_GAINS,
    ) -> None:
        super().__init__(object_class, limits, dt_s, gains)
        _osqp()
        self.fallbacks = 0
        self._steps = max(2, round(HORIZON_S / dt_s))
        self._times_s: FloatArray = np.arange(self._steps + 1.0) * dt_s
        self._across: dict[int, _Problem] = {}
        self._along: _Problem | None = None

    def _drive(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> Command:
        acceleration = self._plan_along(state, track, t_s, point, error)
        curvature = self._plan_across(state, track, t_s, point, error)
        if acceleration is None or curvature is None:
            self.fallbacks += 1
            return super()._drive(state, track, t_s, point, error)
        return Command(self._bounded(acceleration), curvature, point.yaw_rad)

    def _plan_along(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> float | None:
        if self._along is None:
            self._along = self._along_problem()
        along_mps = state.speed_mps * float(np.cos(error.yaw_rad))
        x = np.array(
            [
                error.longitudinal_m,
                along_mps - point.speed_mps,
                state.acceleration_mps2 - point.acceleration_mps2,
            ]
        )
        limits = self._limits
        return self._along.plan(
            x,
            track.accelerations(t_s + self._times_s),
            -limits.deceleration_mps2,
            limits.acceleration_mps2,
            limits.acceleration_rate_mps3 * self._dt_s / self._acceleration_share,
        )

    def _plan_across(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> float | None:
        beside_s, beside, lateral_m = self._beside(state, track, t_s, point, error)
        measured = self._curvature_of(state, beside)
        yaw_rad = wrap_angle(state.yaw_rad - beside.yaw_rad)
        x = np.array([lateral_m, yaw_rad, measured - beside.curvature_1pm])
        limits = self._limits
        bound = limits.curvature_1pm
        if state.speed_mps > 0.0:
            bound = min(bound, limits.lateral_acceleration_mps2 / state.speed_mps**2)
        return self._across_problem(state.speed_mps).plan(
            x,
            track.curvatures(beside_s + self._times_s),
            -bound,
            bound,
            limits.curvature_rate_1pmps * self._dt_s / self._curvature_share,
        )

    def _along_problem(self) -> _Problem:
        share, dt_s, g = self._acceleration_share, self._dt_s, self._gains
        into = np.array([[0.5 * dt_s**2], [dt_s], [1.0]])
        a = np.array([[1.0, dt_s, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
        a += into @ np.array([[0.0, 0.0, 1.0 - share]])
        cost = (g.position_weight, g.speed_weight, 0.0)
        return _Problem(a, share * into, (1.0 - share) * into, cost, g.plan_weight, self._steps)

    def _across_problem(self, speed_mps: float) -> _Problem:
        bounded = min(max(speed_mps, MIN_GAIN_SPEED_MPS), MAX_GAIN_SPEED_MPS)
        key = round(bounded / _SPEED_STEP_MPS)
        problem = self._across.get(key)
        if problem is None:
            problem = self._across[key] = self._across_at(key * _SPEED_STEP_MPS)
        return problem

    def _across_at(self, speed_mps: float) -> _Problem:
        share, g = lag_share(self._limits.curvature_lag_s, self._dt_s), self._gains
        step = speed_mps * self._dt_s
        a = np.array([[1.0, step, 0.5 * step**2], [0.0, 1.0, step], [0.0, 0.0, 1.0 - share]])
        last = np.array([[0.0], [0.0], [1.0]])
        cost = (g.lateral_weight, g.yaw_weight, 0.0)
        return _Problem(
            a, share * last, (1.0 - share) * last, cost, g.curvature_weight, self._steps
        )
