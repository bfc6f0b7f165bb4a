"""Roll: a camera that leans sees the level picture turned about its principal point.

Turning about the direction of view is a rotation of the image plane, so that this is exact but for
the resampling. The level picture is larger by what comes in at the corners.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_core.run_file.model import Camera
from ssp_ot_controller.camera.jit import Array, compiled, inlined

_MARGIN_PX = 4


def level(camera: Camera) -> Camera:
    """The camera without roll whose picture holds all that the leaning one sees."""
    if camera.roll_right_rad == 0.0:
        return camera
    c, s = abs(math.cos(camera.roll_right_rad)), abs(math.sin(camera.roll_right_rad))
    width = math.ceil(c * camera.width_px + s * camera.height_px) + _MARGIN_PX
    height = math.ceil(s * camera.width_px + c * camera.height_px) + _MARGIN_PX
    half = math.atan(width / 2 / camera.focal_px)
    return camera.model_copy(
        update={
            "width_px": width,
            "height_px": height,
            "hfov_deg": math.degrees(2.0 * half),
            "roll_right_rad": 0.0,
        }
    )


@inlined
def _weight(away: float) -> float:
    t = abs(away)
    if t < 1.0:
        return 1.0 + t * t * (1.5 * t - 2.5)
    if t < 2.0:
        return 2.0 + t * (-4.0 + t * (2.5 - 0.5 * t))
    return 0.0


@compiled
def _turn(source: Array, c: float, s: float, out: Array) -> None:
    """Bicubic (Catmull-Rom) samples of ``source`` turned about the middle of both."""
    rows, columns, _ = source.shape
    height, width, _ = out.shape
    for v in range(height):
        y = v - 0.5 * (height - 1)
        for u in range(width):
            x = u - 0.5 * (width - 1)
            p = c * x - s * y + 0.5 * (columns - 1)
            q = s * x + c * y + 0.5 * (rows - 1)
            i, j = math.floor(p), math.floor(q)
            fx, fy = p - i, q - j
            for k in range(3):
                total = 0.0
                for b in range(-1, 3):
                    wy = _weight(b - fy)
                    row = min(max(j + b, 0), rows - 1)
                    part = 0.0
                    for a in range(-1, 3):
                        column = min(max(i + a, 0), columns - 1)
                        part += _weight(a - fx) * source[row, column, k]
                    total += wy * part
                out[v, u, k] = max(0.0, total)


def lean(light: Array, camera: Camera) -> Array:
    """The light of a leaning camera from that of its level one, shape (height, width, 3)."""
    if camera.roll_right_rad == 0.0:
        return light
    out = np.empty((camera.height_px, camera.width_px, 3), np.float32)
    c, s = math.cos(camera.roll_right_rad), math.sin(camera.roll_right_rad)
    _turn(light, c, s, out)
    return out
