"""What the map itself has beside the road: buildings, trees, poles and signs, in their places."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import Building, Road, SceneryItem, Sign, Tree
from ssp_core.world.scenery import Clearance, half_extent_m, item_pose
from ssp_ot_controller.camera import ground, signs
from ssp_ot_controller.camera.bend import block_line
from ssp_ot_controller.camera.mesh import Mesh
from ssp_ot_controller.camera.palettes import Palette
from ssp_ot_controller.camera.props import building_of, lamp_post, pole, tree_of

Kind = Literal["building", "tree", "pole", "sign", "other"]
# Crowns touch, hedges don't grow into walls.
_ROOM_M = 0.5


@dataclass(frozen=True)
class Prop:
    """One thing beside the road.

    Args:
        mesh: in the block's frame.
        x_m, y_m: its place.
        radius_m: it stays within this distance of its place.
        casts_shadow: whether its shadow on the ground is drawn.
    """

    mesh: Mesh
    x_m: float
    y_m: float
    radius_m: float
    casts_shadow: bool = True


@dataclass(frozen=True)
class Mapped:
    """The map's things.

    Args:
        items: those that can stand where they are.
        poses: theirs, block frame.
    """

    items: tuple[SceneryItem, ...]
    poses: tuple[Pose2, ...]

    def leave_no_room(self, kind: Kind, mesh: Mesh, pose: Pose2) -> bool:
        """Whether something that isn't the map's is not to stand at a pose.

        Args:
            kind: of the thing; the map says all where it has any of that kind.
            mesh: in its own frame.
            pose: block frame.
        """
        if not self.items:
            return False
        if any(item.type == kind for item in self.items):
            return True
        low, high = mesh.corners[..., :2].min(axis=(0, 1)), mesh.corners[..., :2].max(axis=(0, 1))
        middle = Pose2(*pose.to_parent(*((low + high) / 2).tolist()), pose.yaw_rad)
        half = (float(high[0] - low[0]) / 2 + _ROOM_M, float(high[1] - low[1]) / 2 + _ROOM_M)
        return any(
            _overlap(middle, half, other, half_extent_m(item))
            for item, other in zip(self.items, self.poses, strict=True)
        )


def _overlap(a: Pose2, half_a: tuple[float, float], b: Pose2, half_b: tuple[float, float]) -> bool:
    """Whether two rectangles overlap: no side of either lies between them."""
    dx, dy = b.x_m - a.x_m, b.y_m - a.y_m
    turn = abs(math.cos(b.yaw_rad - a.yaw_rad)), abs(math.sin(b.yaw_rad - a.yaw_rad))
    for pose, own, other in ((a, half_a, half_b), (b, half_b, half_a)):
        c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        if abs(dx * c + dy * s) >= own[0] + other[0] * turn[0] + other[1] * turn[1]:
            return False
        if abs(dy * c - dx * s) >= own[1] + other[0] * turn[1] + other[1] * turn[0]:
            return False
    return True


def mapped_things(road: Road) -> Mapped:
    """What of a road's scenery can stand where it is; nothing is drawn on the lanes."""
    if not road.scenery:
        return Mapped((), ())
    line = block_line(road)
    clearance = Clearance(line, [(lane.y_m, lane.width_m) for lane in road.lanes])
    items = tuple(item for item in road.scenery if clearance.problem(item) is None)
    return Mapped(items, tuple(item_pose(item, line) for item in items))


def mapped_props(
    mapped: Mapped, road: Road, palette_name: str, palette: Palette, seed: int
) -> list[Prop]:
    """The map's things; the seed gives them only their colours and the shape of leaves."""
    found = []
    for i, (item, pose) in enumerate(zip(mapped.items, mapped.poses, strict=True)):
        rng = np.random.default_rng(np.random.SeedSequence([seed, 0x3A99ED, i]))
        mesh = _mesh(item, road, rng, palette, pitched=palette_name == "suburb")
        floor = ground.ground_height(road, item.l_m)
        reach = float(np.hypot(mesh.corners[..., 0], mesh.corners[..., 1]).max())
        reach = max(reach, float(mesh.corners[..., 2].max()))
        found.append(
            Prop(
                mesh.placed(pose, floor),
                pose.x_m,
                pose.y_m,
                reach,
                casts_shadow=not isinstance(item, Building),
            )
        )
    return found


def _mesh(
    item: SceneryItem, road: Road, rng: np.random.Generator, palette: Palette, *, pitched: bool
) -> Mesh:
    if isinstance(item, Building):
        return building_of(rng, palette, item.length_m, item.width_m, item.height_m, pitched)
    if isinstance(item, Sign):
        return signs.sign_of(item)
    if isinstance(item, Tree):
        return tree_of(rng, palette, item.height_m)
    if item.lamp:
        left = item.l_m > (road.left_edge_m + road.right_edge_m) / 2
        return lamp_post(-1.0 if left else 1.0, palette, item.height_m)
    return pole(item.height_m)
