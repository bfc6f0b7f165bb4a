"""Colours of drawn triangles along an image row: light, patterns of facades and foliage, fog.

Each loop does one thing, without branches and with plain numbers read before it, so that the
compiler does several pixels at once.
"""

from __future__ import annotations

import numpy as np

from ssp_ot_controller.camera.jit import Array, compiled, inlined
from ssp_ot_controller.camera.raster import G_CLEAR, G_COLOUR, G_INVERSE, G_KIND, G_UV
from ssp_ot_controller.camera.surfaces import FACADE, FOLIAGE, noise_at, window_mix

# Layout of the style vector: fog colour, fog per m, glass of facades, lit windows (all colours
# blue, green, red), share of windows that are lit.
T_FOG, T_FOG_PER_M, T_GLASS, T_LIT, T_LIT_SHARE = 0, 3, 4, 7, 10
STYLE_LENGTH = 11

_LEAVES_PER_M = 14.0


@inlined
def _plane(planes: Array, n: int, start: int, ry: float) -> tuple[float, float]:
    """A value over z along a row: its slope per rx, and where rx is 0."""
    return planes[n, start], planes[n, start + 1] * ry + planes[n, start + 2]


@inlined
def _light(planes: Array, n: int, rx: float, ry: float, step: float, row: Array) -> None:
    """Colours as the corners have them."""
    w1, w0 = _plane(planes, n, G_INVERSE, ry)
    b1, b0 = _plane(planes, n, G_COLOUR, ry)
    g1, g0 = _plane(planes, n, G_COLOUR + 3, ry)
    r1, r0 = _plane(planes, n, G_COLOUR + 6, ry)
    for k in range(row.shape[0] // 3):
        x = rx + float(np.int32(k)) * step
        z = 1.0 / max(w0 + w1 * x, 1e-6)
        row[3 * k] = z * (b0 + b1 * x)
        row[3 * k + 1] = z * (g0 + g1 * x)
        row[3 * k + 2] = z * (r0 + r1 * x)


@inlined
def _windows(
    planes: Array, n: int, rx: float, ry: float, step: float, style: Array, row: Array
) -> None:
    """Windows instead of wall."""
    w1, w0 = _plane(planes, n, G_INVERSE, ry)
    u1, u0 = _plane(planes, n, G_UV, ry)
    v1, v0 = _plane(planes, n, G_UV + 3, ry)
    w2, u2, v2 = planes[n, G_INVERSE + 1], planes[n, G_UV + 1], planes[n, G_UV + 4]
    b0, g0, r0 = style[T_GLASS], style[T_GLASS + 1], style[T_GLASS + 2]
    b1, g1, r1 = style[T_LIT], style[T_LIT + 1], style[T_LIT + 2]
    lit_share = style[T_LIT_SHARE]
    for k in range(row.shape[0] // 3):
        x = rx + float(np.int32(k)) * step
        z = 1.0 / max(w0 + w1 * x, 1e-6)
        u, v = z * (u0 + u1 * x), z * (v0 + v1 * x)
        # d(u) = z (d(u/z) - u d(1/z)), per column and per row.
        du = z * step * max(abs(u1 - u * w1), abs(u2 - u * w2))
        dv = z * step * max(abs(v1 - v * w1), abs(v2 - v * w2))
        glass, lit = window_mix(u, v, du, dv, lit_share)
        wall, dark = 1.0 - glass, glass - lit
        row[3 * k] = row[3 * k] * wall + b0 * dark + b1 * lit
        row[3 * k + 1] = row[3 * k + 1] * wall + g0 * dark + g1 * lit
        row[3 * k + 2] = row[3 * k + 2] * wall + r0 * dark + r1 * lit


@inlined
def _leaves(
    planes: Array, n: int, rx: float, ry: float, step: float, noise: Array, row: Array
) -> None:
    """Light and dark of foliage; four places where one wouldn't stand for a pixel."""
    w1, w0 = _plane(planes, n, G_INVERSE, ry)
    u1, u0 = _plane(planes, n, G_UV, ry)
    v1, v0 = _plane(planes, n, G_UV + 3, ry)
    w2, u2, v2 = planes[n, G_INVERSE + 1], planes[n, G_UV + 1], planes[n, G_UV + 4]
    u0, u1, u2 = _LEAVES_PER_M * u0, _LEAVES_PER_M * u1, _LEAVES_PER_M * u2
    v0, v1, v2 = _LEAVES_PER_M * v0, _LEAVES_PER_M * v1, _LEAVES_PER_M * v2
    for k in range(row.shape[0] // 3):
        x = rx + float(np.int32(k)) * step
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
def _fog(
    planes: Array, n: int, rx: float, ry: float, step: float, style: Array, row: Array
) -> None:
    """Fog before it, and the limits of a number."""
    w1, w0 = _plane(planes, n, G_INVERSE, ry)
    c1, c0 = _plane(planes, n, G_CLEAR, ry)
    b, g, r = style[T_FOG], style[T_FOG + 1], style[T_FOG + 2]
    for k in range(row.shape[0] // 3):
        x = rx + float(np.int32(k)) * step
        clear = (c0 + c1 * x) / max(w0 + w1 * x, 1e-6)
        row[3 * k] = min(255.0, max(0.0, b + clear * (row[3 * k] - b)))
        row[3 * k + 1] = min(255.0, max(0.0, g + clear * (row[3 * k + 1] - g)))
        row[3 * k + 2] = min(255.0, max(0.0, r + clear * (row[3 * k + 2] - r)))


@compiled
def shade_run(
    planes: Array,
    n: int,
    rx: float,
    ry: float,
    step: float,
    style: Array,
    noise: Array,
    row: Array,
) -> None:
    """Colours of consecutive pixels that show one triangle, each averaged.

    Args:
        planes: of rasterise.
        n: the triangle.
        rx, ry: the ray (rx, ry, 1) at the first pixel, optical frame.
        step: change of rx from pixel to pixel.
        style: vector of STYLE_LENGTH.
        noise: tileable noise for foliage.
        row: shape (3 pixels,), blue, green, red (0-255) in turn; filled.
    """
    kind = planes[n, G_KIND]
    _light(planes, n, rx, ry, step, row)
    if kind == FACADE:
        _windows(planes, n, rx, ry, step, style, row)
    elif kind == FOLIAGE:
        _leaves(planes, n, rx, ry, step, noise, row)
    _fog(planes, n, rx, ry, step, style, row)
