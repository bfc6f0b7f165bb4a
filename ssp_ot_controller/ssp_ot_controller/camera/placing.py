"""Puts a scene's bodies in their places: meshes, shadows and footprints in the block's frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Pose2
from ssp_ot_controller.camera import ground, light
from ssp_ot_controller.camera.bend import offsets_of
from ssp_ot_controller.camera.bodies import body
from ssp_ot_controller.camera.indicators import OFF
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.mesh import Mesh
from ssp_ot_controller.camera.scene import Scene
from ssp_ot_controller.camera.stage import Stage


@dataclass(frozen=True)
class Body:
    """One object in its place.

    Args:
        mesh: in its own frame.
        pose: of its reference point, block frame.
        floor_m: height of the ground that it stands on.
        lit: the mesh in its place, with its colours.
        drawn: False for the VUT, which only casts a shadow.
        outline: x, y, cos yaw, sin yaw, front, rear, half width of what darkens the ground.
    """

    mesh: Mesh
    pose: Pose2
    floor_m: float
    lit: light.Lit
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
    offsets = offsets_of(stage.bend, np.array([(p.x_m, p.y_m) for p in poses]))
    found = []
    for state, pose, offset in zip(everyone, poses, offsets, strict=True):
        floor = ground.ground_height(scene.road, float(offset))
        key = state.object_id
        mesh = body(
            state, stage.palette, scene.travelled_m.get(key, 0.0), scene.indicators.get(key, OFF)
        )
        placed = light.lit(mesh, stage.palette, stage.sun, pose, floor)
        size = state.size
        inset = 0.12 * size.width_m
        outline = (
            pose.x_m, pose.y_m, math.cos(pose.yaw_rad), math.sin(pose.yaw_rad),
            size.front_m - inset, size.rear_m - inset, size.width_m / 2 - inset,
        )  # fmt: skip
        found.append(Body(mesh, pose, floor, placed, state is not scene.vut, outline))
    return found


def shadows_of(bodies: Sequence[Body], sun: tuple[float, float, float]) -> Array:
    """Shadows of all bodies on the ground, shape (n, 3, 3)."""
    return np.concatenate([light.shadow_on_ground(b.lit.corners, sun, b.floor_m) for b in bodies])
