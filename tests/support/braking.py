"""Drives of a VUT that brakes: an analytic curve, and the stand-in vehicle's own dynamics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.vocabulary import ObjectClass
from ssp_eval.response.drive import Drive
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyState, Command, step_vehicle

STEP_S = 0.02


def pulse(
    t_s: FloatArray,
    level: float = -7.0,
    start_s: float = 0.2,
    rise_s: float = 0.3,
    hold_s: float = 1.5,
    release_s: float = 0.5,
) -> FloatArray:
    """Half a cosine from 0 to a level, held, and half a cosine back to 0."""

    def half(share: FloatArray) -> FloatArray:
        found: FloatArray = (1.0 - np.cos(np.pi * np.clip(share, 0.0, 1.0))) / 2.0
        return found

    built = half((t_s - start_s) / rise_s)
    return level * (built - half((t_s - start_s - rise_s - hold_s) / release_s))


def drive(
    t_s: FloatArray,
    acceleration_mps2: FloatArray,
    speed_mps: float = 15.0,
    gap_m: float = 30.0,
    trigger_s: float | None = 1.0,
    **changes: Any,
) -> Drive:
    """A drive towards an object that stands ``gap_m`` ahead when the recording begins."""
    steps_s = np.diff(t_s, prepend=t_s[0])
    speed = np.maximum(0.0, speed_mps + np.cumsum(acceleration_mps2 * steps_s))
    gap = gap_m - np.cumsum(speed * steps_s)
    made: dict[str, Any] = {
        "t_s": t_s,
        "acceleration_mps2": acceleration_mps2,
        "speed_mps": speed,
        "gap_m": np.maximum(gap, 0.0),
        "ttc_s": np.divide(gap, speed, out=np.full(len(t_s), math.inf), where=speed > 0.0),
        "touching": (gap <= 0.0).astype(float),
        "trigger_s": trigger_s,
        "trigger_gap_m": None if trigger_s is None else float(np.interp(trigger_s, t_s, gap)),
    }
    return Drive(**{**made, **changes})


def stand_in_drive(
    lag_s: float, gain: float, deceleration_mps2: float = 6.0, speed_mps: float = 15.0
) -> Drive:
    """The stand-in vehicle whose command to brake comes 0.6 s after the trigger, and a lag later.

    Args:
        gain: share of the commanded deceleration.
    """
    body = BodyState(0.0, 0.0, 0.0, speed_mps)
    t_s = STEP_S * np.arange(round(5.0 / STEP_S))
    acceleration = []
    for now_s in t_s:
        told = -gain * deceleration_mps2 if now_s >= 1.6 + lag_s - 1e-9 else 0.0
        body = step_vehicle(body, Command(told, 0.0, 0.0), LIMITS[ObjectClass.CAR], STEP_S)
        acceleration.append(body.acceleration_mps2)
    return drive(t_s, np.array(acceleration), speed_mps, gap_m=60.0)
