"""What a trajectory does (METHOD 6.6): its actions, and whether a vehicle can drive it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.core.trajectory import Trajectory, check_trajectory, interpolate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# One trajectory, or an array with an item per trajectory.
T = TypeVar("T", float, "NDArray[np.float64]")


@dataclass(frozen=True)
class Motion(Generic[T]):
    """A trajectory at k = 0, 1, 2, and the differences that METHOD 6.6 takes from it.

    Args:
        forward_m: s_k, ego frame.
        left_m: l_k, ego frame.
        step_s: Δt.
    """

    forward_m: tuple[T, T, T]
    left_m: tuple[T, T, T]
    step_s: float

    @property
    def forward_steps_m(self) -> tuple[T, T]:
        """Δs_k for k = 1, 2."""
        s0, s1, s2 = self.forward_m
        return s1 - s0, s2 - s1

    @property
    def left_steps_m(self) -> tuple[T, T]:
        """Δl_k for k = 1, 2."""
        l0, l1, l2 = self.left_m
        return l1 - l0, l2 - l1

    @property
    def end_speed_mps(self) -> T:
        """v_2, forward."""
        return self.forward_steps_m[1] / self.step_s

    @property
    def accel_mps2(self) -> T:
        """a = (v_2 − v_1)/Δt, positive when speeding up."""
        return (self.end_speed_mps - self.forward_steps_m[0] / self.step_s) / self.step_s

    @property
    def shift_m(self) -> T:
        """Δl = l_2 − l_0, positive to the left."""
        return self.left_m[2] - self.left_m[0]


def step_of(thresholds: Thresholds) -> float:
    """Δt of METHOD 6.6, half of the interval that a trajectory must cover, s."""
    return thresholds.support_end_s / 2


def measure(trajectory: Trajectory, thresholds: Thresholds = DEFAULT) -> Motion[float]:
    """Samples a trajectory at the start, middle and end of the interval (METHOD 6.6).

    Args:
        trajectory: a valid one (METHOD 5.4), ego frame, m.
        thresholds: the interval and the tolerance.
    """
    step_s = step_of(thresholds)
    (s0, l0), (s1, l1), (s2, l2) = (
        interpolate(trajectory, k * step_s, thresholds.tolerance) for k in range(3)
    )
    return Motion((s0, s1, s2), (l0, l1, l2), step_s)


def sample_places(
    times_s: tuple[float, ...], thresholds: Thresholds = DEFAULT
) -> tuple[float, ...] | None:
    """Where among its samples a trajectory is read (METHOD 6.6): 1.25 is a quarter past sample 1.

    Args:
        times_s: times of the samples.
        thresholds: the interval and the tolerance.

    Returns:
        A place for each of the three times, None if no trajectory with these times is valid.
    """
    places = tuple(map(float, range(len(times_s))))
    path = Trajectory(times_s, places, places)
    if check_trajectory(path, thresholds.support_end_s, thresholds.tolerance):
        return None
    step_s = step_of(thresholds)
    return tuple(interpolate(path, k * step_s, thresholds.tolerance)[0] for k in range(3))


def lon_action(motion: Motion[float], thresholds: Thresholds = DEFAULT) -> str:
    """The longitudinal action (METHOD 6.6): stop, decelerate, maintain or accelerate."""
    if thresholds.at_most(motion.end_speed_mps, thresholds.stop_speed_mps):
        return "stop"
    if thresholds.at_most(motion.accel_mps2, -thresholds.accel_mps2):
        return "decelerate"
    if thresholds.at_least(motion.accel_mps2, thresholds.accel_mps2):
        return "accelerate"
    return "maintain"


def lat_action(motion: Motion[float], thresholds: Thresholds = DEFAULT) -> str:
    """The lateral action (METHOD 6.6): left, straight or right."""
    if thresholds.at_least(motion.shift_m, thresholds.lateral_shift_m):
        return "left"
    if thresholds.at_most(motion.shift_m, -thresholds.lateral_shift_m):
        return "right"
    return "straight"


def feasible(motion: Motion[float], thresholds: Thresholds = DEFAULT) -> bool:
    """F of METHOD 6.6: no step goes backwards, too fast or too fast sideways, |a| is bounded."""
    for forward_m, left_m in zip(motion.forward_steps_m, motion.left_steps_m, strict=True):
        speed_mps = math.hypot(forward_m, left_m) / motion.step_s
        lateral_mps = abs(left_m) / motion.step_s
        if not (
            thresholds.at_least(forward_m, -thresholds.max_backward_m)
            and thresholds.at_most(speed_mps, thresholds.max_speed_mps)
            and thresholds.at_most(lateral_mps, thresholds.max_lateral_speed_mps)
        ):
            return False
    return thresholds.at_most(abs(motion.accel_mps2), thresholds.max_accel_mps2)
