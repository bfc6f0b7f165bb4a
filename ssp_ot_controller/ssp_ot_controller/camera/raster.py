"""Z-buffer rasteriser: triangles of the block's frame to colour and inverse depth.

Attributes are interpolated perspective-correctly: value / z and 1 / z are linear on the image.
Nothing here knows what the triangles show, beyond the patterns of ``surfaces``.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_ot_controller.camera.jit import Array, compiled
from ssp_ot_controller.camera.surfaces import FACADE, FOLIAGE, noise_at, window_mix

NEAR_M = 0.1
CORNER_ATTRIBUTES = 5  # of a corner, beside its place: blue, green, red (0-255), u, v (m)
_VALUES = 9  # x, y, z (optical, m), blue, green, red, u, v, share of light left by fog
_SLACK_PX = 1e-6  # a sample on an edge belongs to both triangles, so that there are no cracks

# Layout of the style vector: fog colour, fog per m, glass of facades, lit windows (all colours
# blue, green, red), share of windows that are lit.
T_FOG, T_FOG_PER_M, T_GLASS, T_LIT, T_LIT_SHARE = 0, 3, 4, 7, 10
STYLE_LENGTH = 11


@compiled
def _to_optical(corners: Array, eye: Array, axes: Array, triangle: Array) -> float:
    """Places of a triangle's corners in the optical frame into ``triangle``; the largest depth."""
    deepest = -1e30
    for i in range(3):
        dx, dy, dz = corners[i, 0] - eye[0], corners[i, 1] - eye[1], corners[i, 2] - eye[2]
        for k in range(3):
            triangle[i, k] = axes[k, 0] * dx + axes[k, 1] * dy + axes[k, 2] * dz
        deepest = max(deepest, triangle[i, 2])
    return deepest


@compiled
def _clip_near(triangle: Array, values: int, polygon: Array) -> int:
    """Cuts a triangle at z = NEAR_M; fills ``polygon`` and returns its number of corners (0-4)."""
    count = 0
    for i in range(3):
        j = (i + 1) % 3
        zi, zj = triangle[i, 2], triangle[j, 2]
        if zi >= NEAR_M:
            for k in range(values):
                polygon[count, k] = triangle[i, k]
            count += 1
        if (zi >= NEAR_M) != (zj >= NEAR_M):
            t = (NEAR_M - zi) / (zj - zi)
            for k in range(values):
                polygon[count, k] = triangle[i, k] + t * (triangle[j, k] - triangle[i, k])
            count += 1
    return count


@compiled
def _span(xy: Array, row: int, width: int) -> tuple[int, int]:
    """First and last sample of a row inside the triangle with corners xy; empty: 0, -1."""
    left, right = 1e30, -1e30
    for i in range(3):
        j = (i + 1) % 3
        xi, yi, xj, yj = xy[i, 0], xy[i, 1], xy[j, 0], xy[j, 1]
        if row < min(yi, yj) or row > max(yi, yj):
            continue
        if abs(yj - yi) < 1e-12:
            left, right = min(left, xi, xj), max(right, xi, xj)
            continue
        crossing = xi + (row - yi) * (xj - xi) / (yj - yi)
        left, right = min(left, crossing), max(right, crossing)
    if right < -1.0 or left > width:
        return 0, -1
    first = max(0, math.ceil(max(left, 0.0) - _SLACK_PX))
    last = min(width - 1, math.floor(min(right, width) + _SLACK_PX))
    return first, last


@compiled
def _rows(xy: Array, height: int, width: int) -> tuple[int, int]:
    """First and last row that a triangle may cover; empty: 0, -1."""
    low, high = min(xy[0, 0], xy[1, 0], xy[2, 0]), max(xy[0, 0], xy[1, 0], xy[2, 0])
    if high < 0.0 or low > width - 1:
        return 0, -1
    low, high = min(xy[0, 1], xy[1, 1], xy[2, 1]), max(xy[0, 1], xy[1, 1], xy[2, 1])
    if high < 0.0 or low > height - 1:
        return 0, -1
    top = math.ceil(max(low, 0.0) - _SLACK_PX)
    bottom = math.floor(min(high, height - 1.0) + _SLACK_PX)
    return max(0, top), min(height - 1, bottom)


@compiled
def _fill(
    xy: Array,
    q: Array,
    slopes: Array,
    kind: int,
    style: Array,
    noise: Array,
    inverse_depth: Array,
    pixels: Array,
) -> None:
    """Draws one projected triangle: ``q`` holds 1/z and values over z at its corners."""
    height, width = inverse_depth.shape
    x1, y1 = xy[1, 0] - xy[0, 0], xy[1, 1] - xy[0, 1]
    x2, y2 = xy[2, 0] - xy[0, 0], xy[2, 1] - xy[0, 1]
    area = x1 * y2 - x2 * y1
    if area > -1e-9:  # seen from behind: rows run downwards, so fronts turn clockwise
        return
    top, bottom = _rows(xy, height, width)
    for k in range(7):
        a, b = q[1, k] - q[0, k], q[2, k] - q[0, k]
        slopes[0, k] = (a * y2 - b * y1) / area
        slopes[1, k] = (b * x1 - a * x2) / area
    for row in range(top, bottom + 1):
        first, last = _span(xy, row, width)
        ry = row - xy[0, 1]
        for column in range(first, last + 1):
            rx = column - xy[0, 0]
            inverse = q[0, 0] + slopes[0, 0] * rx + slopes[1, 0] * ry
            if inverse <= inverse_depth[row, column]:
                continue
            inverse_depth[row, column] = inverse
            z = 1.0 / inverse
            blue = (q[0, 1] + slopes[0, 1] * rx + slopes[1, 1] * ry) * z
            green = (q[0, 2] + slopes[0, 2] * rx + slopes[1, 2] * ry) * z
            red = (q[0, 3] + slopes[0, 3] * rx + slopes[1, 3] * ry) * z
            if kind in (FACADE, FOLIAGE):
                u_over_z = q[0, 4] + slopes[0, 4] * rx + slopes[1, 4] * ry
                u, v = u_over_z * z, (q[0, 5] + slopes[0, 5] * rx + slopes[1, 5] * ry) * z
                if kind == FOLIAGE:
                    shade = 1.0 + 0.55 * noise_at(noise, 14.0 * u, 14.0 * v)
                    blue, green, red = blue * shade, green * shade, red * shade
                else:
                    beside = (u_over_z + slopes[0, 4]) / (inverse + slopes[0, 0])
                    glass, lit = window_mix(u, v, abs(beside - u), style[T_LIT_SHARE])
                    dark = glass - lit
                    blue = blue * (1.0 - glass) + style[T_GLASS] * dark + style[T_LIT] * lit
                    green = (
                        green * (1.0 - glass) + style[T_GLASS + 1] * dark + style[T_LIT + 1] * lit
                    )
                    red = red * (1.0 - glass) + style[T_GLASS + 2] * dark + style[T_LIT + 2] * lit
            clear = (q[0, 6] + slopes[0, 6] * rx + slopes[1, 6] * ry) * z
            blue = style[T_FOG] + clear * (blue - style[T_FOG])
            green = style[T_FOG + 1] + clear * (green - style[T_FOG + 1])
            red = style[T_FOG + 2] + clear * (red - style[T_FOG + 2])
            pixels[row, column, 0] = min(255.0, max(0.0, blue + 0.5))
            pixels[row, column, 1] = min(255.0, max(0.0, green + 0.5))
            pixels[row, column, 2] = min(255.0, max(0.0, red + 0.5))


@compiled
def rasterise(
    corners: Array,
    attributes: Array,
    kinds: Array,
    ranges: Array,
    eye: Array,
    axes: Array,
    lens: Array,
    style: Array,
    noise: Array,
    inverse_depth: Array,
    pixels: Array,
) -> None:
    """Draws the front sides of triangles where they are nearest.

    Args:
        corners: shape (n, 3, 3), block frame, m, counter-clockwise as seen from the front.
        attributes: shape (n, 3, CORNER_ATTRIBUTES).
        kinds: shape (n,), surface kinds.
        ranges: shape (r, 2): first and end of the runs of triangles to draw; near ones first is
            faster.
        eye: camera centre, block frame.
        axes: shape (3, 3): optical axes in the block frame.
        lens: fx, fy, cx, cy in samples.
        style: vector of STYLE_LENGTH.
        noise: tileable noise for foliage.
        inverse_depth: shape (rows, columns), 1/m, 0 is infinitely far; updated.
        pixels: shape (rows, columns, 3), uint8 blue, green, red; updated.
    """
    triangle, polygon = np.empty((3, _VALUES)), np.empty((4, _VALUES))
    xy, q, slopes = np.empty((3, 2)), np.empty((3, 7)), np.empty((2, 7))
    for r in range(ranges.shape[0]):
        for n in range(ranges[r, 0], ranges[r, 1]):
            if _to_optical(corners[n], eye, axes, triangle) < NEAR_M:
                continue
            for i in range(3):
                for k in range(CORNER_ATTRIBUTES):
                    triangle[i, 3 + k] = attributes[n, i, k]
                triangle[i, 8] = math.exp(-style[T_FOG_PER_M] * max(0.0, triangle[i, 2]))
            count = _clip_near(triangle, _VALUES, polygon)
            for part in range(1, count - 1):
                for i in range(3):
                    corner = 0 if i == 0 else part + i - 1
                    inverse = 1.0 / polygon[corner, 2]
                    xy[i, 0] = lens[0] * polygon[corner, 0] * inverse + lens[2]
                    xy[i, 1] = lens[1] * polygon[corner, 1] * inverse + lens[3]
                    q[i, 0] = inverse
                    for k in range(6):
                        q[i, 1 + k] = polygon[corner, 3 + k] * inverse
                _fill(xy, q, slopes, kinds[n], style, noise, inverse_depth, pixels)


@compiled
def rasterise_cover(
    corners: Array, ranges: Array, eye: Array, axes: Array, lens: Array, cover: Array
) -> None:
    """Marks the samples that triangles cover from either side, whatever their depth.

    Args:
        corners, ranges, eye, axes, lens: see rasterise.
        cover: shape (rows, columns), uint8; covered samples become 1.
    """
    height, width = cover.shape
    triangle, polygon, xy = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 2))
    for r in range(ranges.shape[0]):
        for n in range(ranges[r, 0], ranges[r, 1]):
            if _to_optical(corners[n], eye, axes, triangle) < NEAR_M:
                continue
            count = _clip_near(triangle, 3, polygon)
            for part in range(1, count - 1):
                for i in range(3):
                    corner = 0 if i == 0 else part + i - 1
                    inverse = 1.0 / polygon[corner, 2]
                    xy[i, 0] = lens[0] * polygon[corner, 0] * inverse + lens[2]
                    xy[i, 1] = lens[1] * polygon[corner, 1] * inverse + lens[3]
                top, bottom = _rows(xy, height, width)
                for row in range(top, bottom + 1):
                    first, last = _span(xy, row, width)
                    for column in range(first, last + 1):
                        cover[row, column] = 1
