"""The effects of dusk and rain on a picture: the light of lamps, streaks, and wet ground.

A road in the rain mirrors what stands beyond it, the more the flatter one looks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from ssp_core.run_file.model import Camera
from ssp_core.run_file.road import Road
from ssp_core.world.camera import intrinsics, optical_axes
from ssp_ot_controller.camera.kernels.bend import Bend, locate
from ssp_ot_controller.camera.kernels.jit import Array, compiled
from ssp_ot_controller.camera.kernels.palettes import Colour
from ssp_ot_controller.camera.kernels.shading import LAMP, noise_at
from ssp_ot_controller.camera.renderer.bodies import Body
from ssp_ot_controller.camera.renderer.frame import LightField
from ssp_ot_controller.camera.renderer.stage import Stage

# Of a beam: place, direction, cosine of the half angle, strength, range.
_BEAM_NUMBERS = 9

_HEAD_HEIGHT_M, _HEAD_ASIDE_M = 0.65, 0.6
_LEAST_HALF_M = 0.39  # what is narrower has no headlamps
_HEAD_DOWN = 0.035  # tangent
_HEAD_COS, _HEAD_STRENGTH, _HEAD_RANGE_M = math.cos(math.radians(33.0)), 1.5, 80.0
_STREET_COS, _STREET_STRENGTH, _STREET_RANGE_M = math.cos(math.radians(68.0)), 1.7, 24.0
_STREET_ABOVE_M = 4.0  # lamps that hang higher light the street
_MOST_BEAMS = 28
_BEAM_RANGE_M = 110.0  # of what is lit at all
_HALF_DISTANCE_M = 22.0


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
    """Add what beams light up, as a factor on the light that is there."""
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
                    beams[n, 7]
                    * share
                    * share
                    * edge
                    / (1.0 + square / (_HALF_DISTANCE_M * _HALF_DISTANCE_M))
                )
            if gain > 0.0:
                # No brighter than white, all channels alike: what is red stays red.
                brightest = max(light[v, u, 0], light[v, u, 1], light[v, u, 2], 1.0)
                gain = min(gain, max(0.0, 255.0 / brightest - 1.0))
                light[v, u, 0] *= 1.0 + 0.8 * gain
                light[v, u, 1] *= 1.0 + 0.93 * gain
                light[v, u, 2] *= 1.0 + gain


def _headlamps(body: Body) -> list[list[float]]:
    """Return two dipped beams at the front of a motor vehicle."""
    half_m = 0.5 * body.size.width_m
    if half_m < _LEAST_HALF_M:
        return []
    c, s = math.cos(body.pose.yaw_rad), math.sin(body.pose.yaw_rad)
    beam = [c, s, -_HEAD_DOWN, _HEAD_COS, _HEAD_STRENGTH, _HEAD_RANGE_M]
    aside_m = min(_HEAD_ASIDE_M, half_m)
    return [
        [*body.pose.to_parent(body.size.front_m, side * aside_m), _HEAD_HEIGHT_M, *beam]
        for side in (-1.0, 1.0)
    ]


def _street_lamps(stage: Stage, eye: Array) -> list[list[float]]:
    """Return a wide beam downwards under each thing beside the road that shines high up.

    The nearest comes first.
    """
    lit = stage.static.bodies
    beams = []
    near = np.hypot(*(stage.static.places[:, :2] - eye[:2]).T) < _BEAM_RANGE_M
    for index in np.flatnonzero(near):
        first, end = stage.static.body_ranges[index]
        shine = lit.kinds[first:end] == LAMP
        if not shine.any():
            continue
        x, y, z = lit.corners[first:end][shine].reshape(-1, 3).mean(axis=0)
        if z > _STREET_ABOVE_M:
            beams.append(
                [
                    float(x),
                    float(y),
                    float(z),
                    0.0,
                    0.0,
                    -1.0,
                    _STREET_COS,
                    _STREET_STRENGTH,
                    _STREET_RANGE_M,
                ]
            )
    return beams


def illuminate(field: LightField, stage: Stage, bodies: Sequence[Body]) -> None:
    """Let headlamps, the VUT's too, and street lamps light up what they reach; in place."""
    eye = field.view.position_m
    beams = [beam for body in bodies for beam in _headlamps(body)]
    beams += _street_lamps(stage, eye)
    table = np.array(beams, dtype=np.float64).reshape(-1, _BEAM_NUMBERS)
    away = np.hypot(table[:, 0] - eye[0], table[:, 1] - eye[1])
    table = table[np.argsort(away, kind="stable")[:_MOST_BEAMS]]
    _illuminate(
        field.light, field.inverse_depth, field.shines, eye, field.rays, table, _BEAM_RANGE_M
    )


_STREAKS = 420  # in a downpour
_FALL_MPS = 7.5
_SHORTEST_EXPOSURE_S = 0.012  # of streaks, where the run asks for no motion blur
_NEAR_M, _FAR_M = 1.2, 14.0
_STREAK_LIGHT = 0.36  # share of sky that a near streak shows
_FRACTION_BITS = 3


def add_rain(
    light: Array, sky: Colour, rain: float, speed_mps: float, camera: Camera, seeds: list[int]
) -> Array:
    """Return the light with streaks of rain before it, shape (height, width, 3), float32.

    Args:
        light: that falls on the sensor, shape (height, width, 3), float32.
        sky: what drops show.
        rain: 0 none, 1 a downpour.
        speed_mps: of the VUT, which slants the streaks.
        camera: lens, mounting and exposure time.
        seeds: draw the streaks.
    """
    rng = np.random.default_rng(np.random.SeedSequence([*seeds, 0x4A1B]))
    lens = intrinsics(camera)
    count = round(_STREAKS * rain)
    # Even in the picture, and in the inverse of the depth: most drops are far.
    depth = 1.0 / rng.uniform(1.0 / _FAR_M, 1.0 / _NEAR_M, count)
    u = rng.uniform(-0.1, 1.1, count) * lens.width_px
    v = rng.uniform(-0.1, 1.1, count) * lens.height_px
    strength = _STREAK_LIGHT * np.minimum(1.0, 2.2 / depth) * rng.uniform(0.4, 1.0, count)
    axes = optical_axes(camera.pitch_down_rad, camera.yaw_left_rad, camera.roll_right_rad)
    # Drops come towards the camera and fall, with a little wind.
    seconds = max(camera.exposure_time_s, _SHORTEST_EXPOSURE_S)
    dx, dy, dz = axes @ np.array([-speed_mps, 0.6, -_FALL_MPS]) * seconds
    end = np.maximum(depth + dz, 0.4)
    u1 = lens.cx_px + (depth * (u - lens.cx_px) + lens.fx_px * dx) / end
    v1 = lens.cy_px + (depth * (v - lens.cy_px) + lens.fy_px * dy) / end
    # Lines are drawn in whole numbers, which gives the same pixels everywhere.
    limit = 4 * max(lens.width_px, lens.height_px)
    lines = np.stack([u, v, np.clip(u1, -limit, limit), np.clip(v1, -limit, limit)], axis=1)
    lines = np.rint(lines * (1 << _FRACTION_BITS)).astype(int)
    mask = np.zeros((lens.height_px, lens.width_px), np.uint8)
    for n in np.argsort(strength, kind="stable"):
        a, b, grey = lines[n, :2].tolist(), lines[n, 2:].tolist(), round(255 * float(strength[n]))
        thickness = 2 if depth[n] < 0.6 * _FAR_M * lens.width_px / 4000 else 1
        cv2.line(mask, a, b, grey, thickness, cv2.LINE_AA, _FRACTION_BITS)
    share = mask[:, :, None].astype(np.float32) / np.float32(255.0)
    return np.asarray(light + share * (np.array(sky, np.float32) - light))


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
    """Mix the mirror image into the ground's light, column by column.

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
    """Make carriageway and sidewalks wet; in place.

    Args:
        field: of a camera without roll.
        stage: of the road.
        road: gives where carriageway and sidewalks end.
        rain: 0 none, 1 a downpour.
    """
    _reflect(
        field.light.copy(),
        field.inverse_depth,
        field.view.position_m,
        field.rays,
        stage.around.bend,
        stage.around.noise,
        road.left_edge_m + road.sidewalk_left_m,
        road.right_edge_m - road.sidewalk_right_m,
        _STRENGTH * math.sqrt(rain),
        field.light,
    )
