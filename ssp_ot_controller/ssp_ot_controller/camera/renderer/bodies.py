"""Bodies of a scene's objects: meshes with lamps and limbs, places, shadows and footprints."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.camera.kernels import ground
from ssp_ot_controller.camera.kernels.bend import offsets_of
from ssp_ot_controller.camera.kernels.palettes import Palette, rgb
from ssp_ot_controller.camera.kernels.raster import Triangles
from ssp_ot_controller.camera.meshes import people, vehicles
from ssp_ot_controller.camera.meshes.mesh import Mesh
from ssp_ot_controller.camera.meshes.vehicles import Lights
from ssp_ot_controller.camera.renderer.scene import Indicator, Scene, is_lit
from ssp_ot_controller.camera.renderer.stage import Stage, lighted

BRAKE_MPS2 = -0.5  # brake lamps shine below this acceleration
_BUS_PAINTS = (rgb("c9432f"), rgb("2f6fae"), rgb("e0b23c"))


def body(
    state: ObjectState, palette: Palette, travelled_m: float, indicator: Indicator | None
) -> Mesh:
    """The mesh of an object in its own frame; colours follow from its id.

    Args:
        state: gives class, extents, acceleration (brake lamps) and stamp (blinking).
        travelled_m: way so far; moves limbs.
    """
    number = zlib.crc32(state.object_id.encode())
    lit = is_lit(state.stamp_ns)
    lights = Lights(
        state.acceleration_mps2 < BRAKE_MPS2,
        palette.lamps_on,
        left=lit and indicator is Indicator.LEFT,
        right=lit and indicator is Indicator.RIGHT,
    )
    paint = palette.paints[number % len(palette.paints)]
    look = people.outfit(number, palette.clothes, palette.trousers)
    match state.object_class:
        case ObjectClass.TRUCK:
            return vehicles.truck(state.size, paint, lights)
        case ObjectClass.BUS:
            livery = _BUS_PAINTS[number % len(_BUS_PAINTS)]
            return vehicles.bus(state.size, livery, lights)
        case ObjectClass.MOTORCYCLE:
            return people.motorcycle(state.size, look, lights)
        case ObjectClass.CYCLIST:
            return people.cyclist(state.size, look, travelled_m, lights.lamps)
        case ObjectClass.PEDESTRIAN:
            return people.pedestrian(state.size, look, travelled_m, state.speed_mps)
        case _:
            return vehicles.car(state.size, paint, number // 16, lights)


@dataclass(frozen=True)
class Body:
    """One object in its place.

    Args:
        floor_m: height of the ground that it stands on.
        drawn: False for the VUT, which only casts a shadow.
        outline: x, y, cos yaw, sin yaw, front, rear, half width of what darkens the ground.
    """

    floor_m: float
    lit: Triangles
    drawn: bool
    outline: tuple[float, ...]


def to_block(pose: Pose2, origin: Pose2) -> Pose2:
    """A pose of frame map in the block's frame."""
    x, y = origin.to_local(pose.x_m, pose.y_m)
    return Pose2(x, y, pose.yaw_rad - origin.yaw_rad)


def bodies_of(scene: Scene, stage: Stage) -> list[Body]:
    """All objects of a scene, the VUT last."""
    origin = scene.road.origin.pose
    everyone = [*scene.others, scene.vut]
    poses = [to_block(state.pose, origin) for state in everyone]
    offsets = offsets_of(stage.around.bend, np.array([(p.x_m, p.y_m) for p in poses]))
    found = []
    for state, pose, offset in zip(everyone, poses, offsets, strict=True):
        floor = ground.ground_height(scene.road, float(offset))
        key = state.object_id
        mesh = body(
            state, stage.palette, scene.travelled_m.get(key, 0.0), scene.indicators.get(key)
        )
        placed = lighted(mesh, stage.palette, stage.sun, pose, floor)
        size = state.size
        inset = 0.12 * size.width_m
        outline = (
            pose.x_m, pose.y_m, math.cos(pose.yaw_rad), math.sin(pose.yaw_rad),
            size.front_m - inset, size.rear_m - inset, size.width_m / 2 - inset,
        )  # fmt: skip
        found.append(Body(floor, placed, state is not scene.vut, outline))
    return found
