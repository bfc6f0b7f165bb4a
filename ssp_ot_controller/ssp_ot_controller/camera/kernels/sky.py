"""Sky, sun glow, clouds, and the distant outline on the horizon: painted once, then looked up."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined
from ssp_ot_controller.camera.kernels.palettes import Colour, Palette
from ssp_ot_controller.camera.kernels.shading import noise_at

_AZIMUTHS = 4096


class SkyLight(NamedTuple):
    """The sky's parameters for its painter; colours are blue, green, red."""

    zenith: Colour
    horizon: Colour
    glow: Colour
    cloud: Colour
    outline: Colour
    lamp: Colour
    fog: Colour
    sun: tuple[float, float, float]  # unit vector towards it
    cloud_cover: float
    fog_per_m: float
    windows_lit: bool


# Fog lies low: a ray leaves it after this height, and what stands on the horizon is this far.
_FOG_HEIGHT_M, _OUTLINE_DISTANCE_M = 10.0, 350.0


# The panorama: columns by azimuth from -pi on, rows by slope / (1 + slope) from 0 to 1, where
# slope is the tangent of the elevation. Finer at the horizon than a 720p camera. The number of
# columns is a power of two, so that a mask wraps them.
PANORAMA_COLUMNS, PANORAMA_ROWS = 4096, 640
_CHANNEL_BITS = 16
_FIXED = 65536.0


def sun_direction(azimuth_rad: float, elevation_rad: float) -> tuple[float, float, float]:
    """Return the unit vector towards the sun; azimuth counter-clockwise from the frame's x axis."""
    c = math.cos(elevation_rad)
    return c * math.cos(azimuth_rad), c * math.sin(azimuth_rad), math.sin(elevation_rad)


def build_outline(palette: Palette, palette_name: str, seed: int) -> Array:
    """Return the tangent of the horizon's elevation by azimuth, shape (4096,), from -pi on."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x0071]))
    if palette_name == "dusk_city":
        edges = np.sort(rng.integers(0, _AZIMUTHS, 190))
        heights = palette.skyline_height * rng.uniform(0.25, 1.0, 191) ** 1.6
        return np.asarray(heights[np.searchsorted(edges, np.arange(_AZIMUTHS))])
    angle = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    outline = np.zeros(_AZIMUTHS)
    for wave in (5, 11, 23, 61, 173, 419):
        outline += wave**-0.5 * np.sin(wave * angle + rng.uniform(0, 2 * np.pi))
    outline = (outline - outline.min()) / np.ptp(outline)
    return np.asarray(palette.skyline_height * (0.25 + 0.75 * outline))


@compiled
def _fill_panorama(
    light: SkyLight, outline: Array, noise: Array, cosines: Array, sines: Array, panorama: Array
) -> None:
    """Paint the sky; see build_panorama. ``cosines`` and ``sines`` are of the columns' azimuths."""
    rows, columns = panorama.shape
    turn = outline.shape[0] / columns
    for row in range(rows):
        slope = row / (rows - row)
        flat = 1.0 / math.sqrt(1.0 + slope * slope)
        up = flat * slope
        haze = (1.0 - up) ** 4
        reach = 26.0 / (slope + 0.12)
        thickness = 0.75 * min(1.0, slope / 0.10)
        through = min(_OUTLINE_DISTANCE_M, _FOG_HEIGHT_M / max(slope, 1e-6))
        clear = math.exp(-light.fog_per_m * through)
        for column in range(columns):
            c, s = cosines[column], sines[column]
            index = int((column + 0.5) * turn)
            is_outline, lit, cloud, glow = slope < outline[index], 0.0, 0.0, 0.0
            if is_outline:
                if light.windows_lit:
                    number = (index // 3 * 73856093) ^ (int(slope / 0.0045) * 83492791)
                    lit = 0.4 if (number >> 4) & 15 < 3 else 0.0
            else:
                along = flat * (c * light.sun[0] + s * light.sun[1])
                glow = max(0.0, along + up * light.sun[2]) ** 8
                glow = min(1.0, 0.35 * glow + 0.9 * glow**24)
                if light.cloud_cover > 0.0:
                    px, py = reach * c, reach * s
                    cloud = 0.7 * noise_at(noise, px, py) + 0.3 * noise_at(
                        noise, 3.1 * px, 3.1 * py
                    )
                    cloud = 2.4 * (cloud - 0.35 + 0.6 * light.cloud_cover)
                    cloud = thickness * min(1.0, max(0.0, cloud))
            packed = np.uint64(0)
            for k in range(3):
                if is_outline:
                    value = light.outline[k]
                    value += lit * (light.lamp[k] - value)
                else:
                    value = light.zenith[k]
                    value += haze * (light.horizon[k] - value)
                    value += cloud * (light.cloud[k] - value)
                    value += glow * (light.glow[k] - value)
                value = light.fog[k] + clear * (value - light.fog[k])
                level = np.uint64(min(255.0, max(0.0, value + 0.5)))
                packed |= level << np.uint64(_CHANNEL_BITS * k)
            panorama[row, column] = packed


def build_panorama(light: SkyLight, outline: Array, noise: Array) -> Array:
    """Return the whole sky, shape (PANORAMA_ROWS, PANORAMA_COLUMNS), uint64: three numbers in each.

    Blue, green and red (0-255) have 16 bits each, so that a weighted mean with weights of 256 in
    sum is one multiplication for all three.
    """
    panorama = np.empty((PANORAMA_ROWS, PANORAMA_COLUMNS), np.uint64)
    azimuths = 2.0 * np.pi * (np.arange(PANORAMA_COLUMNS) + 0.5) / PANORAMA_COLUMNS - np.pi
    _fill_panorama(light, outline, noise, np.cos(azimuths), np.sin(azimuths), panorama)
    return panorama


@inlined
def _panorama_place(start: Array, step: Array, u: int, rows: int) -> tuple[float, float]:
    """Return column and row in the panorama of the ray at a column of the image."""
    x, y, z = start[0] + u * step[0], start[1] + u * step[1], start[2] + u * step[2]
    slope = max(0.0, z) / math.sqrt(x * x + y * y)
    column = (math.atan2(y, x) + math.pi) * (PANORAMA_COLUMNS / (2.0 * math.pi)) - 0.5
    return column, rows * slope / (1.0 + slope)


@inlined
def sky_row(panorama: Array, start: Array, step: Array, hidden: Array, row: Array) -> None:
    """Write the colours of one image row above the horizon.

    Args:
        panorama: of build_panorama.
        start: ray direction at column 0; its z must not be negative.
        step: change of the direction per column.
        hidden: shape (width,); pixels where it is true are left out.
        row: shape (3 width,), blue, green, red in turn; filled.
    """
    stride = 16  # directions are exact at every sixteenth column and linear between
    width = hidden.shape[0]
    rows = panorama.shape[0]
    p_end, q_end = _panorama_place(start, step, 0, rows)
    for first in range(0, width, stride):
        p, q = p_end, q_end
        p_end, q_end = _panorama_place(start, step, first + stride, rows)
        if p_end - p > PANORAMA_COLUMNS / 2:
            p += PANORAMA_COLUMNS
        elif p_end - p < -PANORAMA_COLUMNS / 2:
            p -= PANORAMA_COLUMNS
        # Fixed point from here: 16 bits behind the point, of which 8 are weights.
        pu, pu_step = int(p * _FIXED), int((p_end - p) * (_FIXED / stride))
        qu, qu_step = int(q * _FIXED), int((q_end - q) * (_FIXED / stride))
        for u in range(first, min(width, first + stride)):
            if not hidden[u]:
                i0 = np.uint64((pu >> 16) & (PANORAMA_COLUMNS - 1))
                i1 = (i0 + np.uint64(1)) & np.uint64(PANORAMA_COLUMNS - 1)
                j0 = np.uint64(min(rows - 2, qu >> 16))
                j1 = j0 + np.uint64(1)
                fp, fq = np.uint64((pu >> 8) & 255), np.uint64((qu >> 8) & 255)
                both = (fp * fq) >> np.uint64(8)
                mean = (
                    panorama[j0, i0] * (np.uint64(256) + both - fp - fq)
                    + panorama[j0, i1] * (fp - both)
                    + panorama[j1, i0] * (fq - both)
                    + panorama[j1, i1] * both
                )
                for k in range(3):
                    level = np.int32((mean >> np.uint64(_CHANNEL_BITS * k)) & np.uint64(0xFFFF))
                    row[3 * u + k] = np.float32(level) * np.float32(1.0 / 256.0)
            pu += pu_step
            qu += qu_step
