"""The choice of ticks that become frames, the objects' travel by then, and JPEG encoding."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2

from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState
from ssp_ot_controller.camera.kernels.jit import Array

HOLD_PERIOD_NS = NS_PER_S  # while the world holds at step 0


def steps_per_frame(rate_hz: float, step_s: float) -> int:
    """Return N of a run: step k has a frame when k % N == 0."""
    return max(1, round(1.0 / (rate_hz * step_s)))


@dataclass(frozen=True)
class Schedule:
    """Decides per tick; a new schedule holds what has been decided.

    Args:
        every: steps per frame.
        last_step: step of the newest frame, None before the first.
        last_ns: steady time at which it was decided.
    """

    every: int
    last_step: int | None = None
    last_ns: int = 0

    def decide(self, step: int, running: bool, now_ns: int) -> tuple[bool, Schedule]:
        """Decide whether this tick becomes a frame; return it with the schedule from then on.

        A frame step is taken once when the world runs. While it holds at step 0 the same tick
        comes again and again, and gives one frame per second of steady time.
        """
        if step % self.every != 0:
            return False, self
        if step == self.last_step and (running or now_ns - self.last_ns < HOLD_PERIOD_NS):
            return False, self
        return True, Schedule(self.every, step, now_ns)


class Odometer:
    """Sums the way of each object over the states it is shown, along the object's heading."""

    def __init__(self) -> None:
        self._last: dict[str, tuple[float, float]] = {}
        self._travelled_m: dict[str, float] = {}

    def update(self, states: Iterable[ObjectState]) -> None:
        """Take the states of the next instant; showing the same instant twice changes nothing."""
        for state in states:
            last = self._last.get(state.object_id)
            if last is not None:
                dx, dy = state.x_m - last[0], state.y_m - last[1]
                way = dx * math.cos(state.yaw_rad) + dy * math.sin(state.yaw_rad)
                self._travelled_m[state.object_id] += way
            else:
                self._travelled_m[state.object_id] = 0.0
            self._last[state.object_id] = (state.x_m, state.y_m)

    def snapshot(self) -> Mapping[str, float]:
        """Return the distances so far in m by object id; later updates don't change it."""
        return MappingProxyType(dict(self._travelled_m))


def jpeg(image: Array, quality: int) -> bytes:
    """Return a picture (shape (height, width, 3), uint8, blue, green, red) as JPEG.

    Raises:
        ValueError: the encoder refused the picture.
    """
    is_encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not is_encoded:
        raise ValueError(f"a picture of shape {image.shape} can't be encoded as JPEG")
    return data.tobytes()
