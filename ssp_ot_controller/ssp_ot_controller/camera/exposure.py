"""What happens between the scene and the sensor: motion blur, lamps, wet ground, roll, rain.

The exposure ends at the frame's stamp: nothing in a picture is later than its stamp.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ssp_core.run_file.model import Camera, Look
from ssp_core.world.camera import object_corners, project, view_from
from ssp_ot_controller.camera import night, rain, raster_frame, tilt, wet
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.placing import bodies_of, to_block
from ssp_ot_controller.camera.scene import Scene
from ssp_ot_controller.camera.stage import Detail, stage_for

_PX_PER_SUBFRAME = 2.0  # motion between neighbours that the eye takes for a smear
_MOST_SUBFRAMES = 16
_GROUND_AHEAD_M = (4.0, 8.0, 16.0)
_GROUND_ASIDE_M = (-3.0, 0.0, 3.0)


def exposed(
    scene: Scene, look: Look, camera: Camera, frame_index: int, seed: int, detail: Detail
) -> Array:
    """The light on the sensor, shape (height, width, 3), float32.

    Args:
        scene, look, camera, frame_index, seed, detail: see render.
    """
    stage = stage_for(scene.road, look, seed, detail)
    level = tilt.level(camera)
    bodies = bodies_of(scene, stage)
    view = view_from(to_block(scene.vut.pose, scene.road.origin.pose), level)
    field = raster_frame.light_field(stage, look, view, bodies)
    count = subframes(scene, camera)
    if count > 1:
        total = field.light.copy()
        for k in range(1, count):
            earlier = scene.before(camera.exposure_time_s * k / (count - 1))
            at = view_from(to_block(earlier.vut.pose, scene.road.origin.pose), level)
            total += raster_frame.light_field(stage, look, at, bodies_of(earlier, stage)).light
        field = replace(field, light=total / np.float32(count))
    if look.light == "dusk":
        night.illuminate(field, stage, bodies)
    if look.rain > 0.0:
        wet.reflect(field, stage, scene.road, look.rain)
    if stage.palette.lamps_on and (look.rain > 0.0 or look.light == "dusk"):
        night.halos(field, stage, bodies)
    light = tilt.lean(field.light, camera)
    if look.rain > 0.0:
        light = rain.fall(light, stage, scene, look, camera, frame_index, seed)
    return light


def subframes(scene: Scene, camera: Camera) -> int:
    """How many pictures an exposure is the mean of: by the motion of what moves most in it, px."""
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
        seen = a.in_front & b.in_front & (np.abs(a.u_px - camera.width_px / 2) < camera.width_px)
        if seen.any():
            way = np.hypot(a.u_px - b.u_px, a.v_px - b.v_px)[seen]
            moves.append(float(way.max()))
    wanted = math.ceil(max(moves) / _PX_PER_SUBFRAME)
    return min(_MOST_SUBFRAMES, wanted + 1) if wanted > 0 else 1
