"""Puts a frame together row by row, ground and sky behind the drawn bodies; its working memory."""

from __future__ import annotations

import math
import threading
from typing import NamedTuple

import numpy as np

from ssp_ot_controller.camera.kernels import sensor
from ssp_ot_controller.camera.kernels.bend import Bend
from ssp_ot_controller.camera.kernels.ground import Ground, ground_row
from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined
from ssp_ot_controller.camera.kernels.palettes import Colour
from ssp_ot_controller.camera.kernels.raster import PLANE_NUMBERS, Eye, Samples
from ssp_ot_controller.camera.kernels.sensor import Film, develop_row
from ssp_ot_controller.camera.kernels.shading import Run, Style, shade_run
from ssp_ot_controller.camera.kernels.sky import sky_row

SAMPLES = 2  # per pixel and axis

_LEVEL = -1e-4  # rays that fall less than this per metre are taken for level


class Surroundings(NamedTuple):
    """The parts of a frame that don't change in its run.

    Args:
        ground: of the road.
        bend: of the road, None where it is straight.
        panorama: of sky.build_panorama.
        noise: tileable noise.
        style: of bodies and fog.
        shadow: factor on sunlit ground, per channel.
        fog_per_m: extinction, 1/m.
    """

    ground: Ground
    bend: Bend | None
    panorama: Array
    noise: Array
    style: Style
    shadow: Colour
    fog_per_m: float


class Buffers(threading.local):
    """Working memory of the last frame size, kept per thread: allocating it is slow."""

    def __init__(self) -> None:
        self._samples: Samples | None = None

    def cleared(self, height: int, width: int, room: int) -> Samples:
        """Return empty memory for a frame of a size, with room for so many triangles."""
        samples = self._samples
        if samples is None or samples.cover.shape != (SAMPLES * height, SAMPLES * width):
            rows, columns = SAMPLES * height, SAMPLES * width
            samples = Samples(
                inverse_depth=np.empty((rows, columns), np.float32),
                owner=np.empty((rows, columns), np.int32),
                planes=np.empty((0, PLANE_NUMBERS)),
                cover=np.empty((rows, columns), np.uint8),
                ramp=np.arange(columns, dtype=np.float32),
                squares=sensor.falloff(width),
                row=np.zeros(3 * width, np.float32),
                drawn=np.empty(width, np.uint8),
                hidden=np.empty(width, np.bool_),
                triangle=np.empty((3, 3, 3)),
                ray=np.empty(3),
                single=np.empty(3, np.float32),
            )
        if len(samples.planes) < room:
            samples = samples._replace(planes=np.empty((2 * room, PLANE_NUMBERS)))
        self._samples = samples
        samples.inverse_depth.fill(0.0)
        samples.cover.fill(0)
        return samples


@inlined
def _count_drawn(inverse_depth: Array, v: int, counts: Array, hidden: Array) -> int:
    """Count drawn samples per pixel of a row, note where all are, and return the row's sum."""
    total = 0
    j = np.uint64(SAMPLES * v)
    for u in range(np.uint64(counts.shape[0])):
        count = 0
        for i in range(np.uint64(SAMPLES)):
            count += inverse_depth[j, u + u + i] > 0.0
            count += inverse_depth[j + np.uint64(1), u + u + i] > 0.0
        counts[u] = count
        hidden[u] = count == SAMPLES * SAMPLES
        total += count
    return total


@inlined
def _light_ground(
    fog: Colour, shadow_light: Colour, clear: float, cover: Array, v: int, row: Array
) -> None:
    """Put shadow and fog on the ground of one image row."""
    upper, lower = cover[SAMPLES * v], cover[SAMPLES * v + 1]
    for u in range(row.shape[0] // 3):
        shaded = 0
        for i in range(SAMPLES):
            shaded += upper[SAMPLES * u + i] + lower[SAMPLES * u + i]
        shadow = shaded / (SAMPLES * SAMPLES)
        for k in range(3):
            value = row[3 * u + k] * (1.0 - shadow * (1.0 - shadow_light[k]))
            row[3 * u + k] = fog[k] + clear * (value - fog[k])


@inlined
def _one_owner(owner: Array, j: np.uint64, u: int, number: int) -> bool:
    """Tell whether all samples of a pixel show one triangle."""
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
def _draw_bodies(samples: Samples, lens: Array, style: Style, noise: Array, v: int) -> None:
    """Put what was drawn over one image row; each triangle of a pixel is coloured once."""
    inverse_depth, owner, planes = samples.inverse_depth, samples.owner, samples.planes
    counts, single, row = samples.drawn, samples.single, samples.row
    every = SAMPLES * SAMPLES
    middle = 0.5 * (SAMPLES - 1)
    step = SAMPLES / lens[0]
    j0 = SAMPLES * v
    width = counts.shape[0]
    u = 0
    while u < width:
        if counts[u] == 0:
            u += 1
            continue
        number = owner[j0, SAMPLES * u]
        if counts[u] == every and _one_owner(owner, np.uint64(j0), u, number):
            end = u + 1
            while end < width and (
                counts[end] == every and _one_owner(owner, np.uint64(j0), end, number)
            ):
                end += 1
            rx = (SAMPLES * u + middle - lens[2]) / lens[0]
            ry = (j0 + middle - lens[3]) / lens[1]
            shade_run(Run(planes, number, rx, ry, step), style, noise, row[3 * u : 3 * end])
            u = end
            continue
        behind = float(every - counts[u])
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
            shade_run(Run(planes, number, rx, ry, step), style, noise, single)
            for k in range(3):
                row[3 * u + k] += count * single[k]
        for k in range(3):
            row[3 * u + k] /= every
        u += 1


@compiled
def compose(
    around: Surroundings, eye: Eye, samples: Samples, film: Film, light: Array, out: Array
) -> None:
    """Fill a frame, or the light that falls on the sensor where something is to come in between.

    Args:
        around: what is behind and around the bodies.
        eye: camera.
        samples: what was drawn.
        film: turns light into numbers.
        light: shape (height, 3 width), float32, filled in place of ``out``; no rows: not wanted.
        out: shape (height, 3 width), uint8 blue, green, red.
    """
    height = out.shape[0]
    start, rays, row, hidden = samples.ray, eye.rays, samples.row, samples.hidden
    for v in range(height):
        for k in range(3):
            start[k] = rays[0, k] + v * rays[2, k]
        total = _count_drawn(samples.inverse_depth, v, samples.drawn, hidden)
        if start[2] >= _LEVEL:
            sky_row(around.panorama, start, rays[1], hidden, row)
        else:
            ground_row(
                around.ground, around.bend, around.noise, eye.position, rays, start, hidden, row
            )
            clear = math.exp(around.fog_per_m * eye.position[2] / start[2])
            _light_ground(around.style.fog, around.shadow, clear, samples.cover, v, row)
        if total > 0:
            _draw_bodies(samples, eye.lens, around.style, around.noise, v)
        if light.shape[0] > 0:
            for k in range(row.shape[0]):
                light[v, k] = row[k]
        else:
            develop_row(row, samples.squares, v, height, film, out[v])
