"""The VUT's own motion over the next second."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_eval.recordings.crop import TOLERANCE_S
from ssp_eval.score import DEFAULT


@dataclass(frozen=True)
class OwnMotion:
    """The VUT's motion over the next second, read as METHOD 6.6 reads a trajectory."""

    stands: bool = False
    speeds_up: bool = False
    sideways: str | None = None


def own_motion(
    series: Sequence[tuple[float, dict[str, ObjectState]]],
    ticks_s: Sequence[float],
    vut_id: str,
    t_s: float,
) -> OwnMotion:
    """What the VUT does from a label time on; nothing where the clip ends before that is known.

    Args:
        series: (clip time in s, states by object id), times rising.
        ticks_s: its times.
        vut_id: object id of the VUT.
        t_s: the label's time.
    """
    states = []
    for ahead_s in (0.0, 0.5, 1.0):
        i = bisect_right(ticks_s, t_s + ahead_s + TOLERANCE_S) - 1
        state = series[i][1].get(vut_id) if i >= 0 else None
        if state is None or ticks_s[-1] < t_s + ahead_s - TOLERANCE_S:
            return OwnMotion()
        # Clips have frames 40 ms apart: without this, their jitter would look like acceleration.
        rest_ns = seconds_to_ns(t_s + ahead_s - ticks_s[i])
        states.append(state.extrapolated(state.stamp_ns + rest_ns))
    points = [states[0].pose.to_local(state.x_m, state.y_m) for state in states]
    v1_mps = (points[1][0] - points[0][0]) / 0.5
    v2_mps = (points[2][0] - points[1][0]) / 0.5
    shift_m = points[2][1]
    sideways = None
    if DEFAULT.at_least(abs(shift_m), DEFAULT.lateral_shift_m):
        sideways = "left" if shift_m > 0 else "right"
    stands = DEFAULT.at_most(v2_mps, DEFAULT.stop_speed_mps)
    speeds_up = DEFAULT.at_least((v2_mps - v1_mps) / 0.5, DEFAULT.accel_mps2)
    return OwnMotion(stands, not stands and speeds_up, sideways)
