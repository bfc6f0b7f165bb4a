"""What stands beside the road: what the map has, in its place; the rest is placed by seed.

Everything stands outside carriageway and sidewalks, and follows the road where it bends. Poses are
in the block's frame. Where the map has things of a kind, none of that kind are placed by seed, and
what is placed keeps clear of the map's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import Building, Road, SceneryItem, Sign, Tree
from ssp_core.world.scenery import BEFORE_M, BEYOND_M, Clearance, half_extent_m, item_pose
from ssp_ot_controller.camera.kernels import ground
from ssp_ot_controller.camera.kernels.bend import Bend, block_line, offsets_of
from ssp_ot_controller.camera.kernels.palettes import Palette
from ssp_ot_controller.camera.meshes import roadside
from ssp_ot_controller.camera.meshes.mesh import Mesh
from ssp_ot_controller.camera.meshes.roadside import (
    building,
    building_of,
    cone,
    conifer,
    fence,
    hedge,
    lamp_post,
    mast,
    pole,
    tree,
    tree_of,
)

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
        poses: theirs, block frame.
    """

    items: tuple[SceneryItem, ...]
    poses: tuple[Pose2, ...]

    def leave_no_room(self, kind: Kind, mesh: Mesh, pose: Pose2) -> bool:
        """Whether something that isn't the map's is not to stand at a pose.

        Args:
            kind: of the thing; the map says all where it has any of that kind.
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
        return roadside.sign_of(item)
    if isinstance(item, Tree):
        return tree_of(rng, palette, item.height_m)
    if item.lamp:
        left = item.l_m > (road.left_edge_m + road.right_edge_m) / 2
        return lamp_post(-1.0 if left else 1.0, palette, item.height_m)
    return pole(item.height_m)


_FLOOR_M = 3.1
_CLEAR_AT_CROSSING_M = 7.0
_CLEAR_M = 0.2  # from a sidewalk to what stands beside it on a bend
_HEADROOM_M = 2.0  # what is higher may reach over the road
_SAME_PLACE_M = 0.01
_PIECE_M = 4.0  # of long things on a bend
_LIMIT_FROM_M, _LIMIT_EVERY_M = 30.0, 120.0  # from where one comes in
_CROSSING_AHEAD_M = 8.0
_SIGN_BESIDE_M = 0.5  # beyond the sidewalk


@dataclass(frozen=True)
class _Side:
    """One side of the road: + is left."""

    sign: float
    edge_m: float  # lateral position where the sidewalk ends
    raised: bool

    def y(self, distance_m: float) -> float:
        """Lateral position that far beyond the sidewalk."""
        return self.edge_m + self.sign * distance_m


class _Planter:
    """Places props beside one side of the road, and keeps the crossing clear, and the road itself.

    ``rng`` draws the places and the props.
    """

    def __init__(
        self, road: Road, bend: Bend | None, palette: Palette, rng: np.random.Generator
    ) -> None:
        self.props: list[Prop] = []
        self.palette, self.rng = palette, rng
        self.span = (-BEFORE_M, road.length_m + BEYOND_M)
        self.sides = (
            _Side(1.0, road.left_edge_m + max(road.sidewalk_left_m, 1.0), road.sidewalk_left_m > 0),
            _Side(
                -1.0, road.right_edge_m - max(road.sidewalk_right_m, 1.0), road.sidewalk_right_m > 0
            ),
        )
        self.side = self.sides[0]
        self.mapped = mapped_things(road)
        self._crossing = road.crossing_x_m
        self._line, self._bend = block_line(road), bend

    def stations(self, low: float, high: float) -> list[float]:
        """Places along the road whose distances are drawn between low and high."""
        begin, end = self.span
        count = int((end - begin) / low) + 1
        x = begin + np.cumsum(self.rng.uniform(low, high, count))
        return [float(one) for one in x[x < end]]

    def every(self, step_m: float, first_m: float = 0.0) -> list[float]:
        """Places along the road so far apart."""
        return [float(one) for one in np.arange(self.span[0] + first_m, self.span[1], step_m)]

    def add(
        self,
        mesh: Mesh,
        x_m: float,
        distance_m: float,
        kind: Kind = "other",
        shadow: bool = True,
        yaw_rad: float = 0.0,
    ) -> None:
        """Puts a thing at an arc length, that far beyond the sidewalk, if there is room for it."""
        side = self.side
        reach = float(np.abs(mesh.corners[..., :2]).max()) if len(mesh) else 0.0
        if self._crossing is not None and distance_m < 6.0:
            along = float(np.abs(mesh.corners[..., 0]).max())
            if abs(x_m - self._crossing) < _CLEAR_AT_CROSSING_M + along:
                return
        pose = self._pose(mesh, x_m, side.y(distance_m), yaw_rad)
        if pose is None or self.mapped.leave_no_room(kind, mesh, pose):
            return
        placed = mesh.placed(pose, ground.KERB_HEIGHT_M if side.raised else 0.0)
        self.props.append(Prop(placed, pose.x_m, pose.y_m, 1.5 * reach, shadow))

    def add_along(
        self, make: Callable[[float], Mesh], length_m: float, x_m: float, distance_m: float
    ) -> None:
        """Puts a long thing beside the road; in pieces where the road bends."""
        if self._bend is None:
            self.add(make(length_m), x_m, distance_m)
            return
        count = math.ceil(length_m / _PIECE_M)
        for k in range(count):
            middle = x_m + ((k + 0.5) / count - 0.5) * length_m
            stretch = 1.0 - self._line.curvature_1pm(middle) * self.side.y(distance_m)
            if stretch > 0.0:
                self.add(make(stretch * length_m / count), middle, distance_m)

    def _pose(self, mesh: Mesh, s_m: float, l_m: float, yaw_rad: float) -> Pose2 | None:
        """Pose in the block's frame; None: it would stand on the road or in its own way."""
        if self._bend is None:
            return Pose2(s_m, l_m, yaw_rad)
        at = self._line.pose(s_m)
        x, y = at.to_parent(0.0, l_m)
        pose = Pose2(x, y, at.yaw_rad + yaw_rad)
        low = mesh.corners[mesh.corners[..., 2] < _HEADROOM_M]
        (x0, y0), (x1, y1) = low[:, :2].min(axis=0), low[:, :2].max(axis=0)
        outline = [(u, v) for u in (x0, (x0 + x1) / 2, x1) for v in (y0, (y0 + y1) / 2, y1)]
        places = np.array([(x, y), *(pose.to_parent(float(u), float(v)) for u, v in outline)])
        offsets = offsets_of(self._bend, places)
        # Beyond the centre of a bend, or nearer to another stretch, the offset is another one.
        if abs(offsets[0] - l_m) > _SAME_PLACE_M:
            return None
        side = self.side
        return None if (side.sign * (offsets - side.edge_m)).min() < _CLEAR_M else pose


def build_scenery(
    road: Road, bend: Bend | None, palette_name: str, palette: Palette, seed: int
) -> list[Prop]:
    """Everything that stands beside the road, the same for the same seed."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5CE11E]))
    planter = _Planter(road, bend, palette, rng)
    plant = {"suburb": _suburb, "proving_ground": _proving_ground, "dusk_city": _city}[palette_name]
    for side in planter.sides:
        planter.side = side
        plant(planter)
    _put_up_signs(planter, road)
    return planter.props + mapped_props(planter.mapped, road, palette_name, palette, seed)


def _put_up_signs(planter: _Planter, road: Road) -> None:
    """What the road's numbers call for, beside those who drive on the right towards it."""
    limit = roadside.speed_limit_sign(max(5, 5 * round(road.speed_limit_mps * 3.6 / 5)))
    left, right = planter.sides
    going = {lane.direction for lane in road.lanes}
    for side, along, word, yaw in ((right, 1.0, "forward", 0.0), (left, -1.0, "backward", math.pi)):
        if word not in going:
            continue
        planter.side = side
        begin = 0.0 if along > 0.0 else road.length_m
        for k in range(math.ceil(road.length_m / _LIMIT_EVERY_M)):
            x = begin + along * (_LIMIT_FROM_M + k * _LIMIT_EVERY_M)
            planter.add(limit, x, _SIGN_BESIDE_M, "sign", yaw_rad=yaw)
        if road.crossing_x_m is not None:
            x = road.crossing_x_m - along * _CROSSING_AHEAD_M
            planter.add(roadside.crossing_sign(), x, _SIGN_BESIDE_M, "sign", yaw_rad=yaw)


def _suburb(planter: _Planter) -> None:
    rng, palette, add = planter.rng, planter.palette, planter.add
    for x in planter.stations(17.0, 24.0):
        width, depth, floors = rng.uniform(9, 13), rng.uniform(8, 10), int(rng.integers(1, 3))
        house = building(rng, palette, width, depth, _FLOOR_M * floors, pitched=True)
        add(house, x, rng.uniform(12, 16), "building", shadow=False)
        add(hedge(rng.uniform(8, 13), palette), x, 3.6)
    for x in planter.stations(9.0, 19.0):
        add(tree(rng, palette, rng.uniform(0.75, 1.1)), x, rng.uniform(4.6, 8.0), "tree")
    for x in planter.stations(26.0, 44.0):
        add(conifer(rng, palette), x, rng.uniform(20, 26), "tree", shadow=False)
    for x in planter.every(32.0, 8.0 if planter.side.sign > 0 else 24.0):
        add(lamp_post(-planter.side.sign, palette), x, 0.4, "pole")


def _proving_ground(planter: _Planter) -> None:
    rng, palette, add = planter.rng, planter.palette, planter.add
    if planter.side.sign > 0:
        for x in planter.every(24.0):
            planter.add_along(fence, 24.0, x, 6.5)
    for x in planter.every(20.0):
        add(cone(), x + float(rng.uniform(-0.3, 0.3)), 1.2)
    for x in planter.stations(70.0, 110.0):
        hall = building(rng, palette, rng.uniform(28, 45), rng.uniform(14, 20), 2 * _FLOOR_M, False)
        add(hall, x, rng.uniform(42, 62), "building", shadow=False)
    for x in planter.every(60.0, 25.0):
        add(mast(), x, 10.0, "pole")
    for x in planter.stations(12.0, 30.0):
        add(tree(rng, palette, rng.uniform(0.7, 1.2)), x, rng.uniform(26, 40), "tree", shadow=False)


def _city(planter: _Planter) -> None:
    rng, palette, add = planter.rng, planter.palette, planter.add
    x, end = planter.span
    while x < end:
        width = float(rng.uniform(14, 24))
        block = building(rng, palette, width, 14.0, _FLOOR_M * int(rng.integers(4, 9)), False)
        add(block, x + width / 2, 9.0, "building", shadow=False)
        x += width + (float(rng.uniform(3, 9)) if rng.uniform() < 0.3 else 0.0)
    for x in planter.every(24.0, 5.0 if planter.side.sign > 0 else 17.0):
        add(lamp_post(-planter.side.sign, palette), x, 0.4, "pole")
    for x in planter.every(24.0, 14.0 if planter.side.sign > 0 else 26.0):
        if rng.uniform() < 0.6:
            add(tree(rng, palette, rng.uniform(0.55, 0.7)), x, 1.3, "tree")
