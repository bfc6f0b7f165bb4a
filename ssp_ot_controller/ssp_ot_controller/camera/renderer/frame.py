"""The raster renderer: runs the kernels for one frame, on the CPU and without a graphics driver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.run_file.model import Look
from ssp_core.world.camera import View
from ssp_ot_controller.camera.kernels import sensor
from ssp_ot_controller.camera.kernels.compose import SAMPLES, Buffers, compose
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.kernels.raster import (
    G_KIND,
    Eye,
    Samples,
    rasterise,
    rasterise_cover,
)
from ssp_ot_controller.camera.kernels.sensor import Film
from ssp_ot_controller.camera.kernels.shading import LAMP
from ssp_ot_controller.camera.meshes.mesh import join
from ssp_ot_controller.camera.renderer.bodies import Body
from ssp_ot_controller.camera.renderer.stage import Stage, lighted, ranges, shadow_on_ground

SCENERY_RANGE_M = 230.0
SHADOW_RANGE_M = 110.0
_GRAIN = sensor.make_grain()
_BUFFERS = Buffers()


@dataclass(frozen=True)
class LightField:
    """The light that falls on the sensor, before it becomes numbers.

    Args:
        light: shape (height, width, 3), float32, blue, green, red; 255 is white.
        inverse_depth: shape (height, width), float32, 1/m along the optical axis of what is drawn;
            0 where ground or sky shows.
        shines: shape (height, width), bool: lamps, which no light falls on.
        view: the camera, block frame.
    """

    light: Array
    inverse_depth: Array
    shines: Array
    view: View

    @property
    def rays(self) -> Array:
        """Shape (3, 3): direction at pixel (0, 0), and its change per column and per row."""
        return rays_of(self.view)


def rays_of(view: View) -> Array:
    """Return the direction at pixel (0, 0) and its change per column and per row, shape (3, 3)."""
    lens = view.intrinsics
    columns, rows = view.rotation[0] / lens.fx_px, view.rotation[1] / lens.fy_px
    corner = view.rotation[2] - lens.cx_px * columns - lens.cy_px * rows
    return np.stack([corner, columns, rows])


def visible(places: Array, view: View, range_m: float) -> Array:
    """Return indices of props within range and the horizontal field of view, nearest first."""
    forward = view.rotation[2, :2] / np.linalg.norm(view.rotation[2, :2])
    slope = view.intrinsics.width_px / (2 * view.intrinsics.fx_px)
    dx, dy = places[:, 0] - view.position_m[0], places[:, 1] - view.position_m[1]
    radius = places[:, 2]
    ahead = dx * forward[0] + dy * forward[1]
    aside = np.abs(dx * forward[1] - dy * forward[0])
    inside = aside < ahead * slope + radius * math.sqrt(1.0 + slope * slope)
    indices = np.flatnonzero((ahead > -radius) & (ahead < range_m) & inside)
    return np.asarray(indices[np.argsort(ahead[indices], kind="stable")])


def finished(
    stage: Stage, look: Look, view: View, bodies: Sequence[Body], noise_state: np.uint64
) -> Array:
    """Return the picture, shape (height, width, 3), uint8, with the sensor's noise."""
    lens = view.intrinsics
    out = np.empty((lens.height_px, lens.width_px, 3), np.uint8)
    none = np.empty((0, 3 * lens.width_px), np.float32)
    film = _film(look, noise_state)
    _draw(stage, view, bodies, film, none, out.reshape(lens.height_px, -1))
    return out


def light_field(stage: Stage, look: Look, view: View, bodies: Sequence[Body]) -> LightField:
    """Return the light of a frame."""
    lens = view.intrinsics
    shape = (lens.height_px, lens.width_px)
    field = np.empty((*shape, 3), np.float32)
    out = np.empty((lens.height_px, 3 * lens.width_px), np.uint8)
    film = _film(look, np.uint64(0))
    samples = _draw(stage, view, bodies, film, field.reshape(lens.height_px, -1), out)
    depth = np.maximum(
        samples.inverse_depth[::SAMPLES, ::SAMPLES], samples.inverse_depth[1::SAMPLES, 1::SAMPLES]
    )
    shines = np.zeros(shape, np.bool_)
    rows, columns = np.nonzero(depth > 0.0)
    # Of whichever of the two samples above has something.
    upper = samples.inverse_depth[SAMPLES * rows, SAMPLES * columns] > 0.0
    owner = np.where(
        upper,
        samples.owner[SAMPLES * rows, SAMPLES * columns],
        samples.owner[SAMPLES * rows + 1, SAMPLES * columns + 1],
    )
    shines[rows, columns] = samples.planes[owner, G_KIND] == LAMP
    return LightField(field, depth, shines, view)


def develop(field: Array, look: Look, noise_state: np.uint64) -> Array:
    """Convert light, shape (height, width, 3), to numbers, uint8."""
    height, width, _ = field.shape
    out = np.empty((height, width, 3), np.uint8)
    rows = np.ascontiguousarray(field, dtype=np.float32).reshape(height, -1)
    sensor.develop(rows, sensor.falloff(width), _film(look, noise_state), out.reshape(height, -1))
    return out


def _film(look: Look, noise_state: np.uint64) -> Film:
    return Film(float(look.exposure), float(look.noise_sigma), noise_state, _GRAIN)


def _draw(
    stage: Stage, view: View, bodies: Sequence[Body], film: Film, field: Array, out: Array
) -> Samples:
    """Run the kernels for one frame; see compose for ``field`` and ``out``."""
    lens = view.intrinsics
    static, around = stage.static, stage.around
    far = visible(static.places, view, SCENERY_RANGE_M)
    near = visible(static.places, view, SHADOW_RANGE_M)
    # All at once: a call for each costs more than what it does.
    moving = join([b.mesh for b in bodies if b.drawn])
    triangles = lighted(moving, stage.palette, stage.sun, stands=True)
    room = len(moving) + int(np.diff(static.body_ranges[far]).sum())
    buffers = _BUFFERS.cleared(lens.height_px, lens.width_px, room)
    n = SAMPLES
    # Sample i of a pixel's n lies at (i + 0.5) / n - 0.5 px from its centre.
    samples = np.array(
        [n * lens.fx_px, n * lens.fy_px, n * lens.cx_px + (n - 1) / 2, n * lens.cy_px + (n - 1) / 2]
    )
    eye = Eye(view.position_m, view.rotation, rays_of(view), samples)
    flat = shadow_on_ground(np.concatenate([b.mesh.corners for b in bodies]), stage.sun)
    for corners, runs in (
        (flat, ranges([len(flat)])),
        (static.shadows, static.shadow_ranges[near]),
    ):
        rasterise_cover(corners, runs, eye, buffers.triangle, buffers.cover)
    count = rasterise(triangles, ranges([len(moving)]), eye, around.fog_per_m, 0, buffers)
    rasterise(static.bodies, static.body_ranges[far], eye, around.fog_per_m, count, buffers)
    compose(around, eye, buffers, film, field, out)
    return buffers
