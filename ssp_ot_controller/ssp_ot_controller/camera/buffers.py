"""Working memory of the kernels, kept from frame to frame."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace

import numpy as np

from ssp_ot_controller.camera import sensor
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.raster import PLANE_NUMBERS

SAMPLES = 2  # per pixel and axis


@dataclass(frozen=True)
class Samples:
    """Working memory of a frame; see raster and compose.

    Args:
        inverse_depth, owner, planes: what is nearest at each sample.
        cover: shadow on the ground per sample.
        dark: contact darkening per pixel.
        ramp, squares: column numbers, and squared distances from the middle.
        row, drawn, hidden: of one image row.
        triangle, ray, single: of one triangle, one ray and one colour.
    """

    inverse_depth: Array
    owner: Array
    planes: Array
    cover: Array
    dark: Array
    ramp: Array
    squares: Array
    row: Array
    drawn: Array
    hidden: Array
    triangle: Array
    ray: Array
    single: Array


def _planes(room: int) -> Array:
    return np.empty((room, PLANE_NUMBERS))


def _samples(height: int, width: int) -> Samples:
    rows, columns = SAMPLES * height, SAMPLES * width
    return Samples(
        inverse_depth=np.empty((rows, columns), np.float32),
        owner=np.empty((rows, columns), np.int32),
        planes=_planes(0),
        cover=np.empty((rows, columns), np.uint8),
        dark=np.empty((height, width), np.float32),
        ramp=np.arange(columns, dtype=np.float32),
        squares=sensor.falloff(width),
        row=np.zeros(3 * width, np.float32),
        drawn=np.empty(width, np.uint8),
        hidden=np.empty(width, np.bool_),
        triangle=np.empty((3, 3, 3)),
        ray=np.empty(3),
        single=np.empty(3, np.float32),
    )


class Buffers(threading.local):
    """Buffers of the last frame size, kept per thread: allocating them is slow."""

    def __init__(self) -> None:
        self._kept: Samples | None = None

    def cleared(self, height: int, width: int, room: int) -> Samples:
        """Empty buffers of a size, with room for so many triangles."""
        kept = self._kept
        if kept is None or kept.dark.shape != (height, width):
            kept = _samples(height, width)
        if len(kept.planes) < room:
            kept = replace(kept, planes=_planes(2 * room))
        self._kept = kept
        kept.inverse_depth.fill(0.0)
        kept.cover.fill(0)
        kept.dark.fill(0.0)
        return kept
