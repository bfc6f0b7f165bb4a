"""The front camera's picture of a scene, as a pure function.

All work is done in the block's frame (z up, road surface at 0), where coordinates are small: x is
along the road's start and y to its left. What lies on the ground is a function of the arc length
and the offset of its reference line, which are x and y where the road is straight.

By day, without rain, motion blur or roll the kernels write the picture at once. Otherwise they give
the light on the sensor, and motion blur, lamps, wet ground, roll and rain are put on top
(docs/camera.md). The exposure ends at the frame's stamp: nothing in a picture is later than that.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import object_corners, project, view_from
from ssp_ot_controller.camera.kernels import sensor
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.renderer import frame, weather
from ssp_ot_controller.camera.renderer.bodies import BRAKE_MPS2, bodies_of, to_block
from ssp_ot_controller.camera.renderer.scene import Scene
from ssp_ot_controller.camera.renderer.stage import FULL, Detail, stage_for

_PX_PER_SUBFRAME = 2.0  # motion between neighbours that the eye takes for a smear
_MOST_SUBFRAMES = 16
_GROUND_AHEAD_M = (4.0, 8.0, 16.0)
_GROUND_ASIDE_M = (-3.0, 0.0, 3.0)


def exposed(
    scene: Scene, look: Look, camera: Camera, frame_index: int, seed: int, detail: Detail
) -> Array:
    """Return the light on the sensor, shape (height, width, 3), float32.

    Args:
        scene: see render.
        look: see render.
        camera: see render.
        frame_index: see render.
        seed: see render.
        detail: see render.
    """
    stage = stage_for(scene.road, look, seed, detail)
    level = sensor.level_camera(camera)
    bodies = bodies_of(scene, stage)
    view = view_from(to_block(scene.vut.pose, scene.road.origin.pose), level)
    field = frame.light_field(stage, look, view, bodies)
    count = subframes(scene, camera)
    if count > 1:
        total = field.light.copy()
        for k in range(1, count):
            earlier = scene.before(camera.exposure_time_s * k / (count - 1))
            at = view_from(to_block(earlier.vut.pose, scene.road.origin.pose), level)
            total += frame.light_field(stage, look, at, bodies_of(earlier, stage)).light
        field = replace(field, light=total / np.float32(count))
    if look.light == "dusk":
        weather.illuminate(field, stage, bodies)
    if look.rain > 0.0:
        weather.add_reflections(field, stage, scene.road, look.rain)
    light = sensor.rolled(field.light, camera)
    if look.rain > 0.0:
        sky, speed = stage.palette.sky_horizon, scene.vut.speed_mps
        light = weather.add_rain(light, sky, look.rain, speed, camera, [seed, frame_index])
    return light


def subframes(scene: Scene, camera: Camera) -> int:
    """Count the pictures that an exposure is the mean of, by the largest motion in it, px."""
    if camera.exposure_time_s <= 0.0:
        return 1
    moves = [0.0]
    earlier = scene.before(camera.exposure_time_s)
    after, before = view_from(scene.vut.pose, camera), view_from(earlier.vut.pose, camera)
    ground = [
        (*scene.vut.pose.to_parent(camera.forward_m + ahead, aside), 0.0)
        for ahead in _GROUND_AHEAD_M
        for aside in _GROUND_ASIDE_M
    ]
    pairs = [(np.array(ground), np.array(ground))]
    then = {o.object_id: o for o in earlier.others}
    pairs += [(object_corners(o), object_corners(then[o.object_id])) for o in scene.others]
    for new, old in pairs:
        a, b = project(after, new), project(before, old)
        is_visible = (
            a.in_front & b.in_front & (np.abs(a.u_px - camera.width_px / 2) < camera.width_px)
        )
        if is_visible.any():
            way = np.hypot(a.u_px - b.u_px, a.v_px - b.v_px)[is_visible]
            moves.append(float(way.max()))
    count = math.ceil(max(moves) / _PX_PER_SUBFRAME)
    return min(_MOST_SUBFRAMES, count + 1) if count > 0 else 1


__all__ = ["BRAKE_MPS2", "Scene", "render", "warm_up"]


def render(
    scene: Scene,
    look: Look,
    camera: Camera,
    frame_index: int,
    seed: int,
    detail: Detail = FULL,
) -> Array:
    """Return the picture that the VUT's front camera takes.

    The same arguments give the same pixels. The seed places scenery and texture; seed and
    frame_index together draw sensor noise and rain.

    Args:
        scene: what stands and moves around the VUT, and the VUT itself.
        look: palette, weather, sun (azimuth counter-clockwise from the map's x axis), exposure,
            noise.
        camera: lens, mounting and exposure time.
        frame_index: number of the frame.
        seed: of scenery, texture, noise and rain.
        detail: leaves scenery or texture away.

    Returns:
        Shape (height, width, 3), uint8, blue, green, red.
    """
    noise_state = _noise_state(seed, frame_index)
    if _at_once(look, camera):
        stage = stage_for(scene.road, look, seed, detail)
        view = view_from(to_block(scene.vut.pose, scene.road.origin.pose), camera)
        return frame.finished(stage, look, view, bodies_of(scene, stage), noise_state)
    field = exposed(scene, look, camera, frame_index, seed, detail)
    return frame.develop(field, look, noise_state)


def _at_once(look: Look, camera: Camera) -> bool:
    """Tell whether nothing comes between the drawing and the sensor."""
    return (
        camera.exposure_time_s == 0.0
        and camera.roll_right_rad == 0.0
        and look.rain == 0.0
        and look.light == "day"
    )


def warm_up(road: Road, look: Look, camera: Camera, seed: int) -> None:
    """Draw one picture, so that kernels are compiled and scenery is built before time matters."""
    x, y = road.origin.pose.to_parent(0.0, road.lanes[0].y_m)
    states = [
        ObjectState(
            name,
            ObjectClass.CAR,
            role,
            0,
            x,
            y,
            road.origin.yaw_rad,
            0.0,
            0.0,
            0.0,
            DEFAULT_SIZES[ObjectClass.CAR],
        )
        for name, role in (("carrier", Role.VUT), ("other", Role.TRAFFIC))
    ]
    render(Scene(road, states[0], (states[1],)), look, camera, 0, seed)


def _noise_state(seed: int, frame_index: int) -> np.uint64:
    return np.uint64(np.random.SeedSequence([seed, frame_index]).generate_state(1, np.uint64)[0])
