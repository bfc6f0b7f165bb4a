"""The operating area of an event: what is allowed there, room for the run, other traffic."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from ssp_core.geometry import (
    Box,
    FloatArray,
    Polyline,
    Pose2,
    outline_problem,
    point_in_polygon,
)
from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Camera, Limits, LinkDisturbance, Look, RunSpec
from ssp_core.run_file.participants import (
    FollowPath,
    Hold,
    LaneChange,
    ParticipantSpec,
    TrafficSpec,
)
from ssp_core.run_file.road import JunctionRoad
from ssp_core.run_file.values import Point
from ssp_core.safety.fence import way_excess_m
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.compile.task import PlaceLink
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.arms import junction_roads
from ssp_scenario_manager.maps.block import Block, BlockLane, Library
from ssp_scenario_manager.maps.site import Region, Site, SiteBlock, region_polygon
from ssp_scenario_manager.scenarios.base import CannotPlace, Cross, Drive, Plan
from ssp_scenario_manager.scenarios.block_places import left_kerb_m, right_kerb_m
from ssp_scenario_manager.scenarios.motions import stopping_m

# A map says nothing about a fence: it is drawn this far beyond sidewalks and road.
FENCE_MARGIN_M = 3.0
# Half of the lane that an object off the VUT's block has around its way.
_WAY_HALF_M = 2.0
# Nor about limits where K* leaves a side open.
DEFAULT_SPEED_MPS = 16.0
DEFAULT_ACCELERATION_MPS2 = 5.0


@dataclass(frozen=True)
class OperatingArea:
    """A site or a map, read.

    Args:
        site: None for a map.
        map_data: the map's bytes; None for a site.
        map_name: file name of the map, empty for a site.
    """

    link: PlaceLink
    library: Library
    site: Site | None = None
    map_data: bytes | None = None
    map_name: str = ""

    @property
    def name(self) -> str:
        """Name the area for people: the site's name, or the map's file name."""
        return self.site.name if self.site is not None else self.map_name

    def limits(self, event: Event) -> Limits:
        """Return Ω_safe: what the place allows, cut down to what K* allows (METHOD 2.3)."""
        safety = event.constraints.safety
        place = self.site.limits if self.site is not None else None
        if place is None:
            place = Limits(speed_mps=DEFAULT_SPEED_MPS, acceleration_mps2=DEFAULT_ACCELERATION_MPS2)
        return place.model_copy(
            update={
                "speed_mps": min(place.speed_mps, safety.speed.si.high),
                "acceleration_mps2": min(place.acceleration_mps2, safety.acceleration.si.high),
                "separation_m": max(place.separation_m, safety.separation.si.low),
                "duration_s": min(place.duration_s, safety.duration.si.high),
            }
        )

    def camera(self, event: Event) -> Camera:
        """Return the site's camera, or for a map the usual one moved into what K* needs.

        Raises:
            CannotPlace: the site's camera doesn't deliver what K* needs.
        """
        need = event.constraints.camera
        hfov = Span(*(round(math.degrees(end), 9) for end in (need.hfov.si.low, need.hfov.si.high)))
        if self.site is None:
            usual = Camera()
            return usual.model_copy(
                update={
                    "hfov_deg": hfov.nearest(usual.hfov_deg),
                    "width_px": round(need.width.si.nearest(usual.width_px)),
                    "rate_hz": need.rate.si.nearest(usual.rate_hz),
                }
            )
        camera = self.site.camera
        for name, value, needed, unit in (
            ("hfov_deg", camera.hfov_deg, hfov, "deg"),
            ("width_px", camera.width_px, need.width.si, "px"),
            ("rate_hz", camera.rate_hz, need.rate.si, "Hz"),
        ):
            if needed.nearest(value) != value:
                below = value < needed.low
                raise CannotPlace(
                    f"the site's camera.{name} is {value:g} {unit}, K* needs at "
                    f"{'least' if below else 'most'} {needed.low if below else needed.high:g}"
                )
        return camera

    @property
    def look(self) -> Look:
        return self.site.look if self.site is not None else Look()

    @property
    def disturbance(self) -> LinkDisturbance:
        return self.site.disturbance if self.site is not None else LinkDisturbance()

    def site_block(self, block: Block) -> SiteBlock | None:
        """Return the block as the site's file has it, with its surroundings; None for a map."""
        blocks = self.site.blocks if self.site is not None else []
        return next((candidate for candidate in blocks if candidate.id == block.block_id), None)

    def routes_with(self, block: Block) -> dict[str, Block]:
        """Return the routes through the junction of a route, by their ids; none of another block.

        The library has them where an event asked for junctions (``with_routes``).
        """
        if block.passage is None:
            return {}
        routes = (one for one in self.library.blocks if one.junction == block.junction)
        return {route.block_id: route for route in routes if route.passage is not None}

    def junction_roads(self, block: Block) -> list[JunctionRoad]:
        """Return the roads of the junction that a route leads through; none of another block."""
        if block.passage is None or block.junction is None:
            return []
        return junction_roads(self.library, block.junction)

    def geofence(
        self, block: Block, ways: Sequence[tuple[Sequence[Point], Size]] = ()
    ) -> list[Point]:
        """Return the site's fence; for a map, one around the block, its sidewalks, and some ways.

        Args:
            block: that the VUT drives along.
            ways: of objects' rear axles, off the block, and the objects' sizes.

        Raises:
            CannotPlace: the block comes back to itself, so that its fence encloses no area.
        """
        if self.site is not None:
            return region_polygon(self.site, self.site.geofence, "geofence")
        right = right_kerb_m(block) - block.sidewalk_right_m - FENCE_MARGIN_M
        left = left_kerb_m(block) + block.sidewalk_left_m + FENCE_MARGIN_M
        try:
            fence = strip_polygon(block.line, 0.0, block.length_m, right, left)
        except NotOneToOne:
            fence = _band(block.line, right, left)
        problem = outline_problem(fence)
        if problem is not None:
            raise CannotPlace(f"a fence around the block {problem[0]}")
        return _around(fence, ways) if any(way for way, _ in ways) else fence

    def regions(self, name: Literal["ot_reachable", "safe_stop_zones"]) -> list[list[Point]]:
        """List the regions where an OT can be, or where a run may end in a hurry.

        Empty for a map.
        """
        site = self.site
        site_regions: list[Region] = [] if site is None else getattr(site, name)
        return [
            region_polygon(site, region, f"{name}[{i}]")
            for i, region in enumerate(site_regions)
            if site is not None
        ]


def _band(line: ReferenceLine, right_m: float, left_m: float) -> list[Point]:
    """Return the outline, counter-clockwise, of what lies between two offsets of a line.

    Unlike a strip it may reach beyond the centres of bends.
    """
    import shapely  # type: ignore[import-untyped]  # slow to import, no types

    middle = shapely.LineString(line.path(0.0, line.length_m, 0.0))
    sides = [middle.buffer(offset_m, single_sided=True) for offset_m in (right_m, left_m)]
    return _outline(shapely.union_all(sides))


def _around(fence: Sequence[Point], ways: Sequence[tuple[Sequence[Point], Size]]) -> list[Point]:
    """Return the outline, counter-clockwise, of a fence and of the room around some ways."""
    import shapely  # slow to import, no types

    half = _WAY_HALF_M + FENCE_MARGIN_M
    strips = [
        shapely.LineString(_swept(way, size)).buffer(half, cap_style="flat", join_style="mitre")
        for way, size in ways
        if way
    ]
    return _outline(shapely.union_all([shapely.Polygon(fence), *strips]))


def _outline(region: Any) -> list[Point]:
    """Return the outer border of a shape, counter-clockwise and without its last place."""
    import shapely  # slow to import, no types

    whole = region.simplify(_SEAM_M)
    outline = shapely.get_coordinates(whole.exterior if hasattr(whole, "exterior") else whole)
    if not shapely.Polygon(outline).exterior.is_ccw:
        outline = outline[::-1]
    return [(float(x), float(y)) for x, y in outline[:-1]]


def _swept(way: Sequence[Point], size: Size) -> list[Point]:
    """Return a way of rear axles, longer at both ends by what the object and the margin take."""
    line = Polyline(way)
    behind = line.pose(0.0).to_parent(-size.rear_m - FENCE_MARGIN_M, 0.0)
    ahead = line.pose(line.length_m).to_parent(size.front_m + FENCE_MARGIN_M, 0.0)
    return [behind, *way, ahead]


def strip_polygon(
    line: ReferenceLine, from_s_m: float, to_s_m: float, right_m: float, left_m: float
) -> list[Point]:
    """Return the outline between two arc lengths and two offsets, counter-clockwise."""
    low, high = sorted((from_s_m, to_s_m))
    right, left = sorted((right_m, left_m))
    return [*line.path(low, high, right), *line.path(high, low, left)]


# Paths are swept in steps of this.
_STEP_M = 1.0
_SEAM_M = 0.0005
# A safe-stop zone can be reached from the VUT's path within this distance to a side.
SAFE_STOP_REACH_M = 8.0


def _way(path: Sequence[Point]) -> FloatArray:
    """Return poses along a path, shape (n, 3)."""
    line = Polyline(path)
    steps = max(1, round(line.length_m / _STEP_M))
    stations = (line.length_m * i / steps for i in range(steps + 1))
    return np.array([(p.x_m, p.y_m, p.yaw_rad) for p in map(line.pose, stations)])


def _paths(run: RunSpec, block: Block, plan: Plan) -> Iterator[tuple[ParticipantSpec, list[Point]]]:
    """Yield every path that VUT and OTs may drive or walk, also the lane after a lane change."""
    for spec in (run.vut, *run.targets):
        if spec.approach is not None:
            yield spec, spec.approach.path
        elif all(isinstance(t.manoeuvre, Hold) for t in run.triggers if t.object_id == spec.id):
            ahead = spec.start.pose.to_parent(0.01, 0.0)
            yield spec, [(spec.start.x_m, spec.start.y_m), ahead]
    for trigger in run.triggers:
        spec = next(t for t in run.targets if t.id == trigger.object_id)
        if isinstance(trigger.manoeuvre, FollowPath):
            yield spec, trigger.manoeuvre.motion.path
        elif isinstance(trigger.manoeuvre, LaneChange):
            drive = plan.targets[spec.id]
            if isinstance(drive, Drive):
                y = drive.start.l_m + trigger.manoeuvre.lateral_shift_m
                yield spec, block.line.path(plan.expected.s_m, drive.end_s_m, y)


def check_in_fence(run: RunSpec, block: Block, plan: Plan) -> None:
    """Check that no body sweeps a place outside the fence on any whole path.

    Raises:
        CannotPlace: something does; with the place.
    """
    for spec, path in _paths(run, block, plan):
        start = spec.start
        for way in (np.array([(start.x_m, start.y_m, start.yaw_rad)]), _way(path)):
            excess = way_excess_m(way[:, 0], way[:, 1], way[:, 2], spec.size, run.geofence)
            if excess.max() > 0.0:
                raise _leaves(spec, "the geofence", way[int(np.argmax(excess > 0.0))])


def check_reachable(
    run: RunSpec, block: Block, plan: Plan, regions: Sequence[Sequence[Point]]
) -> None:
    """Check that targets stay in what they can reach, which is all regions together.

    Raises:
        CannotPlace: one doesn't; with the place.
    """
    import shapely  # slow to import

    # Regions that follow each other along a road meet at a seam.
    polygons = [shapely.Polygon(region).buffer(_SEAM_M, join_style="mitre") for region in regions]
    together = shapely.union_all(polygons)
    shapely.prepare(together)
    for spec, path in _paths(run, block, plan):
        if spec.id == VUT_ID:
            continue
        start, size = spec.start.pose, spec.size
        way = [start, *(Pose2(*pose) for pose in _way(path).tolist())]
        boxes = [Box(pose, size.front_m, size.rear_m, size.width_m).corners() for pose in way]
        # The start and, from each pose of the path to the next, the hull of both boxes.
        swept = shapely.multipoints([2 * boxes[0], *(a + b for a, b in pairwise(boxes[1:]))])
        inside = shapely.covers(together, shapely.convex_hull(swept))
        if not inside.all():
            at = way[int(np.argmin(inside))]
            raise _leaves(spec, "what OTs can reach", (at.x_m, at.y_m))


def _leaves(spec: ParticipantSpec, what: str, at: Sequence[float] | FloatArray) -> CannotPlace:
    return CannotPlace(f"{spec.id} would leave {what} at x {at[0]:.1f} m, y {at[1]:.1f} m")


def check_safe_stop(block: Block, plan: Plan, zones: list[list[Point]]) -> None:
    """Check that a zone lies beside or ahead of where the VUT stands after braking.

    Raises:
        CannotPlace: none does.
    """
    brakes = stopping_m(plan.vut.cruise_mps, plan.vut.deceleration_mps2)
    earliest = plan.expected.s_m + brakes
    stations = np.arange(earliest, block.length_m + 1e-9, _STEP_M)
    if any(_crosses(block, float(s), plan.vut.start.l_m, zones) for s in stations):
        return
    raise CannotPlace(
        f"no safe-stop zone can be reached from s = {earliest:.0f} m on, where the VUT can stop "
        f"after the trigger ({len(zones)} zone(s), {SAFE_STOP_REACH_M:g} m to either side)"
    )


def _crosses(block: Block, s_m: float, l_m: float, zones: list[list[Point]]) -> bool:
    """Tell whether some place beside the path within reach lies in a zone."""
    for beside in range(int(2 * SAFE_STOP_REACH_M) + 1):
        with suppress(NotOneToOne):
            point = block.line.to_map(s_m, l_m - SAFE_STOP_REACH_M + beside)
            if any(point_in_polygon(*point, zone) for zone in zones):
                return True
    return False


# Room to whoever starts in the same lane, and time around a crossing in it.
_ROOM_M = 25.0
_AROUND_S = 4.0
# Between a trigger's not_before and its firing (Plan: the half of the foreseen time).
_FIRES_SHARE = 2.0


def clear_traffic(
    vehicles: Sequence[TrafficSpec], lanes: Sequence[BlockLane], plan: Plan
) -> tuple[list[TrafficSpec], list[str]]:
    """Return the vehicles that keep clear of the event, and why the others were left out.

    They drive straight on at constant speed, as SUMO has them do.
    """
    clear_vehicles, left_out = [], []
    for vehicle, lane in zip(vehicles, lanes, strict=True):
        reason = _in_the_way(vehicle, lane, plan)
        if reason is None:
            clear_vehicles.append(vehicle)
        else:
            left_out.append(f"{vehicle.id}: {reason}")
    return clear_vehicles, left_out


def _in_the_way(vehicle: TrafficSpec, lane: BlockLane, plan: Plan) -> str | None:
    act = plan.trigger.act
    if vehicle.id in {"vut", *plan.targets}:
        return "its id is a participant's"
    others = [d for d in plan.targets.values() if isinstance(d, Drive)]
    if isinstance(act, Cross):
        reason = _at_crossing(vehicle, lane, plan, act)
        return reason or _with_drives(vehicle, lane, others)
    return _with_drives(vehicle, lane, [plan.vut, *others])


def _with_drives(vehicle: TrafficSpec, lane: BlockLane, drives: Sequence[Drive]) -> str | None:
    """Return why a vehicle and one that drives in its lane would come too near, or None."""
    for drive in drives:
        if abs(drive.start.l_m - lane.y_m) > lane.width_m / 2:
            continue
        if lane.forward is (drive.heading_rad != 0.0):
            return "a participant drives in its lane in the opposite direction"
        ahead = vehicle.x_m - drive.start.s_m
        ahead = ahead if lane.forward else -ahead
        if ahead < 0.0 and ahead > -_ROOM_M - 20.0:
            return "it starts too close behind a participant"
        if ahead < 0.0 and vehicle.speed_mps > 0.0:
            return "it would catch up with a participant"
        if 0.0 <= ahead < _ROOM_M or (ahead >= 0.0 and vehicle.speed_mps < drive.cruise_mps):
            return "a participant would catch up with it"
    return None


def _at_crossing(vehicle: TrafficSpec, lane: BlockLane, plan: Plan, act: Cross) -> str | None:
    """Return why a vehicle would be at the crossing at about the walker's time, or None."""
    s = act.goal.s_m
    walker = plan.targets[plan.trigger.object_id].start
    speed = vehicle.speed_mps if lane.forward else -vehicle.speed_mps
    away = s - vehicle.x_m
    same_lane = abs(plan.vut.start.l_m - lane.y_m) <= lane.width_m / 2
    if same_lane and lane.forward:
        if away > -_ROOM_M or vehicle.speed_mps < plan.vut.cruise_mps:
            return "it drives in the VUT's lane up to the crossing or too slowly beyond it"
        return None
    if abs(vehicle.x_m - s) < 15.0 and vehicle.speed_mps == 0.0:
        return "it stands at the crossing"
    if speed == 0.0 or away / speed < 0.0:
        return None
    fires_s = _FIRES_SHARE * plan.trigger.not_before_s
    there_s = fires_s + abs(lane.y_m - walker.l_m) / act.speed_mps
    if abs(away / speed - there_s) < _AROUND_S:
        return f"it would pass the crossing with {plan.trigger.object_id} in its lane"
    return None
