"""Kinds of surfaces and their patterns, colours of triangles along an image row.

Each loop does one thing, without branches and with plain numbers read before it, so that the
compiler does several pixels at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined
from ssp_ot_controller.camera.kernels.palettes import Colour
from ssp_ot_controller.camera.kernels.raster import G_CLEAR, G_COLOUR, G_INVERSE, G_KIND, G_UV

# Kinds; numba kernels need plain integers.
MATTE = 0
GLOSSY = 1  # car paint: reflects the sky on upward faces
GLASS = 2
LAMP = 3  # shines by itself, no light falls on it
FACADE = 4  # coordinates: metres along the wall and above the ground
FOLIAGE = 5  # coordinates: metres, any

NOISE_SIZE = 256  # texels per side of the tileable noise, a power of two
_WINDOW_PERIOD_U_M = 2.9
_WINDOW_PERIOD_V_M = 3.1


def make_noise(seed: int) -> Array:
    """Make tileable value noise in [-1, 1] of mean 0, shape (NOISE_SIZE, NOISE_SIZE), float32."""
    rng = np.random.default_rng(seed)
    total = np.zeros((NOISE_SIZE, NOISE_SIZE))
    for cells, weight in ((16, 0.35), (64, 0.35), (NOISE_SIZE, 0.3)):
        coarse = rng.uniform(-1.0, 1.0, (cells, cells))
        position = np.arange(NOISE_SIZE) * cells / NOISE_SIZE
        low = position.astype(int)
        part = position - low
        part = part * part * (3.0 - 2.0 * part)
        high = (low + 1) % cells
        rows = coarse[low] * (1 - part)[:, None] + coarse[high] * part[:, None]
        total += weight * (rows[:, low] * (1 - part) + rows[:, high] * part)
    total -= total.mean()
    return np.asarray(total / np.abs(total).max(), dtype=np.float32)


@inlined
def noise_at(noise: Array, x: float, y: float) -> float:
    """Return the tileable noise at texel coordinates of any range, bilinear."""
    x0, y0 = math.floor(x), math.floor(y)
    fx, fy = x - x0, y - y0
    mask = NOISE_SIZE - 1
    i0, j0 = int(x0) & mask, int(y0) & mask
    i1, j1 = (i0 + 1) & mask, (j0 + 1) & mask
    top = noise[j0, i0] + fx * (noise[j0, i1] - noise[j0, i0])
    low = noise[j1, i0] + fx * (noise[j1, i1] - noise[j1, i0])
    value: float = top + fy * (low - top)
    return value


@inlined
def _overlap(start: float, end: float, low: float, high: float) -> float:
    """Return the length that two stretches have in common."""
    common: float = max(0.0, min(end, high) - max(start, low))
    return common


@inlined
def window_mix(
    u_m: float, v_m: float, width_u_m: float, width_v_m: float, lit_share: float
) -> tuple[float, float]:
    """Return the shares of glass and of lit window (of 1) in a footprint on a facade.

    Windows are products of marks along and up, so that the mean over a rectangle is one too. It
    goes to the mean of the wall where the footprint no longer resolves a window. Without branches,
    so that the compiler does several places at once.
    """
    blur = min(1.0, max(0.0, (max(width_u_m, width_v_m) - 1.0) / 1.6))
    u, v = u_m * (1.0 / _WINDOW_PERIOD_U_M), v_m * (1.0 / _WINDOW_PERIOD_V_M)
    cu, cv = np.floor(u), np.floor(v)
    # No wider than what stays clear of the next window.
    wu = min(max(width_u_m * (1.0 / _WINDOW_PERIOD_U_M), 1e-3), 0.44)
    wv = min(max(width_v_m * (1.0 / _WINDOW_PERIOD_V_M), 1e-3), 0.4)
    left, low = u - cu - 0.5 * wu, v - cv - 0.5 * wv
    right, high = left + wu, low + wv
    across, up = _overlap(left, right, 0.22, 0.78), _overlap(low, high, 0.3, 0.8)
    # The bars between the panes of a window are 0.4 glass.
    clear = (across - _overlap(left, right, 0.48, 0.52)) * (up - _overlap(low, high, 0.605, 0.635))
    pane = (0.4 * across * up + 0.6 * clear) / (wu * wv)
    glass = pane + blur * (0.27 - pane)
    number = (np.int64(cu) * 73856093) ^ (np.int64(cv) * 19349663)
    number = (number ^ (number >> 11)) * 0x5BD1E995
    lit = 0.6 + 0.4 * float((number >> 25) & 1)
    lit = lit if float((number >> 13) & 1023) < lit_share * 1024.0 else 0.0
    lit += blur * (lit_share - lit)
    return glass, glass * lit


class Style(NamedTuple):
    """Colours of fog, of facades' glass and of lit windows, and how many windows are lit."""

    fog: Colour
    glass: Colour
    lit: Colour
    lit_share: float


class Run(NamedTuple):
    """Consecutive pixels of an image row that show one triangle.

    Args:
        planes: of rasterise.
        n: the triangle.
        rx, ry: the ray (rx, ry, 1) at the first pixel, optical frame.
        step: change of rx from pixel to pixel.
    """

    planes: Array
    n: int
    rx: float
    ry: float
    step: float


_LEAVES_PER_M = 14.0


@inlined
def _plane(run: Run, start: int) -> tuple[float, float]:
    """Return a value over z along a row: its slope per rx, and where rx is 0."""
    planes, n = run.planes, run.n
    return planes[n, start], planes[n, start + 1] * run.ry + planes[n, start + 2]


@inlined
def _light(run: Run, row: Array) -> None:
    """Fill the row with the colours that the corners have."""
    w1, w0 = _plane(run, G_INVERSE)
    b1, b0 = _plane(run, G_COLOUR)
    g1, g0 = _plane(run, G_COLOUR + 3)
    r1, r0 = _plane(run, G_COLOUR + 6)
    for k in range(row.shape[0] // 3):
        x = run.rx + float(np.int32(k)) * run.step
        z = 1.0 / max(w0 + w1 * x, 1e-6)
        row[3 * k] = z * (b0 + b1 * x)
        row[3 * k + 1] = z * (g0 + g1 * x)
        row[3 * k + 2] = z * (r0 + r1 * x)


@inlined
def _windows(run: Run, style: Style, row: Array) -> None:
    """Mix windows into the wall."""
    planes, n, step = run.planes, run.n, run.step
    w1, w0 = _plane(run, G_INVERSE)
    u1, u0 = _plane(run, G_UV)
    v1, v0 = _plane(run, G_UV + 3)
    w2, u2, v2 = planes[n, G_INVERSE + 1], planes[n, G_UV + 1], planes[n, G_UV + 4]
    b0, g0, r0 = style.glass
    b1, g1, r1 = style.lit
    for k in range(row.shape[0] // 3):
        x = run.rx + float(np.int32(k)) * step
        z = 1.0 / max(w0 + w1 * x, 1e-6)
        u, v = z * (u0 + u1 * x), z * (v0 + v1 * x)
        # d(u) = z (d(u/z) - u d(1/z)), per column and per row.
        du = z * step * max(abs(u1 - u * w1), abs(u2 - u * w2))
        dv = z * step * max(abs(v1 - v * w1), abs(v2 - v * w2))
        glass, lit = window_mix(u, v, du, dv, style.lit_share)
        wall, dark = 1.0 - glass, glass - lit
        row[3 * k] = row[3 * k] * wall + b0 * dark + b1 * lit
        row[3 * k + 1] = row[3 * k + 1] * wall + g0 * dark + g1 * lit
        row[3 * k + 2] = row[3 * k + 2] * wall + r0 * dark + r1 * lit


@inlined
def _leaves(run: Run, noise: Array, row: Array) -> None:
    """Put light and dark of foliage on the row.

    Four places count where one wouldn't stand for a pixel.
    """
    planes, n, step = run.planes, run.n, run.step
    w1, w0 = _plane(run, G_INVERSE)
    u1, u0 = _plane(run, G_UV)
    v1, v0 = _plane(run, G_UV + 3)
    w2, u2, v2 = planes[n, G_INVERSE + 1], planes[n, G_UV + 1], planes[n, G_UV + 4]
    u0, u1, u2 = _LEAVES_PER_M * u0, _LEAVES_PER_M * u1, _LEAVES_PER_M * u2
    v0, v1, v2 = _LEAVES_PER_M * v0, _LEAVES_PER_M * v1, _LEAVES_PER_M * v2
    for k in range(row.shape[0] // 3):
        x = run.rx + float(np.int32(k)) * step
        z = 1.0 / max(w0 + w1 * x, 1e-6)
        u, v = z * (u0 + u1 * x), z * (v0 + v1 * x)  # texels
        du = z * step * max(abs(u1 - u * w1), abs(u2 - u * w2))
        dv = z * step * max(abs(v1 - v * w1), abs(v2 - v * w2))
        shade = 0.0
        if max(du, dv) < 1.0:
            shade = 1.0 + 0.55 * noise_at(noise, u, v)
        else:
            for i in (-0.25, 0.25):
                for j in (-0.25, 0.25):
                    shade += 0.25 + 0.1375 * noise_at(noise, u + i * du, v + j * dv)
        for c in range(3):
            row[3 * k + c] *= shade


@inlined
def _fog(run: Run, fog: Colour, row: Array) -> None:
    """Put fog before the row, and keep its numbers from 0 to 255."""
    w1, w0 = _plane(run, G_INVERSE)
    c1, c0 = _plane(run, G_CLEAR)
    b, g, r = fog
    for k in range(row.shape[0] // 3):
        x = run.rx + float(np.int32(k)) * run.step
        clear = (c0 + c1 * x) / max(w0 + w1 * x, 1e-6)
        row[3 * k] = min(255.0, max(0.0, b + clear * (row[3 * k] - b)))
        row[3 * k + 1] = min(255.0, max(0.0, g + clear * (row[3 * k + 1] - g)))
        row[3 * k + 2] = min(255.0, max(0.0, r + clear * (row[3 * k + 2] - r)))


@compiled
def shade_run(run: Run, style: Style, noise: Array, row: Array) -> None:
    """Write averaged colours of a run of pixels into ``row``: blue, green, red in turn, 0-255."""
    kind = run.planes[run.n, G_KIND]
    _light(run, row)
    if kind == FACADE:
        _windows(run, style, row)
    elif kind == FOLIAGE:
        _leaves(run, noise, row)
    _fog(run, style.fog, row)
