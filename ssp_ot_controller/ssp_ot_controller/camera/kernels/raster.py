"""Z-buffer rasteriser: finds which triangle is nearest at each sample, and how to colour it there.

A triangle's corners in the optical frame span a matrix; its inverse, written with three cross
products, gives at once the edges on the image and the planes on which 1 / z and value / z lie, also
for triangles that reach behind the camera, so that nothing has to be clipped. The two triangles at
an edge compute it from the same numbers, hence there are no cracks.

Samples remember only depth and triangle; ``shading`` colours what is still visible in the end.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined

CORNER_ATTRIBUTES = 5  # of a corner, beside its place: blue, green, red (0-255), u, v (m)

# Layout of a triangle's planes: value / z = [0] rx + [1] ry + [2] at the ray (rx, ry, 1).
G_INVERSE, G_COLOUR, G_CLEAR, G_UV, G_KIND = 0, 3, 12, 15, 21
PLANE_NUMBERS = 22


class Triangles(NamedTuple):
    """Triangles in the block's frame that know their final colours.

    Args:
        corners: shape (n, 3, 3), float32, m.
        attributes: shape (n, 3, CORNER_ATTRIBUTES), float32: blue, green, red, u, v.
        kinds: shape (n,), surface kinds.
    """

    corners: Array
    attributes: Array
    kinds: Array


class Eye(NamedTuple):
    """The camera, in the block's frame.

    Args:
        position: shape (3,), m.
        axes: shape (3, 3): optical axes.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        lens: fx, fy, cx, cy in samples.
    """

    position: Array
    axes: Array
    rays: Array
    lens: Array


class Samples(NamedTuple):
    """The nearest surface at each sample, SAMPLES times finer than the frame, and working memory.

    Args:
        inverse_depth: shape (rows, columns), float32, 1/m, 0 is infinitely far.
        owner: shape (rows, columns), the nearest triangle where inverse_depth isn't 0.
        planes: shape (room, PLANE_NUMBERS), of the triangles that were seen.
        cover: shape (rows, columns), uint8: shadow on the ground.
        ramp: 0, 1, 2, ... as float32, a row long.
        squares: see sensor.falloff.
        row: of one image row, shape (3 width,), float32.
        drawn: of one image row, shape (width,), uint8.
        hidden: of one image row, shape (width,), bool.
        triangle: of one triangle, shape (3, 3, 3).
        ray: of one ray, shape (3,).
        single: of one colour, shape (3,), float32.
    """

    inverse_depth: Array
    owner: Array
    planes: Array
    cover: Array
    ramp: Array
    squares: Array
    row: Array
    drawn: Array
    hidden: Array
    triangle: Array
    ray: Array
    single: Array


_FLAT = 1e-12  # smaller volumes of corners and eye are taken for a triangle seen edge-on
_IN_FRONT_M = 1e-3


@inlined
def _to_optical(corners: Array, n: int, eye: Eye, place: Array) -> float:
    """Write places of a triangle's corners in the optical frame; return the largest depth."""
    deepest = -1e30
    for i in range(3):
        dx = corners[n, i, 0] - eye.position[0]
        dy = corners[n, i, 1] - eye.position[1]
        dz = corners[n, i, 2] - eye.position[2]
        for k in range(3):
            place[i, k] = eye.axes[k, 0] * dx + eye.axes[k, 1] * dy + eye.axes[k, 2] * dz
        deepest = max(deepest, place[i, 2])
    return deepest


@inlined
def _edges(place: Array, lens: Array, cross: Array, edge: Array) -> float:
    """Write cross products of the corners, and edges on the image; return the volume, + in front.

    Args:
        place: shape (3, 3), corners in the optical frame.
        lens: fx, fy, cx, cy in samples.
        cross: shape (3, 3); its rows times a ray (rx, ry, 1) are not negative inside.
        edge: shape (3, 3); the same of column, row and 1.
    """
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        cross[i, 0] = place[k, 1] * place[j, 2] - place[k, 2] * place[j, 1]
        cross[i, 1] = place[k, 2] * place[j, 0] - place[k, 0] * place[j, 2]
        cross[i, 2] = place[k, 0] * place[j, 1] - place[k, 1] * place[j, 0]
        edge[i, 0], edge[i, 1] = cross[i, 0] / lens[0], cross[i, 1] / lens[1]
        edge[i, 2] = cross[i, 2] - edge[i, 0] * lens[2] - edge[i, 1] * lens[3]
    volume: float = (
        place[0, 0] * cross[0, 0] + place[0, 1] * cross[0, 1] + place[0, 2] * cross[0, 2]
    )
    return volume


@inlined
def _frame(place: Array, lens: Array, height: int, width: int) -> tuple[int, int, int, int]:
    """Return rows and columns that a triangle may cover: top, bottom, left, right.

    Where it covers none, bottom < top.
    """
    if min(place[0, 2], place[1, 2], place[2, 2]) < _IN_FRONT_M:
        return 0, height - 1, 0, width - 1
    left, right, top, bottom = 1e30, -1e30, 1e30, -1e30
    for i in range(3):
        inverse = 1.0 / place[i, 2]
        x = lens[0] * place[i, 0] * inverse + lens[2]
        y = lens[1] * place[i, 1] * inverse + lens[3]
        left, right = min(left, x), max(right, x)
        top, bottom = min(top, y), max(bottom, y)
    if right < 0.0 or left > width - 1.0 or bottom < 0.0 or top > height - 1.0:
        return 0, -1, 0, -1
    # A sample on the border counts; rounding may have moved the border past it.
    return (
        math.ceil(max(0.0, top) - 1e-6),
        math.floor(min(height - 1.0, bottom) + 1e-6),
        math.ceil(max(0.0, left) - 1e-6),
        math.floor(min(width - 1.0, right) + 1e-6),
    )


@inlined
def _samples(low: float, high: float, left: int, right: int) -> tuple[int, int]:
    """Return the first and last column within limits; none: last < first."""
    if low > right or high < left:
        return 0, -1
    return math.ceil(max(low, float(left))), math.floor(min(high, float(right)))


@inlined
def _limits(edge: Array, i: int) -> tuple[float, float, float, float]:
    """Return an edge as limits of the column: slope per row and value at row 0, below and above.

    A level edge becomes a very steep one, so that its limit lies far outside on one of its sides.
    """
    if edge[i, 0] >= 0.0:
        scale = -1.0 / max(edge[i, 0], 1e-30)
        return scale * edge[i, 1], scale * edge[i, 2], 0.0, 1e300
    scale = -1.0 / edge[i, 0]
    return 0.0, -1e300, scale * edge[i, 1], scale * edge[i, 2]


@compiled
def _draw_span(
    base: np.float32, slope: np.float32, number: np.int32, ramp: Array, depths: Array, owners: Array
) -> int:
    """Take the samples of one span where the triangle is nearer; return the number of those.

    Plain enough for the compiler to do several samples at once.
    """
    sample_count = np.int32(0)
    for i in range(depths.shape[0]):
        inverse = base + slope * ramp[i]
        if inverse > depths[i]:
            depths[i] = inverse
            owners[i] = number
            sample_count += np.int32(1)
    return int(sample_count)


@inlined
def _write_planes(
    scratch: Array, volume: float, mesh: Triangles, n: int, fog_per_m: float, plane: Array
) -> None:
    """Write the planes of a triangle's values over z into ``plane``."""
    place, cross = scratch[0], scratch[1]
    a, b, c = 1.0 / volume, 1.0 / volume, 1.0 / volume
    for k in range(3):
        plane[G_INVERSE + k] = a * cross[0, k] + b * cross[1, k] + c * cross[2, k]
    for m in range(CORNER_ATTRIBUTES):
        a = mesh.attributes[n, 0, m] / volume
        b = mesh.attributes[n, 1, m] / volume
        c = mesh.attributes[n, 2, m] / volume
        start = G_COLOUR + 3 * m if m < 3 else G_UV + 3 * (m - 3)
        for k in range(3):
            plane[start + k] = a * cross[0, k] + b * cross[1, k] + c * cross[2, k]
    a = math.exp(-fog_per_m * max(0.0, place[0, 2])) / volume
    b = math.exp(-fog_per_m * max(0.0, place[1, 2])) / volume
    c = math.exp(-fog_per_m * max(0.0, place[2, 2])) / volume
    for k in range(3):
        plane[G_CLEAR + k] = a * cross[0, k] + b * cross[1, k] + c * cross[2, k]
    plane[G_KIND] = mesh.kinds[n]


@compiled
def rasterise(
    mesh: Triangles, runs: Array, eye: Eye, fog_per_m: float, count: int, samples: Samples
) -> int:
    """Draw the front sides of triangles where they are nearest.

    Args:
        mesh: counter-clockwise as seen from the front.
        runs: shape (r, 2): first and end of the runs of triangles to draw; near ones first is
            faster.
        eye: that sees them.
        fog_per_m: extinction, 1/m.
        count: triangles that the samples' planes hold already.
        samples: inverse_depth and owner are updated; to planes those are appended that were seen.

    Returns:
        Triangles that the planes hold now.
    """
    lens, inverse_depth, owner = eye.lens, samples.inverse_depth, samples.owner
    height, width = inverse_depth.shape
    scratch = samples.triangle
    place, cross, edge = scratch[0], scratch[1], scratch[2]
    for r in range(runs.shape[0]):
        for n in range(runs[r, 0], runs[r, 1]):
            if _to_optical(mesh.corners, n, eye, place) < _IN_FRONT_M:
                continue
            volume = _edges(place, lens, cross, edge)
            if volume < _FLAT:
                continue
            top, bottom, left, right = _frame(place, lens, height, width)
            if right < left or bottom < top:
                continue
            a, a_low, b, b_high = _limits(edge, 0)
            c, c_low, d, d_high = _limits(edge, 1)
            e, e_low, f, f_high = _limits(edge, 2)
            per_column = (edge[0, 0] + edge[1, 0] + edge[2, 0]) / volume
            per_row = (edge[0, 1] + edge[1, 1] + edge[2, 1]) / volume
            corner = (edge[0, 2] + edge[1, 2] + edge[2, 2]) / volume
            sample_count = 0
            for row in range(top, bottom + 1):
                low = max(max(a * row + a_low, c * row + c_low), e * row + e_low)
                high = min(min(b * row + b_high, d * row + d_high), f * row + f_high)
                first, last = _samples(low, high, left, right)
                if last < first:
                    continue
                base = corner + per_row * row + per_column * first
                sample_count += _draw_span(
                    np.float32(base),
                    np.float32(per_column),
                    np.int32(count),
                    samples.ramp,
                    inverse_depth[row, first : last + 1],
                    owner[row, first : last + 1],
                )
            if sample_count > 0:
                _write_planes(scratch, volume, mesh, n, fog_per_m, samples.planes[count])
                count += 1
    return count


@compiled
def rasterise_cover(corners: Array, runs: Array, eye: Eye, scratch: Array, cover: Array) -> None:
    """Mark the samples that the front sides of triangles cover, whatever their depth.

    Args:
        corners: see rasterise.
        runs: see rasterise.
        eye: see rasterise.
        scratch: shape (3, 3, 3), for numbers of one triangle.
        cover: shape (rows, columns), uint8; covered samples become 1.
    """
    height, width = cover.shape
    place, cross, edge = scratch[0], scratch[1], scratch[2]
    for r in range(runs.shape[0]):
        for n in range(runs[r, 0], runs[r, 1]):
            if _to_optical(corners, n, eye, place) < _IN_FRONT_M:
                continue
            if _edges(place, eye.lens, cross, edge) < _FLAT:
                continue
            top, bottom, left, right = _frame(place, eye.lens, height, width)
            if right < left or bottom < top:
                continue
            a, a_low, b, b_high = _limits(edge, 0)
            c, c_low, d, d_high = _limits(edge, 1)
            e, e_low, f, f_high = _limits(edge, 2)
            for row in range(top, bottom + 1):
                low = max(max(a * row + a_low, c * row + c_low), e * row + e_low)
                high = min(min(b * row + b_high, d * row + d_high), f * row + f_high)
                first, last = _samples(low, high, left, right)
                cover[row, first : last + 1] = 1
