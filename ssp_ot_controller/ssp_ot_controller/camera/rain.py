"""Rain before the lens: streaks of falling drops, and drops that sit on the windscreen."""

from __future__ import annotations

import math

import cv2
import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.run_file.model import Camera, Look
from ssp_core.world.camera import intrinsics, optical_axes
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.scene import Scene
from ssp_ot_controller.camera.stage import Stage

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


def fall(
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
        light: of the scene, roll included.
        stage: gives the sky's colour.
        scene: its VUT's speed slants the streaks, its stamp wets the windscreen.
        look: its rain.
        camera: the lens.
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
