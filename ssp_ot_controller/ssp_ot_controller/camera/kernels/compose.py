"""Puts a frame together row by row, ground and sky behind the drawn bodies; its working memory."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, replace

import numpy as np

from ssp_ot_controller.camera.kernels import sensor
from ssp_ot_controller.camera.kernels.bend import bent_row
from ssp_ot_controller.camera.kernels.ground import ground_row
from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined
from ssp_ot_controller.camera.kernels.raster import PLANE_NUMBERS
from ssp_ot_controller.camera.kernels.sensor import develop_row
from ssp_ot_controller.camera.kernels.shading import shade_run
from ssp_ot_controller.camera.kernels.sky import sky_row

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


# Layout of the vector of numbers that compose wants.
C_FOG, C_SHADOW, C_FOG_PER_M, C_EXPOSURE, C_NOISE = 0, 3, 6, 7, 8
PARAMETERS = 9

_LEVEL = -1e-4  # rays that fall less than this per metre are taken for level
_CONTACT = 0.6  # light that the ground loses under a body


@inlined
def _count_drawn(inverse_depth: Array, v: int, drawn: Array, hidden: Array) -> int:
    """Drawn samples per pixel of a row, and whether those are all; returns the row's sum."""
    total = 0
    j = np.uint64(SAMPLES * v)
    for u in range(np.uint64(drawn.shape[0])):
        count = 0
        for i in range(np.uint64(SAMPLES)):
            count += inverse_depth[j, u + u + i] > 0.0
            count += inverse_depth[j + np.uint64(1), u + u + i] > 0.0
        drawn[u] = count
        hidden[u] = count == SAMPLES * SAMPLES
        total += count
    return total


@inlined
def _light_ground(
    numbers: Array, clear: float, cover: Array, v: int, dark: Array, row: Array
) -> None:
    """Shadow, contact and fog on the ground of one image row."""
    upper, lower = cover[SAMPLES * v], cover[SAMPLES * v + 1]
    for u in range(dark.shape[0]):
        shaded = 0
        for i in range(SAMPLES):
            shaded += upper[SAMPLES * u + i] + lower[SAMPLES * u + i]
        shadow = shaded / (SAMPLES * SAMPLES)
        light = 1.0 - _CONTACT * dark[u]
        for k in range(3):
            value = light * row[3 * u + k] * (1.0 - shadow * (1.0 - numbers[C_SHADOW + k]))
            row[3 * u + k] = numbers[C_FOG + k] + clear * (value - numbers[C_FOG + k])


@inlined
def _one_owner(owner: Array, j: np.uint64, u: int, number: int) -> bool:
    """Whether all samples of a pixel show one triangle."""
    one = np.uint64(1)
    i = np.uint64(SAMPLES * u)
    same: bool = (
        owner[j, i] == number
        and owner[j, i + one] == number
        and owner[j + one, i] == number
        and owner[j + one, i + one] == number
    )
    return same


@inlined
def _draw_bodies(
    inverse_depth: Array,
    owner: Array,
    planes: Array,
    lens: Array,
    style: Array,
    noise: Array,
    v: int,
    drawn: Array,
    single: Array,
    row: Array,
) -> None:
    """Puts what was drawn over one image row; each triangle of a pixel is coloured once."""
    every = SAMPLES * SAMPLES
    middle = 0.5 * (SAMPLES - 1)
    step = SAMPLES / lens[0]
    j0 = SAMPLES * v
    width = drawn.shape[0]
    u = 0
    while u < width:
        if drawn[u] == 0:
            u += 1
            continue
        number = owner[j0, SAMPLES * u]
        if drawn[u] == every and _one_owner(owner, np.uint64(j0), u, number):
            end = u + 1
            while end < width and (
                drawn[end] == every and _one_owner(owner, np.uint64(j0), end, number)
            ):
                end += 1
            rx = (SAMPLES * u + middle - lens[2]) / lens[0]
            ry = (j0 + middle - lens[3]) / lens[1]
            shade_run(planes, number, rx, ry, step, style, noise, row[3 * u : 3 * end])
            u = end
            continue
        behind = float(every - drawn[u])
        for k in range(3):
            row[3 * u + k] *= behind
        for s in range(every):
            j, i = j0 + s // SAMPLES, SAMPLES * u + s % SAMPLES
            if inverse_depth[j, i] <= 0.0:
                continue
            number = owner[j, i]
            # The triangle's samples and the middle of those; the first of them does it for all.
            count, x, y = 0, 0, 0
            for other in range(every):
                b, a = j0 + other // SAMPLES, SAMPLES * u + other % SAMPLES
                if inverse_depth[b, a] > 0.0 and owner[b, a] == number:
                    if other < s:
                        count = 0
                        break
                    count, x, y = count + 1, x + a, y + b
            if count == 0:
                continue
            rx, ry = (x / count - lens[2]) / lens[0], (y / count - lens[3]) / lens[1]
            shade_run(planes, number, rx, ry, step, style, noise, single)
            for k in range(3):
                row[3 * u + k] += count * single[k]
        for k in range(3):
            row[3 * u + k] /= every
        u += 1


@compiled
def compose(
    numbers: Array,
    sums: Array,
    strips: Array,
    values: Array,
    ground_numbers: Array,
    nodes: Array,
    cells: Array,
    line: Array,
    panorama: Array,
    noise: Array,
    style: Array,
    position: Array,
    rays: Array,
    lens: Array,
    inverse_depth: Array,
    owner: Array,
    planes: Array,
    cover: Array,
    dark: Array,
    squares: Array,
    grain: Array,
    noise_state: np.uint64,
    row: Array,
    drawn: Array,
    hidden: Array,
    start: Array,
    single: Array,
    light: Array,
    out: Array,
) -> None:
    """Fills a frame, or the light that falls on the sensor where something is to come in between.

    Args:
        numbers: vector of PARAMETERS: fog colour, shadow factor, fog, exposure, noise.
        sums, strips, values: see ground.Tables.
        ground_numbers, panorama, noise: see ground, sky and surfaces.
        nodes, cells, line: see bend.Bend.
        style: see shading.
        position: camera centre, block frame.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        lens: fx, fy, cx, cy in samples.
        inverse_depth, owner, planes: what was drawn, SAMPLES times finer than the frame.
        cover: shadow on the ground, equally fine.
        dark: contact darkening, shape of the frame.
        squares, grain, noise_state: see sensor.
        row, drawn, hidden: memory for one image row: shapes (3 width,), float32; (width,), uint8;
            (width,), bool.
        start, single: memory for one ray and one colour, shape (3,).
        light: shape (height, 3 width), float32, filled in place of ``out``; no rows: not wanted.
        out: shape (height, 3 width), uint8 blue, green, red.
    """
    height = out.shape[0]
    for v in range(height):
        for k in range(3):
            start[k] = rays[0, k] + v * rays[2, k]
        total = _count_drawn(inverse_depth, v, drawn, hidden)
        if start[2] >= _LEVEL:
            sky_row(panorama, start, rays[1], hidden, row)
        else:
            if nodes.shape[0] > 0:
                bent_row(
                    sums, strips, values, ground_numbers, nodes, cells, line, noise, position,
                    start, rays, hidden, row,
                )  # fmt: skip
            else:
                ground_row(
                    sums, strips, values, ground_numbers, noise, position, start, rays, hidden, row
                )
            clear = math.exp(numbers[C_FOG_PER_M] * position[2] / start[2])
            _light_ground(numbers, clear, cover, v, dark[v], row)
        if total > 0:
            _draw_bodies(inverse_depth, owner, planes, lens, style, noise, v, drawn, single, row)
        if light.shape[0] > 0:
            for k in range(row.shape[0]):
                light[v, k] = row[k]
        else:
            develop_row(
                row, squares, v, height, numbers[C_EXPOSURE], numbers[C_NOISE], grain,
                noise_state, out[v],
            )  # fmt: skip
