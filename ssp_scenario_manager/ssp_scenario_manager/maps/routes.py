"""Routes through the junctions of a map or site, and where they conflict (METHOD 2.1).

A route is a block: one lane of a road that leads to the junction, of the connecting roads and of
the road that leads on, and the middle of that lane is its reference line. Arc lengths, offsets and
curvature are therefore those of any block.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.motion.encounter import ALONG_RAD
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.arms import arm_of
from ssp_scenario_manager.maps.block import (
    Block,
    BlockLane,
    Boundary,
    Conflict,
    ConflictArea,
    Library,
    Passage,
    bend_1pm,
    conflict_areas,
    headings,
)
from ssp_scenario_manager.maps.lane_ends import with_lane_ends
from ssp_scenario_manager.maps.legs import (
    APPROACH_M,
    EXIT_M,
    LANES_MEET_M,
    STRAIGHT_ON_RAD,
    Leg,
    joined_line,
    lane_pairs,
    lanes_beside,
    prolonged,
)
from ssp_scenario_manager.maps.reference_line import Unusable
from ssp_scenario_manager.maps.rings import is_ring

# Roads before and beyond a route bend no more than it does; or than this over a metre and over
# 10 m, as lanes do that meet to a few centimetres.
_LEAST_BENDS_1PM = (0.01, 0.0015)
# Of the bends of two lines, of which one is a part of the other.
_SAME_BEND_1PM = 1e-4
# Over a metre and over 10 m, of a route over a ring, whose bends move as it is smoothed.
_RING_BENDS_1PM = (0.02, 0.01)
# Connecting roads that follow one another inside one junction.
_MOST_VIA = 4
# In a ring, whose five arms may have four blocks each.
_MOST_VIA_RING = 20
# Routes of one junction whose conflicts are looked for.
MOST_ROUTES = 200
# Steps from road to road inside one junction, of which most may lead nowhere.
_MOST_STEPS = 20_000
# Conflicts are looked for at this step, as far as this beyond the junction; routes join where their
# middles are this near.
_STEP_M = 0.5
_BEYOND_M = 10.0
_JOINED_M = 0.2
# One that turns by more goes back.
BACK_RAD = math.radians(150.0)
# Lines that meet at a smaller angle don't cross.
_LEAST_ANGLE_RAD = 0.05


class _Effort:
    """The work on the routes of each junction, and the junctions on which it has ended early."""

    def __init__(self) -> None:
        self.full: dict[str, str] = {}
        self._steps: Counter[str] = Counter()
        self._route_counts: Counter[str] = Counter()

    def step(self, junction: str) -> None:
        """Count a step from road to road."""
        self._steps[junction] += 1
        if self._steps[junction] > _MOST_STEPS:
            many = f"more than {_MOST_STEPS} ways over its roads would have to be looked at"
            self.full.setdefault(junction, many)

    def count(self, junction: str) -> None:
        """Count a route."""
        self._route_counts[junction] += 1
        if self._route_counts[junction] > MOST_ROUTES:
            many = f"has more than {MOST_ROUTES} routes, which aren't looked at"
            self.full.setdefault(junction, many)


def _follow(
    chain: list[tuple[Block, BlockLane]], blocks_by_id: dict[str, Block], effort: _Effort
) -> Iterator[list[Leg]]:
    """Yield the ways on from the end of a chain of lanes, whose first is the approach."""
    block, lane = chain[-1]
    effort.step(block.junction or "")
    for name in block.exits:
        after = blocks_by_id.get(name)
        if after is None:
            continue
        if (block.junction or "") in effort.full:
            return
        pairs = lane_pairs(block, after)
        onward = [b for apart_m, a, b in pairs if a is lane and apart_m <= LANES_MEET_M]
        for other in onward[:1]:
            if after.junction == block.junction:
                most = _MOST_VIA_RING if is_ring(block.junction) else _MOST_VIA
                if len(chain) <= most and all(one is not after for one, _ in chain):
                    yield from _follow([*chain, (after, other)], blocks_by_id, effort)
                continue
            (first, entry), *inside = chain
            yield [
                Leg(first, entry, max(0.0, first.length_m - APPROACH_M), first.length_m),
                *(Leg(one, its, 0.0, one.length_m) for one, its in inside),
                Leg(after, other, 0.0, min(after.length_m, EXIT_M)),
            ]


def _chains(blocks: Sequence[Block], junction: str | None, effort: _Effort) -> Iterator[list[Leg]]:
    """Yield the lanes of each route, from the approach to the exit."""
    blocks_by_id = {block.block_id: block for block in blocks}
    for block in blocks:
        if block.junction is None or junction not in (None, block.junction):
            continue
        for name in block.entrances:
            before = blocks_by_id.get(name)
            if before is None or before.junction == block.junction:
                continue
            for apart_m, one, other in lane_pairs(before, block):
                if apart_m <= LANES_MEET_M:
                    yield from _follow([(before, one), (block, other)], blocks_by_id, effort)


def _sharpest(line: ReferenceLine) -> FloatArray:
    """Return the largest curvature of a line over any metre, and over any 10 m, 1/m."""
    s = np.linspace(0.0, line.length_m, max(2, math.ceil(line.length_m) + 1))
    over_a_metre = np.abs(np.diff(headings(line, s)) / np.diff(s)).max()
    return np.array([over_a_metre, bend_1pm(line)])


def _with_roads_beyond(
    legs: Sequence[Leg], blocks_by_id: Mapping[str, Block], beside: Sequence[BlockLane]
) -> tuple[list[Leg], list[Leg]]:
    """Return roads before and beyond a route, by which it bends no more than without them.

    What an event fits on therefore stays so.

    Raises:
        Unusable: the route's own lanes make no line.
    """
    ring = is_ring(legs[1].block.junction)
    same = _RING_BENDS_1PM if ring else _SAME_BEND_1PM
    most = np.maximum(_sharpest(joined_line(legs, ring)[0]), _LEAST_BENDS_1PM) + same
    before: list[Leg] = []
    after: list[Leg] = []
    for leg in prolonged(legs, blocks_by_id, beside, back=True):
        if not _bends_less([leg, *before, *legs], most, ring):
            break
        before.insert(0, leg)
    for leg in prolonged(legs, blocks_by_id, beside, back=False):
        if not _bends_less([*legs, *after, leg], most, ring):
            break
        after.append(leg)
    return before, after


def _bends_less(legs: Sequence[Leg], most_1pm: FloatArray, smoothed: bool) -> bool:
    with suppress(Unusable):
        return bool((_sharpest(joined_line(legs, smoothed)[0]) <= most_1pm).all())
    return False


def _if_same(straight: bool, first: Boundary, last: Boundary) -> Boundary:
    """Return what a route that goes straight on has beside it, where approach and exit agree."""
    return first if straight and first == last else "any"


def _shared(
    leg: Leg,
    roads: Sequence[Leg],
    blocks_by_id: Mapping[str, Block],
    junction: str | None,
    *,
    back: bool,
) -> tuple[int, float]:
    """Return how many of a route's roads are of its arm, and how long that arm is, m.

    Args:
        leg: approach or exit.
        roads: of the route before or beyond it, nearest first.
        blocks_by_id: blocks by their ids.
        junction: that the route leads through.
        back: it is the approach.
    """
    arm = arm_of(leg.block, leg.lane, blocks_by_id, junction, back=back)
    count = 0
    for own, its in zip(roads, arm.legs[1:], strict=False):
        if own.block is not its.block or own.lane != its.lane:
            break
        count += 1
        if own.length_m < its.length_m:
            break
    return count, arm.length_m


def _arms_s_m(
    legs: Sequence[Leg],
    before: Sequence[Leg],
    after: Sequence[Leg],
    ends_m: Sequence[float],
    blocks_by_id: Mapping[str, Block],
) -> tuple[float, float]:
    """Return between which arc lengths a route is on the arms of its junction, or in it.

    Args:
        legs: of the route, from the approach to the exit.
        before: roads before it, the farthest first.
        after: roads beyond it, the nearest first.
        ends_m: arc length at which each of all of these ends.
        blocks_by_id: blocks by their ids.
    """
    start_m, end_m = -math.inf, math.inf
    edges_m, first = [0.0, *ends_m], len(before)
    last, junction = first + len(legs), legs[1].block.junction
    if before:
        count, long_m = _shared(legs[0], before[::-1], blocks_by_id, junction, back=True)
        start_m = min(edges_m[first], max(edges_m[first - count], edges_m[first + 1] - long_m))
    if after:
        count, long_m = _shared(legs[-1], after, blocks_by_id, junction, back=False)
        end_m = max(edges_m[last], min(edges_m[last + count], edges_m[last - 1] + long_m))
    return start_m, end_m


def _route(legs: Sequence[Leg], blocks_by_id: Mapping[str, Block]) -> Block:
    """Return the block of a route, without its conflicts.

    Raises:
        Unusable: its lanes make no line.
    """
    first, *inside, last = legs
    via = " > ".join(f"{leg.block.block_id} {leg.lane.name}" for leg in inside)
    junction = inside[0].block.junction
    limits = [x for leg in legs if (x := leg.block.speed_limit_mps) is not None]
    turn_rad = wrap_angle(
        last.block.line.pose(0.0).yaw_rad - first.block.line.pose(first.block.length_m).yaw_rad
    )
    straight = abs(turn_rad) < STRAIGHT_ON_RAD
    beside = lanes_beside(first, last) if straight else []
    before, after = _with_roads_beyond(legs, blocks_by_id, beside)
    line, ends = joined_line([*before, *legs, *after], is_ring(junction))
    width_m = min(leg.lane.width_m for leg in (*before, *legs, *after))
    own = BlockLane(0.0, width_m, forward=True, name=first.lane.name)
    enters = len(before)
    return Block(
        block_id=f"junction {junction}: {first.block.block_id} > {via} > {last.block.block_id}",
        line=line,
        lanes=tuple(sorted((own, *beside), key=lambda lane: lane.y_m)),
        road_type=first.block.road_type,
        segment="junction",
        left_boundary=_if_same(straight, first.block.left_boundary, last.block.left_boundary),
        right_boundary=_if_same(straight, first.block.right_boundary, last.block.right_boundary),
        sidewalk_left_m=straight * min(first.block.sidewalk_left_m, last.block.sidewalk_left_m),
        sidewalk_right_m=straight * min(first.block.sidewalk_right_m, last.block.sidewalk_right_m),
        permitted=frozenset({"keep_lane", "stop"}),
        entrances=(first.block.block_id,),
        exits=(last.block.block_id,),
        speed_limit_mps=min(limits, default=None),
        left_hand=first.block.left_hand,
        roads=tuple(
            dict.fromkeys(name for leg in [*before, *legs, *after] for name in leg.block.roads)
        ),
        junction=junction,
        passage=Passage(
            via=tuple(leg.block.block_id for leg in inside),
            start_s_m=ends[enters],
            end_s_m=ends[enters + len(inside)],
            turn_rad=turn_rad,
            arms_s_m=_arms_s_m(legs, before, after, ends, blocks_by_id),
        ),
    )


def _own_lane(route: Block) -> BlockLane:
    """Return the lane that a route takes, under its name on the approach."""
    (own,) = (lane for lane in route.lanes if lane.y_m == 0.0)
    return own


@dataclass(frozen=True, slots=True)
class _Track:
    """A route's middle from the junction's entry to a little beyond its end, sampled."""

    s_m: FloatArray
    xy_m: FloatArray
    half_m: float

    @classmethod
    def of(cls, route: Block) -> _Track:
        begin, end = 0.0, route.length_m
        if route.passage is not None:
            begin = route.passage.start_s_m
            end = min(end, route.passage.end_s_m + _BEYOND_M)
        s = np.linspace(begin, end, max(2, math.ceil((end - begin) / _STEP_M) + 1))
        return cls(s, route.line.to_map_many(s, 0.0), 0.5 * _own_lane(route).width_m)


def _run(hit: FloatArray, at: int) -> tuple[int, int]:
    """Return both ends of the run of samples around one that is hit."""
    low = high = at
    while low > 0 and hit[low - 1]:
        low -= 1
    while high + 1 < len(hit) and hit[high + 1]:
        high += 1
    return low, high


def _crossing(a: _Track, b: _Track) -> tuple[float, float] | None:
    """Return the arc lengths along both at which their middles first cross; None: they don't."""
    p, d = a.xy_m[:-1, None], np.diff(a.xy_m, axis=0)[:, None]
    q, e = b.xy_m[None, :-1], np.diff(b.xy_m, axis=0)[None, :]
    w = q - p
    det = d[..., 0] * e[..., 1] - d[..., 1] * e[..., 0]
    norm = np.hypot(d[..., 0], d[..., 1]) * np.hypot(e[..., 0], e[..., 1])
    steep = np.abs(det) > norm * math.sin(_LEAST_ANGLE_RAD)
    safe = np.where(steep, det, 1.0)
    t = (w[..., 0] * e[..., 1] - w[..., 1] * e[..., 0]) / safe
    u = (w[..., 0] * d[..., 1] - w[..., 1] * d[..., 0]) / safe
    inside = steep & (t >= 0.0) & (t < 1.0) & (u >= 0.0) & (u < 1.0)
    if not inside.any():
        return None
    i, j = map(int, np.argwhere(inside)[0])
    return (
        float(a.s_m[i] + t[i, j] * (a.s_m[i + 1] - a.s_m[i])),
        float(b.s_m[j] + u[i, j] * (b.s_m[j + 1] - b.s_m[j])),
    )


def _come_in_one_lane(a: _Track, b: _Track) -> bool:
    """Tell whether two routes that come over one road enter their junction in one lane."""
    apart_m = float(np.hypot(*(a.xy_m[0] - b.xy_m[0])))
    (ax, ay), (bx, by) = (track.xy_m[1] - track.xy_m[0] for track in (a, b))
    turned_rad = abs(math.atan2(ax * by - ay * bx, ax * bx + ay * by))
    return apart_m < min(a.half_m, b.half_m) and turned_rad < ALONG_RAD


def _meeting(one: Block, other: Block, a: _Track, b: _Track) -> tuple[Conflict, Conflict] | None:
    """Return what two routes are to each other: a conflict of each with the other, or none."""
    apart = np.maximum(
        a.xy_m.min(axis=0) - b.xy_m.max(axis=0), b.xy_m.min(axis=0) - a.xy_m.max(axis=0)
    )
    if apart.max() > a.half_m + b.half_m:
        return None
    far = np.hypot(*(a.xy_m[:, None] - b.xy_m[None, :]).transpose(2, 0, 1))
    near = far < a.half_m + b.half_m
    joined = far < math.hypot(_JOINED_M, 0.5 * _STEP_M)
    merging = one.exits == other.exits and bool(joined[-1].any())
    if merging:
        i = _run(joined.any(axis=1), len(a.s_m) - 1)[0]
        at = float(a.s_m[i]), float(b.s_m[int(far[i].argmin())])
    elif (crossing := _crossing(a, b)) is not None:
        at = crossing
    elif one.exits != other.exits and joined.any():
        # In a ring one joins the other, and they part again.
        i = int(np.argmax(joined.any(axis=1)))
        at = float(a.s_m[i]), float(b.s_m[int(far[i].argmin())])
    else:
        return None
    angle = wrap_angle(other.line.pose(at[1]).yaw_rad - one.line.pose(at[0]).yaw_rad)
    conflicts = []
    for mine, track, hit, s, far_s, route, turn in (
        (one, a, near.any(axis=1), at[0], at[1], other, angle),
        (other, b, near.any(axis=0), at[1], at[0], one, -angle),
    ):
        low, high = _run(hit, int(np.abs(track.s_m - s).argmin()))
        conflicts.append(
            Conflict(
                route=route.block_id,
                kind="merge" if merging else "crossing",
                s_m=s,
                other_s_m=far_s,
                angle_rad=turn,
                start_s_m=max(float(track.s_m[0]), float(track.s_m[low]) - 0.5 * _STEP_M),
                end_s_m=mine.length_m
                if merging
                else min(float(track.s_m[-1]), float(track.s_m[high]) + 0.5 * _STEP_M),
            )
        )
    return conflicts[0], conflicts[1]


def _with_conflicts(routes: Sequence[Block], blocks_by_id: Mapping[str, Block]) -> list[Block]:
    """Return the routes of one junction with their conflicts.

    Those of one approach only part, unless two of its lanes go on in one. A lane may be read twice,
    as one of its road's and along its own middle, and is one lane.

    Args:
        routes: of the junction.
        blocks_by_id: blocks by their ids.
    """
    tracks = [_Track.of(route) for route in routes]
    route_conflicts: list[list[Conflict]] = [[] for _ in routes]
    for i, j in combinations(range(len(routes)), 2):
        one, other = routes[i], routes[j]
        of_one_approach = one.entrances == other.entrances
        if of_one_approach and (one.exits != other.exits or _own_lane(one) == _own_lane(other)):
            continue
        over = [blocks_by_id[route.entrances[0]].roads for route in (one, other)]
        if over[0] == over[1] and _come_in_one_lane(tracks[i], tracks[j]):
            continue
        pair = _meeting(one, other, tracks[i], tracks[j])
        if pair is not None and not (of_one_approach and pair[0].kind == "crossing"):
            route_conflicts[i].append(pair[0])
            route_conflicts[j].append(pair[1])
    blocks = []
    for route, conflicts in zip(routes, route_conflicts, strict=True):
        if route.passage is None:
            continue
        ordered = tuple(sorted(conflicts, key=lambda one: (one.s_m, one.route)))
        areas = [ConflictArea(one.kind, one.start_s_m, one.end_s_m) for one in ordered]
        areas += conflict_areas(route.length_m, route.lanes, route.permitted)
        blocks.append(
            replace(
                route,
                conflict_areas=tuple(sorted(areas, key=lambda x: (x.kind, x.start_s_m, x.end_s_m))),
                passage=replace(route.passage, conflicts=ordered),
            )
        )
    return blocks


def routes_of(
    library: Library, junction: str | None = None
) -> tuple[list[Block], list[tuple[str, str]]]:
    """Return routes by id, and blocks of junctions that none leads over, with the reason.

    Args:
        library: of a map or site, without routes.
        junction: whose routes are wanted, None for all.
    """
    by_junction: dict[str, dict[str, Block]] = {}
    refused = []
    blocks_by_id = {block.block_id: block for block in library.drivable}
    effort = _Effort()
    for legs in _chains(library.drivable, junction, effort):
        inner = legs[1].block
        try:
            route = _route(legs, blocks_by_id)
        except Unusable as error:
            refused.append((f"route over {inner.block_id} {legs[1].lane.name}", str(error)))
            continue
        own = by_junction.setdefault(inner.junction or "", {})
        if route.block_id not in own:
            effort.count(inner.junction or "")
        own[route.block_id] = route
    led: set[str] = set()
    for routes in by_junction.values():
        led.update(*(route.passage.via for route in routes.values() if route.passage is not None))
    refused += [
        (block.block_id, _no_route(block))
        for block in library.drivable
        if block.junction is not None
        and junction in (None, block.junction)
        and block.junction not in effort.full
        and block.block_id not in led
    ]
    route_blocks: list[Block] = []
    refused += [(f"junction {name}", why) for name, why in sorted(effort.full.items())]
    for name, routes in sorted(by_junction.items()):
        if name not in effort.full:
            route_blocks += _with_conflicts(
                [route for _, route in sorted(routes.items())], blocks_by_id
            )
    return route_blocks, refused


def with_routes(library: Library) -> Library:
    """Return a library whose blocks include its routes through junctions, and past lanes' ends."""
    library = with_lane_ends(library)
    routes, refused = routes_of(library)
    return replace(
        library,
        blocks=tuple(sorted((*library.blocks, *routes), key=lambda block: block.block_id)),
        rejected=(*library.rejected, *refused),
    )


def _no_route(block: Block) -> str:
    """Give the reason why no route leads over a block of a junction."""
    if not block.entrances:
        return "no block leads to it"
    if not block.exits:
        return "it leads to no block"
    return f"none of its lanes continues one of an approach to {LANES_MEET_M:g} m, and goes on"
