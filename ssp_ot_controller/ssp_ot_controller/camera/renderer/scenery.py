"""The scenery beside the road: the map's in its place, the rest placed by seed.

Everything stands outside carriageway and sidewalks, and follows the road where it bends. Poses are
in the block's frame. Where the map has things of a kind, none of that kind are placed by seed, and
what is placed keeps clear of the map's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssp_core.geometry import Box, Pose2, box_distance
from ssp_core.run_file.road import Building, Road, SceneryItem, Sign, Tree
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.scenery import BEFORE_M, BEYOND_M, Clearance, half_extent_m, item_pose
from ssp_ot_controller.camera.kernels.bend import Bend, block_line, offsets_of
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.kernels.junction import is_own_arm, is_wider_own_arm
from ssp_ot_controller.camera.kernels.palettes import Palette
from ssp_ot_controller.camera.meshes import roadside
from ssp_ot_controller.camera.meshes.mesh import Mesh

Kind = Literal["building", "tree", "pole", "sign", "other"]
_ROOM_M = 0.5  # crowns touch, hedges don't grow into walls
_FLOOR_M = 3.1
_CLEAR_AT_CROSSING_M, _FAR_FROM_CROSSING_M = 7.0, 6.0
_CLEAR_M = 0.2  # from a sidewalk to what stands beside it on a bend
_HEADROOM_M = 2.0  # what is higher may reach over the road
_SAME_PLACE_M = 0.01
_LIMIT_FROM_M, _LIMIT_EVERY_M = 30.0, 120.0  # from where one comes in
_CROSSING_AHEAD_M = 8.0
_SIGN_BESIDE_M = 0.5  # beyond the sidewalk
# Free beside a junction's arms, and so far around it that the arms are seen from the road.
_BESIDE_ARM_M, _SIGHT_M = 1.0, 14.0
_ARM_STEP_M = 8.0


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
class _Row:
    """Things in a row along one side of the road.

    Args:
        make: one of them, which may have to know on which side it stands (+ is left).
        apart_m: least and largest distance along the road.
        beyond_m: nearest and farthest place beyond the sidewalk.
    """

    kind: Kind
    make: Callable[[np.random.Generator, Palette, float], Mesh]
    apart_m: tuple[float, float]
    beyond_m: tuple[float, float]
    shadow: bool = True


def _house(rng: np.random.Generator, palette: Palette, _: float) -> Mesh:
    width, depth, floors = rng.uniform(9, 13), rng.uniform(8, 10), int(rng.integers(1, 3))
    return roadside.building(rng, palette, width, depth, _FLOOR_M * floors, pitched=True)


def _hall(rng: np.random.Generator, palette: Palette, _: float) -> Mesh:
    width, depth = rng.uniform(28, 45), rng.uniform(14, 20)
    return roadside.building(rng, palette, width, depth, 2 * _FLOOR_M, pitched=False)


def _block(rng: np.random.Generator, palette: Palette, _: float) -> Mesh:
    width, floors = rng.uniform(15, 21), int(rng.integers(4, 9))
    return roadside.building(rng, palette, width, 14.0, _FLOOR_M * floors, pitched=False)


def _tree(rng: np.random.Generator, palette: Palette, _: float) -> Mesh:
    return roadside.tree(rng, palette, rng.uniform(5.0, 8.0))


def _street_tree(rng: np.random.Generator, palette: Palette, _: float) -> Mesh:
    return roadside.tree(rng, palette, rng.uniform(4.0, 5.0))


def _hedge(rng: np.random.Generator, palette: Palette, _: float) -> Mesh:
    return roadside.hedge(rng.uniform(8, 13), palette)


def _lamp(_: np.random.Generator, palette: Palette, side: float) -> Mesh:
    return roadside.lamp_post(-side, palette)


_FENCE_M = 4.0
# From the road outwards.
_ROWS: dict[str, tuple[_Row, ...]] = {
    "suburb": (
        _Row("pole", _lamp, (36.0, 36.0), (0.4, 0.4)),
        _Row("other", _hedge, (17.0, 24.0), (3.6, 3.6)),
        _Row("tree", _tree, (9.0, 19.0), (4.6, 8.0)),
        _Row("building", _house, (17.0, 24.0), (12.0, 16.0), shadow=False),
    ),
    "proving_ground": (
        _Row("other", lambda *_: roadside.cone(), (19.7, 20.3), (1.2, 1.2)),
        _Row("other", lambda *_: roadside.fence(_FENCE_M), (_FENCE_M, _FENCE_M), (6.5, 6.5)),
        _Row("pole", lambda *_: roadside.pole(12.0), (60.0, 60.0), (10.0, 10.0)),
        _Row("tree", _tree, (12.0, 30.0), (26.0, 40.0), shadow=False),
        _Row("building", _hall, (70.0, 110.0), (42.0, 62.0), shadow=False),
    ),
    "dusk_city": (
        _Row("pole", _lamp, (24.0, 24.0), (0.4, 0.4)),
        _Row("tree", _street_tree, (24.0, 56.0), (1.3, 1.3)),
        _Row("building", _block, (21.0, 24.0), (9.0, 9.0), shadow=False),
    ),
}


@dataclass(frozen=True)
class _Side:
    """One side of the road: + is left."""

    sign: float
    edge_m: float  # lateral position where the sidewalk ends


class _Roadside:
    """The free places beside a road; ``items`` are the map's, at ``poses``."""

    def __init__(self, road: Road, bend: Bend | None) -> None:
        self.left = _Side(1.0, road.left_edge_m + max(road.sidewalk_left_m, 1.0))
        self.right = _Side(-1.0, road.right_edge_m - max(road.sidewalk_right_m, 1.0))
        self._crossings_m = [x_m for x_m, _, _ in road.zebras_m]
        self._line, self._bend = block_line(road), bend
        # Nothing of a map is drawn on the lanes.
        clear = Clearance(self._line, [(lane.y_m, lane.width_m) for lane in road.lanes])
        self.items = [item for item in road.scenery if clear.problem(item) is None]
        self.poses = [item_pose(item, self._line) for item in self.items]
        self._junction = list(_around_junction(road))

    def put(
        self,
        kind: Kind,
        mesh: Mesh,
        side: _Side,
        x_m: float,
        beyond_m: float,
        shadow: bool = True,
        yaw_rad: float = 0.0,
    ) -> list[Prop]:
        """Return a thing at an arc length, that far beyond the sidewalk; none where no room is."""
        if any(item.type == kind for item in self.items):
            return []
        low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
        away_m = min((abs(x_m - at_m) for at_m in self._crossings_m), default=math.inf)
        reach_m = _CLEAR_AT_CROSSING_M + max(-low[0], high[0])
        if beyond_m < _FAR_FROM_CROSSING_M and away_m < reach_m:
            return []
        pose = self._pose(mesh, side, x_m, side.edge_m + side.sign * beyond_m, yaw_rad)
        if pose is None or self._is_occupied(pose, low, high):
            return []
        reach = float(np.abs(mesh.corners[..., :2]).max())
        return [Prop(mesh.placed(pose), pose.x_m, pose.y_m, 1.5 * reach, shadow)]

    def _is_occupied(self, pose: Pose2, low: Array, high: Array) -> bool:
        """Tell whether an item of the map, or a junction, is where a mesh of these extents is."""
        half_x, half_y = ((high - low) / 2).tolist()[:2]
        x, y = pose.to_parent(*((low + high) / 2).tolist()[:2])
        room = (half_x + _ROOM_M, half_x + _ROOM_M, 2.0 * (half_y + _ROOM_M))
        box = Box(Pose2(x, y, pose.yaw_rad), *room)
        if any(box_distance(box, free) == 0.0 for free in self._junction):
            return True
        for item, there in zip(self.items, self.poses, strict=True):
            length, width = half_extent_m(item)
            if box_distance(box, Box(there, length, length, 2.0 * width)) == 0.0:
                return True
        return False

    def _pose(
        self, mesh: Mesh, side: _Side, s_m: float, l_m: float, yaw_rad: float
    ) -> Pose2 | None:
        """Return a pose in the block's frame; None: it would be on the road or in its own way."""
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
        return None if (side.sign * (offsets - side.edge_m)).min() < _CLEAR_M else pose


def _around_junction(road: Road) -> Iterator[Box]:
    """Yield boxes, in the block's frame, on which nothing stands: a junction and its arms."""
    walk_m = max(road.sidewalk_left_m, road.sidewalk_right_m)
    frame, own = road.origin.pose, ReferenceLine.of_road(road)
    for one in road.junction:
        is_own = one.junction_at != "both" and is_own_arm(own, one)
        if is_own and not is_wider_own_arm(road, own, one):
            continue
        line = ReferenceLine.of_road(one)
        beside_m = _SIGHT_M if one.junction_at == "both" else walk_m + _BESIDE_ARM_M
        # Beside the road's own arm there is what is beside the road.
        beside_m = 0.0 if is_own else beside_m
        half_m = 0.5 * (one.left_edge_m - one.right_edge_m) + beside_m
        middle_m = 0.5 * (one.left_edge_m + one.right_edge_m)
        steps = max(1, math.ceil(one.length_m / _ARM_STEP_M))
        reach_m = 0.5 * one.length_m / steps
        reach_m += beside_m if one.junction_at == "both" else 0.0
        for k in range(steps):
            pose = line.pose((k + 0.5) * one.length_m / steps)
            x, y = frame.to_local(*pose.to_parent(0.0, middle_m))
            turned = Pose2(x, y, pose.yaw_rad - frame.yaw_rad)
            yield Box(turned, reach_m, reach_m, 2.0 * half_m)


def build_scenery(
    road: Road, bend: Bend | None, palette_name: str, palette: Palette, seed: int
) -> list[Prop]:
    """Return everything that stands beside the road, the same for the same seed.

    The map's things come last.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5CE11E]))
    beside, props = _Roadside(road, bend), []
    end_m = road.length_m + BEYOND_M
    for side in (beside.left, beside.right):
        for row in _ROWS[palette_name]:
            x_m = -BEFORE_M + rng.uniform(*row.apart_m)
            while x_m < end_m:
                mesh = row.make(rng, palette, side.sign)
                beyond_m = rng.uniform(*row.beyond_m)
                props += beside.put(row.kind, mesh, side, x_m, beyond_m, row.shadow)
                x_m += rng.uniform(*row.apart_m)
    props += _signs(beside, road)
    pitched = palette_name == "suburb"
    for i, (item, pose) in enumerate(zip(beside.items, beside.poses, strict=True)):
        # The seed gives it only its colours and the shape of leaves.
        own = np.random.default_rng(np.random.SeedSequence([seed, 0x3A99ED, i]))
        mesh = _mesh(item, road, own, palette, pitched=pitched)
        reach = float(np.hypot(mesh.corners[..., 0], mesh.corners[..., 1]).max())
        reach = max(reach, float(mesh.corners[..., 2].max()))
        props.append(
            Prop(mesh.placed(pose), pose.x_m, pose.y_m, reach, not isinstance(item, Building))
        )
    return props


def _signs(beside: _Roadside, road: Road) -> list[Prop]:
    """Place the signs that the road's numbers call for, for traffic on the right towards them."""
    limit = roadside.sign("speed_limit", max(5, 5 * round(road.speed_limit_mps * 3.6 / 5)))
    going, props = {lane.direction for lane in road.lanes}, []
    ways = (
        ("forward", beside.right, 0.0, 1.0, 0.0),
        ("backward", beside.left, road.length_m, -1.0, math.pi),
    )
    for word, side, begin, along, yaw in ways:
        if word not in going:
            continue
        signs = [
            (limit, begin + along * (_LIMIT_FROM_M + k * _LIMIT_EVERY_M))
            for k in range(math.ceil(road.length_m / _LIMIT_EVERY_M))
        ]
        signs += [
            (roadside.sign("crossing"), at_m - along * _CROSSING_AHEAD_M)
            for at_m in road.crossings_x_m
        ]
        for mesh, x_m in signs:
            props += beside.put("sign", mesh, side, x_m, _SIGN_BESIDE_M, yaw_rad=yaw)
    return props


def _mesh(
    item: SceneryItem, road: Road, rng: np.random.Generator, palette: Palette, *, pitched: bool
) -> Mesh:
    if isinstance(item, Building):
        return roadside.building_of(
            rng, palette, item.length_m, item.width_m, item.height_m, pitched
        )
    if isinstance(item, Sign):
        return roadside.sign(item.kind, item.value)
    if isinstance(item, Tree):
        return roadside.tree(rng, palette, item.height_m)
    if item.lamp:
        left = item.l_m > (road.left_edge_m + road.right_edge_m) / 2
        return roadside.lamp_post(-1.0 if left else 1.0, palette, item.height_m)
    return roadside.pole(item.height_m)
