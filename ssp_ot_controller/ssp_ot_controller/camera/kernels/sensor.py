"""The way from light to the numbers of a frame: exposure, vignette, sensor noise, rounding.

And roll.

A camera that leans sees the level picture turned about its principal point. Turning about the
direction of view is a rotation of the image plane, so that this is exact but for the resampling.
The level picture is larger by what comes in at the corners.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from ssp_core.run_file.model import Camera
from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined

_VIGNETTE = 0.10  # light that the corners lose
_GRAIN_LENGTH = 1 << 17
_GRAIN_SIGMA = 104.5  # standard deviation of a sum of two uniform bytes


def make_grain() -> Array:
    """Make noise that is read from changing starts, shape (n,), int16.

    Each number is the sum of two uniform bytes, less 255.
    """
    bytes_ = np.random.default_rng(0).integers(0, 256, (2, _GRAIN_LENGTH), dtype=np.int16)
    return np.asarray(bytes_.sum(axis=0, dtype=np.int16) - 255, dtype=np.int16)


def falloff(width_px: int) -> Array:
    """Return the squared distance from the middle column by channel, shape (3 width,), float32."""
    columns = np.arange(width_px, dtype=np.float32) - np.float32(0.5 * (width_px - 1))
    return np.repeat(columns * columns, 3)


@inlined
def mixed(state: np.uint64) -> np.uint64:
    """Return a well mixed 64-bit number (splitmix64)."""
    state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return state ^ (state >> np.uint64(31))


class Film(NamedTuple):
    """The conversion of light into numbers.

    Args:
        exposure: factor on the light.
        noise_sigma: standard deviation of the noise, of 255.
        noise_state: what the noise of this frame follows from.
        grain: of make_grain.
    """

    exposure: float
    noise_sigma: float
    noise_state: np.uint64
    grain: Array


@inlined
def develop_row(row: Array, squares: Array, v: int, height: int, film: Film, out: Array) -> None:
    """Write one image row.

    Args:
        row: shape (3 width,), float32, light of blue, green, red in turn.
        squares: of falloff.
        v: the row's number, of ``height``.
        height: of the image, px.
        film: of the frame.
        out: shape (3 width,), uint8.
    """
    length = row.shape[0]
    dy = v - 0.5 * (height - 1)
    corner = _VIGNETTE / ((length / 6.0) ** 2 + (0.5 * height) ** 2)
    gain = np.float32(film.exposure * (1.0 - corner * dy * dy))
    loss = np.float32(film.exposure * corner)
    scale = np.float32(film.noise_sigma / _GRAIN_SIGMA)
    number = mixed(film.noise_state + np.uint64(v) * np.uint64(0x9E3779B97F4A7C15))
    begin = int(number % np.uint64(film.grain.shape[0] - length))
    part = film.grain[begin : begin + length]
    half, lowest, highest = np.float32(0.5), np.float32(0.0), np.float32(255.0)
    for i in range(length):
        value = (gain - loss * squares[i]) * row[i] + scale * np.float32(part[i]) + half
        out[i] = np.uint8(min(highest, max(lowest, value)))


@compiled
def develop(light: Array, squares: Array, film: Film, out: Array) -> None:
    """Write a whole image; arguments as develop_row, with ``light`` and ``out`` row by row."""
    for v in range(out.shape[0]):
        develop_row(light[v], squares, v, out.shape[0], film, out[v])


_MARGIN_PX = 4


def level_camera(camera: Camera) -> Camera:
    """Return the camera without roll whose picture holds all that the leaning one sees."""
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


def rolled(light: Array, camera: Camera) -> Array:
    """Return the light of a leaning camera from that of its level one, shape (height, width, 3)."""
    if camera.roll_right_rad == 0.0:
        return light
    c, s = math.cos(camera.roll_right_rad), math.sin(camera.roll_right_rad)
    rows, columns, _ = light.shape
    # From a place in the picture to one in the level picture, about the middle of both.
    turn = np.array([[c, -s], [s, c]])
    middle = np.array([camera.width_px - 1, camera.height_px - 1]) / 2
    shift = np.array([columns - 1, rows - 1]) / 2 - turn @ middle
    turned = cv2.warpAffine(
        light,
        np.column_stack([turn, shift]),
        (camera.width_px, camera.height_px),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.maximum(turned, np.float32(0.0))
