"""What dusk and rain put on a picture: light and glare of lamps, streaks and drops, and wet ground.

A road in the rain mirrors what stands beyond it, the more the flatter one looks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Road
from ssp_core.world.camera import intrinsics, optical_axes
from ssp_ot_controller.camera.kernels.bend import Bend, locate
from ssp_ot_controller.camera.kernels.jit import Array, compiled
from ssp_ot_controller.camera.kernels.raster import Triangles
from ssp_ot_controller.camera.kernels.shading import LAMP, noise_at
from ssp_ot_controller.camera.renderer.bodies import Body
from ssp_ot_controller.camera.renderer.frame import SCENERY_RANGE_M, LightField, visible
from ssp_ot_controller.camera.renderer.scene import Scene
from ssp_ot_controller.camera.renderer.stage import Stage

# Of a beam: place, direction, cosine of the half angle, strength, range.
_BEAM_NUMBERS = 9

_HEAD_HEIGHT_M, _HEAD_ASIDE_M = 0.65, 0.6
_HEAD_DOWN = 0.035  # tangent
_HEAD_COS, _HEAD_STRENGTH, _HEAD_RANGE_M = math.cos(math.radians(33.0)), 1.5, 80.0
_STREET_COS, _STREET_STRENGTH, _STREET_RANGE_M = math.cos(math.radians(68.0)), 1.7, 24.0
_STREET_ABOVE_M = 4.0  # lamps that hang higher light the street
_MOST_BEAMS = 28
_BEAM_RANGE_M = 110.0  # of what is lit at all
_HALF_DISTANCE_M = 22.0

_GLARE_RANGE_M = 170.0
_OWN_BODY_M = 0.4


@dataclass(frozen=True)
class Lamps:
    """Triangles that shine.

    Args:
        places: shape (n, 3), m, block frame.
        facing: shape (n, 3), their normals times their areas, m^2.
        colours: shape (n, 3), blue, green, red, 0-255.
    """

    places: Array
    facing: Array
    colours: Array


def lamps_of(lit: Triangles) -> Lamps:
    """The triangles of a kind that shines."""
    shine = lit.kinds == LAMP
    corners = lit.corners[shine].astype(np.float64)
    facing = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Lamps(corners.mean(axis=1), facing, lit.attributes[shine][:, 0, :3].astype(np.float64))


@compiled
def _illuminate(
    light: Array,
    inverse_depth: Array,
    shines: Array,
    eye: Array,
    rays: Array,
    beams: Array,
    reach_m: float,
) -> None:
    """Adds what beams light up, as a factor on the light that is there."""
    height, width, _ = light.shape
    for v in range(height):
        for u in range(width):
            if shines[v, u]:
                continue
            dx = rays[0, 0] + u * rays[1, 0] + v * rays[2, 0]
            dy = rays[0, 1] + u * rays[1, 1] + v * rays[2, 1]
            dz = rays[0, 2] + u * rays[1, 2] + v * rays[2, 2]
            if inverse_depth[v, u] > 0.0:
                depth = 1.0 / inverse_depth[v, u]
            elif dz < -1e-4:
                depth = -eye[2] / dz
            else:
                continue
            if depth > reach_m:
                continue
            x, y, z = eye[0] + depth * dx, eye[1] + depth * dy, eye[2] + depth * dz
            gain = 0.0
            for n in range(beams.shape[0]):
                px, py, pz = x - beams[n, 0], y - beams[n, 1], z - beams[n, 2]
                square = px * px + py * py + pz * pz
                if square > beams[n, 8] * beams[n, 8]:
                    continue
                away = math.sqrt(square) + 1e-6
                along = (px * beams[n, 3] + py * beams[n, 4] + pz * beams[n, 5]) / away
                if along <= beams[n, 6]:
                    continue
                share = (along - beams[n, 6]) / (1.0 - beams[n, 6])
                edge = 1.0 - square / (beams[n, 8] * beams[n, 8])
                if beams[n, 5] > -0.5:  # a headlamp: dipped, little goes above its own height
                    rise = pz / away
                    share *= min(1.0, max(0.12, 1.0 - 60.0 * (rise + 0.004)))
                gain += (
                    beams[n, 7] * share * share * edge
                    / (1.0 + square / (_HALF_DISTANCE_M * _HALF_DISTANCE_M))
                )  # fmt: skip
            if gain > 0.0:
                # No brighter than white, all channels alike: what is red stays red.
                brightest = max(light[v, u, 0], light[v, u, 1], light[v, u, 2], 1.0)
                gain = min(gain, max(0.0, 255.0 / brightest - 1.0))
                light[v, u, 0] *= 1.0 + 0.8 * gain
                light[v, u, 1] *= 1.0 + 0.93 * gain
                light[v, u, 2] *= 1.0 + gain


def _headlamps(body: Body) -> list[list[float]]:
    """Two dipped beams at the front of a motor vehicle."""
    x, y, c, s, front, _, half = body.outline
    if half < 0.3:
        return []
    found = []
    for side in (-1.0, 1.0):
        across = side * min(_HEAD_ASIDE_M, half)
        found.append(
            [x + c * front - s * across, y + s * front + c * across,
             body.floor_m + _HEAD_HEIGHT_M, c, s, -_HEAD_DOWN,
             _HEAD_COS, _HEAD_STRENGTH, _HEAD_RANGE_M]
        )  # fmt: skip
    return found


def _street_lamps(stage: Stage, eye: Array) -> list[list[float]]:
    """A wide beam downwards under each thing beside the road that shines high up; nearest first."""
    lit = stage.static.bodies
    found = []
    near = np.hypot(*(stage.static.places[:, :2] - eye[:2]).T) < _BEAM_RANGE_M
    for index in np.flatnonzero(near):
        first, end = stage.static.body_ranges[index]
        shine = lit.kinds[first:end] == LAMP
        if not shine.any():
            continue
        x, y, z = lit.corners[first:end][shine].reshape(-1, 3).mean(axis=0)
        if z > _STREET_ABOVE_M:
            found.append(
                [float(x), float(y), float(z), 0.0, 0.0, -1.0,
                 _STREET_COS, _STREET_STRENGTH, _STREET_RANGE_M]
            )  # fmt: skip
    return found


def illuminate(field: LightField, stage: Stage, bodies: Sequence[Body]) -> None:
    """Lets headlamps, the VUT's too, and street lamps light up what they reach; in place."""
    eye = field.view.position_m
    beams = [beam for body in bodies for beam in _headlamps(body)]
    beams += _street_lamps(stage, eye)
    table = np.array(beams, dtype=np.float64).reshape(-1, _BEAM_NUMBERS)
    away = np.hypot(table[:, 0] - eye[0], table[:, 1] - eye[1])
    table = table[np.argsort(away, kind="stable")[:_MOST_BEAMS]]
    _illuminate(
        field.light, field.inverse_depth, field.shines, eye, field.rays, table, _BEAM_RANGE_M
    )


@compiled
def _add_glare(
    light: Array, u0: float, v0: float, sigma: float, b: float, g: float, r: float
) -> None:
    """Adds a round glare whose light falls off as (1 + d^2 / sigma^2)^-2."""
    height, width, _ = light.shape
    reach = 5.0 * sigma
    for v in range(max(0, int(v0 - reach)), min(height - 1, int(v0 + reach)) + 1):
        for u in range(max(0, int(u0 - reach)), min(width - 1, int(u0 + reach)) + 1):
            square = ((u - u0) * (u - u0) + (v - v0) * (v - v0)) / (sigma * sigma)
            if square < 25.0:
                share = 1.0 / ((1.0 + square) * (1.0 + square)) - 0.00148
                light[v, u, 0] += share * b
                light[v, u, 1] += share * g
                light[v, u, 2] += share * r


def halos(field: LightField, stage: Stage, bodies: Sequence[Body]) -> None:
    """Adds glare around lamps that shine towards the camera and aren't hidden; in place."""
    view, static = field.view, stage.static
    parts = [b.lit for b in bodies if b.drawn]
    far = visible(static.places, view, SCENERY_RANGE_M)
    for index in far:
        first, end = static.body_ranges[index]
        prop = Triangles(*(part[first:end] for part in static.bodies))
        if (prop.kinds == LAMP).any():
            parts.append(prop)
    for part in parts:
        _glare_of(field, lamps_of(part), stage.around.fog_per_m)


def _glare_of(field: LightField, lamps: Lamps, fog_per_m: float) -> None:
    view = field.view
    lens = view.intrinsics
    toward = view.position_m - lamps.places
    optical = -toward @ view.rotation.T
    depth = optical[:, 2]
    distance = np.linalg.norm(toward, axis=1)
    flux = np.einsum("ij,ij->i", lamps.facing, toward) / np.maximum(distance, 1e-6)
    for n in np.flatnonzero((flux > 0.0) & (depth > 0.5) & (depth < _GLARE_RANGE_M)):
        u = lens.fx_px * optical[n, 0] / depth[n] + lens.cx_px
        v = lens.fy_px * optical[n, 1] / depth[n] + lens.cy_px
        column, row = round(float(u)), round(float(v))
        if not (0 <= column < lens.width_px and 0 <= row < lens.height_px):
            continue
        nearest = float(field.inverse_depth[row, column])
        if nearest > 0.0 and 1.0 / nearest < depth[n] - _OWN_BODY_M:
            continue
        scale = lens.width_px / 960.0
        area = flux[n] * (lens.fx_px / depth[n]) ** 2 / (scale * scale)  # px of 960
        clear = math.exp(-fog_per_m * float(depth[n]))
        strength = clear * min(0.6, 0.07 * float(area) ** 0.5)
        b, g, r = strength * lamps.colours[n] * (lamps.colours[n] / 255.0) ** 1.5
        sigma = scale * (1.6 + 1.1 * float(area) ** 0.45)
        _add_glare(field.light, float(u), float(v), sigma, b, g, r)


_STREAKS = 420  # in a downpour
_FALL_MPS = 7.5
_SHORTEST_EXPOSURE_S = 0.012  # of streaks, where the run asks for no motion blur
_NEAR_M, _FAR_M = 1.2, 14.0
_STREAK_LIGHT = 0.36  # share of sky that a near streak shows
_DROPS = 55
_WIPER_S = 1.5  # between two wipes of the windscreen
_DROP_PX = (2.5, 9.0)  # radii in a picture of 960 columns
_LENS_TURNS = 2.6  # a drop shows the scene upside down, from so many radii around it
_FRACTION_BITS = 3


def add_rain(
    light: Array,
    stage: Stage,
    scene: Scene,
    look: Look,
    camera: Camera,
    frame_index: int,
    seed: int,
) -> Array:
    """The light with rain before it, shape (height, width, 3).

    Args:
        scene: its VUT's speed slants the streaks, its stamp wets the windscreen.
        frame_index, seed: draw the streaks.
    """
    sky = np.array(stage.palette.sky_horizon, dtype=np.float32)
    share = _streaks(scene, look, camera, frame_index, seed)[:, :, None]
    wet = light + share * (sky - light)
    _drops(wet, scene, look, camera, seed)
    return np.asarray(wet, dtype=np.float32)


def _streaks(scene: Scene, look: Look, camera: Camera, frame_index: int, seed: int) -> Array:
    """Share of streaks per pixel, shape (height, width), float32."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, frame_index, 0x4A1B]))
    lens = intrinsics(camera)
    count = round(_STREAKS * look.rain)
    # Even in the picture, and in the inverse of the depth: most drops are far.
    depth = 1.0 / rng.uniform(1.0 / _FAR_M, 1.0 / _NEAR_M, count)
    u = rng.uniform(-0.1, 1.1, count) * lens.width_px
    v = rng.uniform(-0.1, 1.1, count) * lens.height_px
    axes = optical_axes(camera.pitch_down_rad, camera.yaw_left_rad, camera.roll_right_rad)
    # Drops come towards the camera and fall, with a little wind.
    seconds = max(camera.exposure_time_s, _SHORTEST_EXPOSURE_S)
    way = axes @ np.array([-scene.vut.speed_mps, 0.6, -_FALL_MPS]) * seconds
    start = np.stack(
        [depth * (u - lens.cx_px) / lens.fx_px, depth * (v - lens.cy_px) / lens.fy_px, depth], 1
    )
    end = start + way
    end[:, 2] = np.maximum(end[:, 2], 0.4)
    u1 = lens.fx_px * end[:, 0] / end[:, 2] + lens.cx_px
    v1 = lens.fy_px * end[:, 1] / end[:, 2] + lens.cy_px
    # Lines are drawn in whole numbers, which gives the same pixels everywhere.
    scale = 1 << _FRACTION_BITS
    mask = np.zeros((lens.height_px, lens.width_px), np.uint8)
    strength = _STREAK_LIGHT * np.minimum(1.0, 2.2 / depth) * rng.uniform(0.4, 1.0, count)
    limit = 4 * max(lens.width_px, lens.height_px)
    for n in np.argsort(strength, kind="stable"):
        a = (round(float(u[n]) * scale), round(float(v[n]) * scale))
        b = (
            round(float(np.clip(u1[n], -limit, limit)) * scale),
            round(float(np.clip(v1[n], -limit, limit)) * scale),
        )
        thickness = 2 if depth[n] < 0.6 * _FAR_M * lens.width_px / 4000 else 1
        cv2.line(
            mask, a, b, round(255 * float(strength[n])), thickness, cv2.LINE_AA, _FRACTION_BITS
        )
    return mask.astype(np.float32) / np.float32(255.0)


def _drops(light: Array, scene: Scene, look: Look, camera: Camera, seed: int) -> None:
    """Drops on the windscreen, more and more until the wiper comes; in place."""
    t_s = ns_to_seconds(scene.vut.stamp_ns)
    sweep = math.floor(t_s / _WIPER_S)
    rng = np.random.default_rng(np.random.SeedSequence([seed, max(0, sweep), 0xD809]))
    count = round(_DROPS * look.rain)
    height, width, _ = light.shape
    u, v = rng.uniform(0.0, width, count), rng.uniform(0.0, height, count)
    radius = (width / 960.0) * rng.uniform(*_DROP_PX, count) * rng.uniform(0.4, 1.0, count)
    lands = rng.uniform(0.0, 1.0, count)
    source = light.copy()
    for n in np.flatnonzero(lands < (t_s / _WIPER_S - sweep)):
        _drop(light, source, float(u[n]), float(v[n]), float(radius[n]))


def _drop(light: Array, source: Array, u: float, v: float, radius: float) -> None:
    height, width, _ = light.shape
    rows = np.arange(max(0, math.floor(v - radius)), min(height, math.ceil(v + radius) + 1))
    columns = np.arange(max(0, math.floor(u - radius)), min(width, math.ceil(u + radius) + 1))
    if len(rows) == 0 or len(columns) == 0:
        return
    dy, dx = (rows - v)[:, None] / radius, (columns - u)[None, :] / radius
    away = np.sqrt(dx * dx + dy * dy)
    share = np.clip((1.0 - away) * radius * 0.6, 0.0, 0.85)
    reach = _LENS_TURNS * radius
    i = np.clip(np.rint(u - dx * reach), 0, width - 1).astype(int)
    j = np.clip(np.rint(v - dy * reach), 0, height - 1).astype(int)
    seen = source[np.broadcast_to(j, away.shape), np.broadcast_to(i, away.shape)]
    rim = (1.0 - 0.35 * np.clip(away - 0.55, 0.0, 1.0) / 0.45)[:, :, None]
    patch = light[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    patch += (share[:, :, None] * (seen * rim - patch)).astype(np.float32)


_STRENGTH = 0.55  # of a mirror, of water that lies in a rough surface


@compiled
def _reflect(
    source: Array,
    inverse_depth: Array,
    eye: Array,
    rays: Array,
    bend: Bend | None,
    noise: Array,
    left_m: float,
    right_m: float,
    strength: float,
    light: Array,
) -> None:
    """Mixes the mirror image into the ground's light, column by column.

    What stands on the ground is mirrored about the row where it stands; where nothing stands, the
    sky is about the horizon.
    """
    height, width, _ = light.shape
    for u in range(width):
        foot = -1
        horizon = -1
        for v in range(height):
            if inverse_depth[v, u] > 0.0:
                foot = v
                continue
            dz = rays[0, 2] + u * rays[1, 2] + v * rays[2, 2]
            if dz >= -1e-3:
                horizon = v
                continue
            dx = rays[0, 0] + u * rays[1, 0] + v * rays[2, 0]
            dy = rays[0, 1] + u * rays[1, 1] + v * rays[2, 1]
            depth = -eye[2] / dz
            x, y = eye[0] + depth * dx, eye[1] + depth * dy
            along, aside = x, y
            if bend is not None:
                along, aside, _, _, _ = locate(bend, x, y)
            if not right_m <= aside <= left_m:
                continue
            sine = -dz / math.sqrt(dx * dx + dy * dy + dz * dz)
            fresnel = 0.03 + 0.97 * (1.0 - sine) ** 5
            puddle = 0.75 + 0.5 * noise_at(noise, 3.0 * along, 9.0 * aside)
            share = min(0.8, max(0.0, strength * fresnel * puddle))
            mirror = max(foot, horizon)
            for k in range(3):
                total = 0.0
                for i in range(5):
                    away = (v - mirror) * (1.0 + 0.08 * (i - 2))
                    row = min(max(int(mirror - away), 0), height - 1)
                    total += 0.2 * source[row, u, k]
                light[v, u, k] += share * (total - light[v, u, k])


def add_reflections(field: LightField, stage: Stage, road: Road, rain: float) -> None:
    """Makes carriageway and sidewalks wet; in place.

    Args:
        field: of a camera without roll.
        rain: 0 none, 1 a downpour.
    """
    _reflect(
        field.light.copy(), field.inverse_depth, field.view.position_m, field.rays,
        stage.around.bend, stage.around.noise,
        road.left_edge_m + road.sidewalk_left_m, road.right_edge_m - road.sidewalk_right_m,
        _STRENGTH * math.sqrt(rain), field.light,
    )  # fmt: skip
