"""Bodies of a scene's objects: meshes with lamps and limbs, in their places."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState, Size
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.camera.kernels.palettes import Palette, rgb
from ssp_ot_controller.camera.meshes import people, vehicles
from ssp_ot_controller.camera.meshes.mesh import Mesh
from ssp_ot_controller.camera.meshes.vehicles import Lights
from ssp_ot_controller.camera.renderer.scene import Indicator, Scene, is_lit
from ssp_ot_controller.camera.renderer.stage import Stage

BRAKE_MPS2 = -0.5  # brake lamps shine below this acceleration
_BUS_PAINTS = (rgb("c9432f"), rgb("2f6fae"), rgb("e0b23c"))


def body(
    state: ObjectState, palette: Palette, travelled_m: float, indicator: Indicator | None
) -> Mesh:
    """Return the mesh of an object in its own frame; colours follow from its id.

    Args:
        state: gives class, extents, acceleration (brake lamps) and stamp (blinking).
        palette: gives paints, clothes and lamps.
        travelled_m: way so far; moves limbs.
        indicator: that blinks; None: none does.
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
        pose: of its reference point, block frame; so is the mesh.
        drawn: False for the VUT, which only casts a shadow.
    """

    pose: Pose2
    size: Size
    mesh: Mesh
    drawn: bool


def to_block(pose: Pose2, origin: Pose2) -> Pose2:
    """Return a pose of frame map in the block's frame."""
    x, y = origin.to_local(pose.x_m, pose.y_m)
    return Pose2(x, y, pose.yaw_rad - origin.yaw_rad)


def bodies_of(scene: Scene, stage: Stage) -> list[Body]:
    """Return all objects of a scene, the VUT last."""
    bodies = []
    for state in (*scene.others, scene.vut):
        pose, key = to_block(state.pose, scene.road.origin.pose), state.object_id
        travelled_m, indicator = scene.travelled_m.get(key, 0.0), scene.indicators.get(key)
        mesh = body(state, stage.palette, travelled_m, indicator).placed(pose)
        bodies.append(Body(pose, state.size, mesh, state is not scene.vut))
    return bodies
