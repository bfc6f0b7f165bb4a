"""Retrieval: what an event needs of a block, and how well each block suits it (METHOD 2.2)."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from ssp_scenario_manager.compile.task import BlockScore
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import (
    UNRESOLVED,
    BoundaryWord,
    Count,
    Event,
    Interval,
    Quantity,
    RoadTypeWord,
    WordField,
)
from ssp_scenario_manager.maps.block import Block, Library, bend_1pm
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD
from ssp_scenario_manager.maps.routes import BACK_RAD
from ssp_scenario_manager.scenarios.base import Kind
from ssp_scenario_manager.scenarios.block_places import lanes_of_words
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Rounding of widths in map files.
_WIDTH_M = 0.01
_DRIVEN = frozenset({"car", "truck", "bus", "motorcycle", "cyclist"})


@dataclass(frozen=True, slots=True)
class NeedFit:
    """The degree to which a block meets one need.

    Args:
        share: in [0, 1].
        missing: why the block can't be used; None: it can.
    """

    share: float
    missing: str | None = None


MET = NeedFit(1.0)
# The map doesn't say.
UNKNOWN = NeedFit(0.5)


def bounds(quantity: Quantity | None) -> tuple[float, float]:
    """Return both ends of a quantity in SI units; an open or unresolved side is infinite."""
    span = quantity.si if isinstance(quantity, Interval) else Span()
    return span.low, span.high


# -- part T ---------------------------------------------------------------------------------------


def identity(event: Event, block: Block) -> dict[str, str]:
    """Return identity fields in which a block differs from K*, which excludes it (METHOD 2.2).

    What the map doesn't say isn't known to be equal.
    """
    road = event.topology
    mine = vut_lanes(event, block)
    ahead, back = len(block.forward_lanes), len(block.backward_lanes)
    widths = [block.forward_lanes[i].width_m for i in mine]
    checks: dict[str, tuple[object, bool]] = {
        "road_type": (block.road_type, road.road_type.admits(block.road_type)),
        "segment": (block.segment, road.segment.admits(block.segment)),
        "lanes_same_direction": (ahead, road.lanes_same_direction.admits(ahead)),
        "lanes_opposite": (back, road.lanes_opposite.admits(back)),
        "vut_lane": ("not there", bool(mine)),
        "left_boundary": (block.left_boundary, road.left_boundary.admits(block.left_boundary)),
        "right_boundary": (block.right_boundary, road.right_boundary.admits(block.right_boundary)),
        "lane_width": (widths, any(road.lane_width.admits(width) for width in widths)),
        "curvature": (bend_1pm(block.line), road.curvature.admits(bend_1pm(block.line))),
        "permitted_manoeuvres": (
            sorted(block.permitted),
            road.permitted_manoeuvres.admits(block.permitted),
        ),
    }
    return {
        name: f"{name} {_text(checks[name][0])}, needs {_text(getattr(road, name).value)}"
        for name in road.identity_fields
        if not checks[name][1] and getattr(road, name).value != UNRESOLVED
    }


def _text(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_text, value)) or "none"
    if isinstance(value, Interval):
        low, high = bounds(value)
        return f"{low:g} {value.unit}" if low == high else f"{_range(low, high)} {value.unit}"
    if value == "any":
        return "unknown to the map"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def road_type(event: Event, block: Block) -> NeedFit:
    """Score a type that K* has; a proving ground stands in for any, an unknown type is half met."""
    field = event.topology.road_type
    if block.road_type == "proving_ground" or _may_be(field, block.road_type, RoadTypeWord):
        return MET
    return UNKNOWN if block.road_type == "any" else NeedFit(0.0)


def _may_be(field: WordField[Any], word: str, vocabulary: Any) -> bool:
    """Tell whether a place's word is K*'s, or K* leaves open which of all it is."""
    words = set(field.words)
    return not words or word in words or words == set(get_args(vocabulary))


def segment(event: Event, block: Block) -> NeedFit:
    """Compare the segment: straight, curve or junction, as K* says."""
    words = event.topology.segment.words
    if not words or block.segment in words:
        return MET
    return NeedFit(0.0, f"segment {block.segment}, needs {' or '.join(words)}")


def _count(name: str, number: int, limits: Count, least: int) -> NeedFit:
    low, exact = max(limits.min, least), limits.min == limits.max
    if number < low:
        return NeedFit(
            number / low, f"{name} lanes {number}, needs {'' if exact else 'at least '}{low}"
        )
    if number > limits.max:
        needs = f"needs {'' if exact else 'at most '}{limits.max}"
        return NeedFit(limits.max / number, f"{name} lanes {number}, {needs}")
    return MET


_ANY_COUNT = Count(min=0, max=16)


def same_direction(event: Event, block: Block, kind: Kind) -> NeedFit:
    """Count lanes in the VUT's direction: as many as K* says and as the kind needs."""
    forward, backward = len(block.forward_lanes), len(block.backward_lanes)
    limits = event.topology.lanes_same_direction.range or _ANY_COUNT
    fit = _count("same-direction", forward, limits, kind.same_direction_lanes)
    if fit.missing is not None and forward == 1 and backward <= 1 and fit.share < 1.0:
        return NeedFit(fit.share, f"one driving lane per direction: {fit.missing}")
    return fit


def opposite(event: Event, block: Block) -> NeedFit:
    """Count oncoming lanes, as K* says, on the left: part T has no field for their side."""
    if block.left_hand:
        return NeedFit(0.0, "left-hand traffic: the events are of right-hand traffic")
    mine = min((lane.y_m for lane in block.forward_lanes), default=-math.inf)
    if any(lane.y_m < mine for lane in block.backward_lanes):
        return NeedFit(0.0, "left-hand traffic: oncoming lanes lie to the right of the VUT's")
    limits = event.topology.lanes_opposite.range or _ANY_COUNT
    return _count("oncoming", len(block.backward_lanes), limits, 0)


def vut_lanes(event: Event, block: Block) -> list[int]:
    """Return indices of the forward lanes that the VUT may drive in, from right to left."""
    return lanes_of_words(event.topology.vut_lane.words, len(block.forward_lanes))


def vut_lane(event: Event, block: Block) -> NeedFit:
    """Score a lane for the VUT."""
    if vut_lanes(event, block):
        return MET
    lanes, word = len(block.forward_lanes), " or ".join(event.topology.vut_lane.words)
    return NeedFit(0.0, f"same-direction lanes {lanes}, none of them is the {word}")


def boundary(field: WordField[Any], word: str) -> NeedFit:
    """Compare the roadside: a sidewalk has a kerb; a kerb has half of a sidewalk."""
    words = set(field.words)
    if _may_be(field, word, BoundaryWord) or ("kerb" in words and word == "sidewalk"):
        return MET
    return UNKNOWN if word == "any" or ("sidewalk" in words and word == "kerb") else NeedFit(0.0)


# -- part I ---------------------------------------------------------------------------------------


def relation(event: Event, block: Block) -> NeedFit:
    """Score a candidate conflict area of the relation."""
    kind = event.interaction.relation
    if any(area.kind == kind for area in block.conflict_areas):
        return MET
    return NeedFit(0.0, f"no conflict area for the relation {kind}")


def manoeuvres(event: Event, block: Block, kind: Kind) -> NeedFit:
    """Score the share of the manoeuvres of K* and the kind that the block permits."""
    needed = kind.manoeuvres(event) | event.topology.permitted_manoeuvres.needed
    lacking = sorted(needed - block.permitted)
    if not lacking:
        return MET
    share = 1.0 - len(lacking) / len(needed)
    return NeedFit(share, f"not permitted: {', '.join(lacking)}")


def places(event: Event, block: Block) -> NeedFit:
    """Score the share of participants whose place the block has: beside the VUT or oncoming."""
    lanes = len(block.forward_lanes)
    mine = vut_lanes(event, block)
    lacking = []
    for name, who in event.participants.items():
        place = who.region.place
        if place == "left_lane" and not any(i + 1 < lanes for i in mine):
            lacking.append(f"{name} needs a lane to the left of the VUT's")
        elif place == "right_lane" and not any(i > 0 for i in mine):
            lacking.append(f"{name} needs a lane to the right of the VUT's")
        elif place in ("left_road", "right_road") and not _has_conflict_from(event, block, place):
            lacking.append(f"{name} needs a road from the {place.partition('_')[0]}")
        elif place == "oncoming_lane" and not block.backward_lanes:
            lacking.append(f"{name} needs an oncoming lane")
    if not lacking:
        return MET
    return NeedFit(1.0 - len(lacking) / len(event.participants), "; ".join(lacking))


def _has_conflict_from(event: Event, block: Block, place: str) -> bool:
    """Tell whether another route crosses or joins a route, as K* says, from the side of a place."""
    conflicts = () if block.passage is None else block.passage.conflicts
    kind = event.interaction.relation
    return any(c.kind == kind and place == f"{c.comes_from}_road" for c in conflicts)


def turn(event: Event, block: Block) -> list[NeedFit]:
    """Score a route's turn in its junction, where the VUT turns; nothing else is scored."""
    intent = event.participants[event.vut_id].intent
    if KINDS[event.interaction.type].turns_left:
        intent = "turn_left"
    side = {"turn_left": 1.0, "turn_right": -1.0}.get(str(intent))
    if side is None or block.passage is None:
        return []
    turned_rad = block.passage.turn_rad
    if STRAIGHT_ON_RAD <= side * turned_rad <= BACK_RAD:
        return [MET]
    return [NeedFit(0.0, f"it turns by {math.degrees(turned_rad):.0f} deg, needs {intent}")]


# -- part C ---------------------------------------------------------------------------------------


def length(event: Event, block: Block) -> NeedFit:
    """Compare the room with that for approach, conflict and run-out."""
    label = f"length {block.length_m:.1f}"
    return _measured(label, block.length_m, bounds(event.constraints.site.length), "m")


def _measured(label: str, amount: float, limits: tuple[float, float], unit: str) -> NeedFit:
    """Score the share of the needed that is there, or of the present that is allowed."""
    low, high = limits
    if amount < low - 1e-6:
        return NeedFit(max(0.0, amount / low), f"{label} {unit}, needs at least {low:g} {unit}")
    if amount > high + 1e-6:
        return NeedFit(max(0.0, high / amount), f"{label} {unit}, needs at most {high:g} {unit}")
    return MET


def speed_limit(event: Event, block: Block) -> NeedFit:
    """Score the share of the fastest vehicle's range of approach speeds that the limit allows.

    Half met where the map has no limit in it.
    """
    low = high = 0.0
    for name, who in event.participants.items():
        approach = event.constraints.speeds.get(name, {}).get("approach")
        if who.class_ in _DRIVEN and approach is not None:
            least, most = bounds(approach)
            least = max(0.0, least)
            if least > low or (least == low and most > high):
                low, high = least, max(least, most if math.isfinite(most) else least)
    limit = block.speed_limit_mps
    if limit is None:
        return UNKNOWN
    if limit < low - 1e-6:
        return NeedFit(
            max(0.0, limit / low), f"speed limit {limit:.1f} m/s, needs at least {low:g} m/s"
        )
    return MET if limit >= high else NeedFit((limit - low) / (high - low))


def lane_width(event: Event, block: Block, kind: Kind) -> NeedFit:
    """Score the share of the forward lanes that are neither too narrow nor too wide.

    The VUT's must be among them, and so many of them side by side as the kind needs.
    """
    low, high = bounds(event.topology.lane_width.range)
    lanes = block.forward_lanes
    if not lanes:
        return NeedFit(0.0)
    fits = [low - _WIDTH_M <= lane.width_m <= high + _WIDTH_M for lane in lanes]
    share = sum(fits) / len(fits)
    mine = [i for i in vut_lanes(event, block) if fits[i]]
    beside = any(
        all(fits[j : j + kind.same_direction_lanes]) and j <= i < j + kind.same_direction_lanes
        for i in mine
        for j in range(max(0, len(lanes) - kind.same_direction_lanes + 1))
    )
    # Too few lanes is another need's business.
    if beside or len(lanes) < kind.same_direction_lanes or not vut_lanes(event, block):
        return NeedFit(share)
    widths = ", ".join(f"{lane.width_m:.2f}" for lane in lanes)
    return NeedFit(share, f"lane widths {widths} m from right to left, needs {_range(low, high)} m")


def _range(low: float, high: float) -> str:
    if math.isinf(high):
        return f"at least {low:g}"
    return f"at most {high:g}" if math.isinf(low) else f"{low:g} to {high:g}"


def curvature(event: Event, block: Block) -> NeedFit:
    """Compare the curvature over any 10 m with K*."""
    curvature_1pm, limits = bend_1pm(block.line), bounds(event.topology.curvature.range)
    return _measured(f"curvature {curvature_1pm:.4f}", curvature_1pm, limits, "1/m")


def kerb_sides(event: Event) -> Collection[str]:
    """Return the sides of the road beyond which a participant waits or to which it walks."""
    if event.interaction.relation == "crossing" and not KINDS[event.interaction.type].at_junction:
        return ("right", "left")
    region_places = {who.region.place for who in event.participants.values()}
    return tuple(s for s in ("right", "left") if f"{s}_kerb" in region_places)


def clearance(event: Event, block: Block) -> NeedFit:
    """Compare the room beyond the outermost lanes, shoulder and sidewalk together.

    Where somebody waits or walks to it is a must; for run-off it makes a block fitter, as most maps
    don't say what lies beside the road.
    """
    low, _ = bounds(event.constraints.site.lateral_clearance)
    room = {
        "right": block.shoulder_right_m + block.sidewalk_right_m,
        "left": block.shoulder_left_m + block.sidewalk_left_m,
    }
    if not low > 0.0:
        return MET
    share = min(1.0, *(room[side] / low for side in room))
    short = [
        f"clearance on the {side} {room[side]:.1f} m, needs at least {low:g} m"
        for side in kerb_sides(event)
        if room[side] < low - 1e-6
    ]
    return NeedFit(share, "; ".join(short) or None)


# λ of METHOD 2.2, the same for each score, and how near two totals are that tie.
LAMBDA = 1 / 3
TIE = 1e-9


def _mean(fits: Sequence[NeedFit]) -> float:
    return min(1.0, sum(one.share for one in fits) / len(fits))


def score_block(event: Event, block: Block, kind: Kind) -> BlockScore:
    """Score one block by METHOD 2.2; each need that excludes it is a reason, with numbers."""
    t = event.topology
    # Topology first, and of it the number of lanes: what a map can't change. A kind of junctions
    # asks for the junction before that.
    first = {"segment": segment(event, block)} if kind.at_junction else {}
    topology = first | {
        "lanes_same_direction": same_direction(event, block, kind),
        "road_type": road_type(event, block),
        "segment": segment(event, block),
        "lanes_opposite": opposite(event, block),
        "vut_lane": vut_lane(event, block),
        "left_boundary": boundary(t.left_boundary, block.left_boundary),
        "right_boundary": boundary(t.right_boundary, block.right_boundary),
    }
    interaction = [
        relation(event, block),
        manoeuvres(event, block, kind),
        places(event, block),
        *turn(event, block),
    ]
    constraints = [
        length(event, block),
        speed_limit(event, block),
        lane_width(event, block, kind),
        curvature(event, block),
        clearance(event, block),
    ]
    s_t, s_i, s_c = _mean([*topology.values()]), _mean(interaction), _mean(constraints)
    total = LAMBDA * s_t + LAMBDA * s_i + LAMBDA * s_c
    differs = identity(event, block)
    topology_reasons = {
        name: one.missing for name, one in topology.items() if one.missing is not None
    }
    reasons = [
        f"{why} (identity)" if name in differs else why for name, why in topology_reasons.items()
    ]
    reasons += [
        f"{why} (identity)" for name, why in differs.items() if name not in topology_reasons
    ]
    reasons += [one.missing for one in (*interaction, *constraints) if one.missing is not None]
    return BlockScore(
        block=block.block_id,
        topology=s_t,
        interaction=s_i,
        constraints=s_c,
        total=min(1.0, total),
        reasons=reasons,
        eligible=not reasons,
    )


def score_blocks(event: Event, library: Library) -> list[BlockScore]:
    """Score all blocks of a library: eligible ones first, best first, then by id."""
    kind = KINDS[event.interaction.type]
    scores = [score_block(event, block, kind) for block in library.blocks]
    return sorted(scores, key=lambda score: (not score.eligible, -score.total, score.block))


def ties(scores: Sequence[BlockScore]) -> list[BlockScore]:
    """Return the eligible blocks whose total is the best one's; a single one is the winner."""
    fits = [score for score in scores if score.eligible]
    best = max((score.total for score in fits), default=0.0)
    return [score for score in fits if best - score.total <= TIE]
