"""The front camera's picture of a scene, as a pure function.

All work is done in the block's frame (z up, road surface at 0), where coordinates are small: x is
along the road's start and y to its left. What lies on the ground is a function of the arc length
and the offset of its reference line, which are x and y where the road is straight.

By day, without rain, motion blur or roll the kernels write the picture at once. Otherwise
they give the light on the sensor, and what comes in between is put on top (docs/camera.md).
"""

from __future__ import annotations

import numpy as np

from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import view_from
from ssp_ot_controller.camera import raster_frame
from ssp_ot_controller.camera.bodies import BRAKE_MPS2
from ssp_ot_controller.camera.exposure import exposed
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.placing import bodies_of, to_block
from ssp_ot_controller.camera.scene import Scene
from ssp_ot_controller.camera.stage import FULL, Detail, stage_for

__all__ = ["BRAKE_MPS2", "Scene", "render", "warm_up"]


def render(
    scene: Scene,
    look: Look,
    camera: Camera,
    frame_index: int,
    seed: int,
    detail: Detail = FULL,
) -> Array:
    """The picture that the VUT's front camera takes.

    The same arguments give the same pixels. The seed places scenery and texture; seed and
    frame_index together draw sensor noise and rain.

    Args:
        scene: what is there.
        look: palette, weather, sun (azimuth counter-clockwise from the map's x axis), exposure,
            noise.
        camera: lens, mounting and exposure time.
        frame_index: number of the frame in its run.
        seed: of the run.
        detail: leaves scenery or texture away.

    Returns:
        Shape (height, width, 3), uint8, blue, green, red.
    """
    noise_state = _noise_state(seed, frame_index)
    if _at_once(look, camera):
        stage = stage_for(scene.road, look, seed, detail)
        view = view_from(to_block(scene.vut.pose, scene.road.origin.pose), camera)
        return raster_frame.finished(stage, look, view, bodies_of(scene, stage), noise_state)
    field = exposed(scene, look, camera, frame_index, seed, detail)
    return raster_frame.develop(field, look, noise_state)


def _at_once(look: Look, camera: Camera) -> bool:
    """Whether nothing comes between what is drawn and the sensor."""
    return (
        camera.exposure_time_s == 0.0
        and camera.roll_right_rad == 0.0
        and look.rain == 0.0
        and look.light == "day"
    )


def warm_up(road: Road, look: Look, camera: Camera, seed: int) -> None:
    """Draws one picture, so that kernels are compiled and scenery is built before time matters."""
    x, y = road.origin.pose.to_parent(0.0, road.lanes[0].y_m)
    states = [
        ObjectState(
            name, ObjectClass.CAR, role, 0, x, y, road.origin.yaw_rad, 0.0, 0.0, 0.0,
            DEFAULT_SIZES[ObjectClass.CAR],
        )
        for name, role in (("carrier", Role.VUT), ("other", Role.TRAFFIC))
    ]  # fmt: skip
    render(Scene(road, states[0], (states[1],)), look, camera, 0, seed)


def _noise_state(seed: int, frame_index: int) -> np.uint64:
    return np.uint64(np.random.SeedSequence([seed, frame_index]).generate_state(1, np.uint64)[0])
