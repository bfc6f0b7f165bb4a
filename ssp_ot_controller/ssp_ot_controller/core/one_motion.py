"""Do the points of a reference describe one motion: places, headings, speeds, accelerations?

Limits are judged column by column, so that columns which contradict each other would get past them:
a leap of speed with no acceleration stated, or a car that is led sideways.
"""

from __future__ import annotations

import numpy as np

from ssp_core.geometry import FloatArray

# How far a step's length and change of speed may differ from what its points say.
STEP_M = 0.1
_STEP_SHARE = 0.05
_ACCELERATION_MPS2 = 0.5
_SPEED_MPS = 1e-3
# How far speeds and headings may lead from the places, all in all.
_AWAY_M = 0.5
_AWAY_SHARE = 0.02


def contradiction(columns: FloatArray, step_m: float = STEP_M) -> str | None:
    """The first contradiction between columns, for people; None when there is none.

    Args:
        columns: of a reference: t, x, y, yaw, speed, acceleration, curvature; finite, t rising.
        step_m: largest difference between a step's length and what its speeds say, besides 5 %.
    """
    return _of_steps(columns, step_m) or _of_speeds(columns) or _of_headings(columns)


def _said_m(columns: FloatArray) -> FloatArray:
    t, speed = columns[0], columns[4]
    said: FloatArray = 0.5 * (speed[:-1] + speed[1:]) * np.diff(t)
    return said


def _of_steps(columns: FloatArray, step_m: float) -> str | None:
    moved = np.hypot(np.diff(columns[1]), np.diff(columns[2]))
    said = _said_m(columns)
    gap = np.abs(moved - said)
    i = int(np.argmax(gap - _STEP_SHARE * said))
    allowed = step_m + _STEP_SHARE * said[i]
    if gap[i] <= allowed:
        return None
    return (
        f"from point {i} to {i + 1} it moves {moved[i]:.3f} m while its speeds say "
        f"{said[i]:.3f} m, limit is {allowed:.3f} m apart"
    )


def _of_speeds(columns: FloatArray) -> str | None:
    t, speed, stated = columns[0], columns[4], np.abs(columns[5])
    change = np.diff(speed)
    most = np.maximum(stated[:-1], stated[1:])
    over = np.abs(change) - (most + _ACCELERATION_MPS2) * np.diff(t) - _SPEED_MPS
    i = int(np.argmax(over))
    if over[i] <= 0.0:
        return None
    return (
        f"from point {i} to {i + 1} its speed changes by {change[i]:.3f} m/s in "
        f"{t[i + 1] - t[i]:.3f} s, while it states {most[i]:.3f} m/s^2 at most, limit is "
        f"{_ACCELERATION_MPS2:g} m/s^2 apart"
    )


def _of_headings(columns: FloatArray) -> str | None:
    _, x, y, yaw = columns[:4]
    said = _said_m(columns)
    middle = yaw[:-1] + 0.5 * (np.mod(np.diff(yaw) + np.pi, 2.0 * np.pi) - np.pi)
    away = np.hypot(
        x[1:] - x[0] - np.cumsum(said * np.cos(middle)),
        y[1:] - y[0] - np.cumsum(said * np.sin(middle)),
    )
    allowed = _AWAY_M + _AWAY_SHARE * np.cumsum(said)
    over = away - allowed
    i = int(np.argmax(over > 0.0))
    if over[i] <= 0.0:
        return None
    return (
        f"point {i + 1} is {away[i]:.3f} m from where its speeds and headings lead, limit is "
        f"{allowed[i]:.3f} m"
    )
