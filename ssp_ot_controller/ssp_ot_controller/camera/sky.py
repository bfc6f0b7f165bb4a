"""Sky, sun glow, clouds, and the distant outline on the horizon: painted once, then looked up."""

from __future__ import annotations

import math

import numpy as np

from ssp_ot_controller.camera.jit import Array, compiled
from ssp_ot_controller.camera.palettes import Palette
from ssp_ot_controller.camera.surfaces import noise_at

_AZIMUTHS = 4096

# Layout of the vector of numbers of the sky's painter.
(S_ZENITH, S_HORIZON, S_GLOW, S_CLOUD, S_SUN, S_OUTLINE, S_LAMP, S_FOG) = range(0, 24, 3)
S_COVER, S_TOP, S_LIT, S_FOG_PER_M = range(24, 28)
PARAMETERS = 28

# Fog lies low: a ray leaves it after this height, and what stands on the horizon is this far.
_FOG_HEIGHT_M, _OUTLINE_DISTANCE_M = 10.0, 350.0


# The panorama: columns by azimuth from -pi on, rows by slope / (1 + slope) from 0 to 1, where
# slope is the tangent of the elevation. Finer at the horizon than a 720p camera.
PANORAMA_COLUMNS, PANORAMA_ROWS = 4096, 640


def sun_direction(azimuth_rad: float, elevation_rad: float) -> tuple[float, float, float]:
    """Unit vector towards the sun; azimuth counter-clockwise from the frame's x axis."""
    c = math.cos(elevation_rad)
    return c * math.cos(azimuth_rad), c * math.sin(azimuth_rad), math.sin(elevation_rad)


def build_outline(palette: Palette, palette_name: str, seed: int) -> Array:
    """Tangent of the horizon's elevation by azimuth, shape (4096,), from -pi on."""
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


def build_parameters(
    palette: Palette,
    sun: tuple[float, float, float],
    outline: Array,
    fog_per_m: float,
    clouds: bool,
) -> Array:
    """The vector of the sky's painter, shape (PARAMETERS,)."""
    numbers = np.zeros(PARAMETERS)
    numbers[S_ZENITH : S_ZENITH + 3] = palette.sky_zenith
    numbers[S_HORIZON : S_HORIZON + 3] = palette.sky_horizon
    numbers[S_GLOW : S_GLOW + 3] = palette.sun_glow
    numbers[S_CLOUD : S_CLOUD + 3] = palette.cloud
    numbers[S_SUN : S_SUN + 3] = sun
    numbers[S_OUTLINE : S_OUTLINE + 3] = palette.skyline
    numbers[S_FOG : S_FOG + 3], numbers[S_FOG_PER_M] = palette.fog, fog_per_m
    numbers[S_COVER] = palette.cloud_cover if clouds else 0.0
    numbers[S_TOP] = outline.max()
    numbers[S_LIT] = palette.window_lit_share
    numbers[S_LAMP : S_LAMP + 3] = palette.window_lit
    return numbers


@compiled
def _shade(
    numbers: Array, outline: Array, noise: Array, azimuth: float, slope: float, colour: Array
) -> None:
    """Colour of the sky in a direction into ``colour`` (blue, green, red)."""
    if slope < numbers[S_TOP]:
        index = int((azimuth + math.pi) / (2.0 * math.pi) * outline.shape[0]) % outline.shape[0]
        if slope < outline[index]:
            lit = 0.0
            if numbers[S_LIT] > 0.0:
                row = int(slope / 0.0045)
                number = (index // 3 * 73856093) ^ (row * 83492791)
                lit = 0.4 if (number >> 4) & 15 < 3 else 0.0
            for k in range(3):
                colour[k] = numbers[S_OUTLINE + k] * (1.0 - lit) + numbers[S_LAMP + k] * lit
            return
    flat = 1.0 / math.sqrt(1.0 + slope * slope)
    x, y, up = flat * math.cos(azimuth), flat * math.sin(azimuth), flat * slope
    haze = (1.0 - up) ** 4
    toward = max(0.0, x * numbers[S_SUN] + y * numbers[S_SUN + 1] + up * numbers[S_SUN + 2])
    glow = toward**8
    glow = 0.35 * glow + 0.9 * glow**24
    cloud = 0.0
    if numbers[S_COVER] > 0.0:
        reach = 26.0 / (slope + 0.12)
        px, py = reach * math.cos(azimuth), reach * math.sin(azimuth)
        value = 0.7 * noise_at(noise, px, py) + 0.3 * noise_at(noise, 3.1 * px, 3.1 * py)
        cloud = min(1.0, max(0.0, 2.4 * (value - 0.35 + 0.6 * numbers[S_COVER])))
        cloud *= 0.75 * min(1.0, slope / 0.10)
    for k in range(3):
        value = numbers[S_ZENITH + k] + haze * (numbers[S_HORIZON + k] - numbers[S_ZENITH + k])
        value += cloud * (numbers[S_CLOUD + k] - value)
        colour[k] = value + min(1.0, glow) * (numbers[S_GLOW + k] - value)


@compiled
def _fill_panorama(numbers: Array, outline: Array, noise: Array, panorama: Array) -> None:
    colour = np.empty(3)
    rows, columns, _ = panorama.shape
    for row in range(rows):
        share = row / rows
        for column in range(columns):
            azimuth = 2.0 * math.pi * (column + 0.5) / columns - math.pi
            slope = share / (1.0 - share)
            _shade(numbers, outline, noise, azimuth, slope, colour)
            through = min(_OUTLINE_DISTANCE_M, _FOG_HEIGHT_M / max(slope, 1e-6))
            clear = math.exp(-numbers[S_FOG_PER_M] * through)
            for k in range(3):
                value = numbers[S_FOG + k] + clear * (colour[k] - numbers[S_FOG + k])
                panorama[row, column, k] = min(255.0, max(0.0, value + 0.5))


def build_panorama(numbers: Array, outline: Array, noise: Array) -> Array:
    """The whole sky, shape (PANORAMA_ROWS, PANORAMA_COLUMNS, 3), uint8."""
    panorama = np.empty((PANORAMA_ROWS, PANORAMA_COLUMNS, 3), np.uint8)
    _fill_panorama(numbers, outline, noise, panorama)
    return panorama


@compiled
def sky_row(panorama: Array, start: Array, step: Array, shadow: Array, row: Array) -> None:
    """Colours of one image row above the horizon into ``row``, shape (width, 3).

    Args:
        panorama: of build_panorama.
        start: ray direction at column 0; its z must not be negative.
        step: change of the direction per column.
        shadow: shape (width,); pixels where it is negative are hidden and left out.
    """
    stride = 8  # directions are exact at every eighth column and linear between
    width = row.shape[0]
    rows, columns, _ = panorama.shape
    turn = columns / (2.0 * math.pi)
    for first in range(0, width, stride):
        x, y = start[0] + first * step[0], start[1] + first * step[1]
        z = start[2] + first * step[2]
        azimuth, slope = math.atan2(y, x), max(0.0, z) / math.sqrt(x * x + y * y)
        x, y, z = x + stride * step[0], y + stride * step[1], z + stride * step[2]
        azimuth_end, slope_end = math.atan2(y, x), max(0.0, z) / math.sqrt(x * x + y * y)
        if azimuth_end - azimuth > math.pi:
            azimuth_end -= 2.0 * math.pi
        elif azimuth_end - azimuth < -math.pi:
            azimuth_end += 2.0 * math.pi
        p, p_end = (azimuth + math.pi) * turn - 0.5, (azimuth_end + math.pi) * turn - 0.5
        q, q_end = rows * slope / (1.0 + slope), rows * slope_end / (1.0 + slope_end)
        for u in range(first, min(width, first + stride)):
            if shadow[u] < 0.0:
                continue
            share = (u - first) / stride
            pu, qu = p + share * (p_end - p), min(rows - 2.0, q + share * (q_end - q))
            floor = math.floor(pu)
            i0, j0 = int(floor) % columns, int(qu)
            i1 = (i0 + 1) % columns
            fp, fq = pu - floor, qu - j0
            for k in range(3):
                a, b = float(panorama[j0, i0, k]), float(panorama[j0, i1, k])
                c, d = float(panorama[j0 + 1, i0, k]), float(panorama[j0 + 1, i1, k])
                low = a + fp * (b - a)
                row[u, k] = low + fq * (c + fp * (d - c) - low)
