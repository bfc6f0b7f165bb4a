"""The places on a block: lanes, kerbs, arc lengths, and what fits."""

from __future__ import annotations

import math

import numpy as np

from ssp_core.geometry import Polyline
from ssp_core.motion.state import Size
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import WIDEST_GAP_M, Block, BlockLane, headings
from ssp_scenario_manager.scenarios.base import BlockPoint, CannotPlace

# How far into a long and a short block the VUT starts.
_ENTRY_M = (15.0, 2.0)
_ENTRY_SHARE = 0.04
# Of sums of widths.
_ROUNDING_M = 1e-6
# Between what stands at a block's end and the end itself.
END_MARGIN_M = 2.0
# Curvature is taken over so much of a line, and jumps where it changes within so many of these.
_BEND_STEP_M = 1.0
_JUMP_STEPS = 3
# Of a jump: at most a third was measured with simulated vehicles, at 6.5 to 9 m/s.
_OVERSHOT_SHARE = 0.4
# Between a parked vehicle and the edge of the carriageway.
_PARKED_M = 0.15
# Between a parked vehicle and the outer end of the strip that it stands on.
_EDGE_M = 0.05


def vut_lane_indices(event: Event, block: Block) -> list[int]:
    """Return indices of the block's forward lanes that the VUT may drive in, preferred first.

    Raises:
        CannotPlace: there is no such lane.
    """
    count, words = len(block.forward_lanes), event.topology.vut_lane.words
    indices = lanes_of_words(words, count)
    if not indices:
        word = " or ".join(words)
        raise CannotPlace(f"of its {count} lane(s) in the VUT's direction none is the {word} one")
    return indices


def lanes_of_words(words: tuple[str, ...], count: int) -> list[int]:
    """Return lane indices, from the right, by part T's words in preferred order; no word: all."""
    lanes = range(count)
    lanes_by_word = {"rightmost": lanes[:1], "leftmost": lanes[-1:], "middle": lanes[1:-1]}
    indices = [index for word in words for index in lanes_by_word[word]] if words else list(lanes)
    return list(dict.fromkeys(indices))


def neighbour(block: Block, index: int, to_left: bool) -> BlockLane:
    """Return the lane beside a forward lane.

    Raises:
        CannotPlace: there is none in the same direction, or it isn't adjacent.
    """
    lanes = block.forward_lanes
    beside = index + (1 if to_left else -1)
    side = "left" if to_left else "right"
    if not 0 <= beside < len(lanes):
        raise CannotPlace(
            f"it has no driving lane to the {side} of the VUT's in its direction "
            f"({len(lanes)} driving lane(s) per direction)"
        )
    lane, other = lanes[index], lanes[beside]
    between = abs(other.y_m - lane.y_m) - (lane.width_m + other.width_m) / 2.0
    if between > WIDEST_GAP_M + _ROUNDING_M:
        raise CannotPlace(f"its lane to the {side} lies {between:.1f} m apart from the VUT's")
    return other


def right_kerb_m(block: Block) -> float:
    """Return the offset of the right kerb, where the sidewalk or verge begins."""
    return block.right_edge_m - block.shoulder_right_m


def left_kerb_m(block: Block) -> float:
    """Return the offset of the left kerb."""
    return block.left_edge_m + block.shoulder_left_m


def parked_m(block: Block, size: Size, lane_m: float, corridor_m: float, *, right: bool) -> float:
    """Return the offset of a vehicle that is parked along the carriageway.

    It stands beside the carriageway, and as far on it as the strip beside it is too narrow. A verge
    has no end.

    Args:
        block: that it is parked on.
        size: of the vehicle.
        lane_m: offset of the VUT's lane.
        corridor_m: half the width of the VUT's corridor.
        right: it is parked on the right side.

    Raises:
        CannotPlace: then it would stand in the VUT's corridor.
    """
    room = block.sidewalk_right_m + block.shoulder_right_m
    edge = lane_m - block.right_edge_m
    boundary = block.right_boundary if right else block.left_boundary
    if not right:
        room = block.sidewalk_left_m + block.shoulder_left_m
        edge = block.left_edge_m - lane_m
    free = boundary in ("verge", "any")
    beside = _PARKED_M if free else min(_PARKED_M, room - size.width_m - _EDGE_M)
    if edge + beside <= corridor_m:
        raise CannotPlace(
            f"a parked {size.width_m:g} m wide vehicle would stand "
            f"{corridor_m - edge - beside:.2f} m inside the VUT's corridor: beside the lane are "
            f"{room:g} m"
        )
    off = edge + beside + size.width_m / 2.0
    return lane_m - off if right else lane_m + off


def station_of(block: Block, from_s_m: float, to_s_m: float, l_m: float) -> float:
    """Return the distance along an offset line between arc lengths, m; negative backwards."""
    if block.line.is_straight or to_s_m == from_s_m:
        return to_s_m - from_s_m
    low, high = sorted((from_s_m, to_s_m))
    length = Polyline(block.line.path(low, high, l_m)).length_m
    return math.copysign(length, to_s_m - from_s_m)


def ahead_of(block: Block, from_s_m: float, distance_m: float, l_m: float) -> float:
    """Return the arc length of the place that lies a distance further along an offset line."""
    s = from_s_m + distance_m
    for _ in range(20):
        off = distance_m - station_of(block, from_s_m, s, l_m)
        s += off
        if abs(off) < 1e-4:
            break
    return s


def entry_m(block: Block) -> float:
    """Return how far into the block the VUT starts."""
    high, low = _ENTRY_M
    return min(high, max(low, _ENTRY_SHARE * block.length_m))


def bend_speed_mps(block: Block, from_s_m: float, to_s_m: float, most_mps2: float) -> float:
    """Return the highest speed at which a vehicle keeps to an acceleration sideways, m/s.

    Where curvature jumps, the steering lags behind it and then overshoots it by a share of the
    jump.

    Args:
        block: whose reference line it follows.
        from_s_m: arc length at which it begins.
        to_s_m: arc length at which it ends.
        most_mps2: the acceleration.

    Returns:
        inf where the line doesn't bend.
    """
    first, last = max(0.0, from_s_m), min(to_s_m, block.length_m)
    if block.line.is_straight or last <= first:
        return math.inf
    stations = np.linspace(first, last, math.ceil((last - first) / _BEND_STEP_M) + 1)
    bends = np.diff(headings(block.line, stations)) / np.diff(stations)
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(bends, (_JUMP_STEPS, 0), mode="edge"), _JUMP_STEPS + 1
    )
    jumps = windows.max(axis=1) - windows.min(axis=1)
    worst = float((np.abs(windows).max(axis=1) + _OVERSHOT_SHARE * jumps).max(initial=0.0))
    return math.sqrt(most_mps2 / worst) if worst > 0.0 else math.inf


def within_block(block: Block, size: Size, s_m: float, who: str) -> float:
    """Return an arc length at which a participant that faces along the block fits on it.

    Raises:
        CannotPlace: it leaves the block.
    """
    low, high = size.rear_m, block.length_m - size.front_m
    if not low <= s_m <= high:
        raise CannotPlace(
            f"{who} would start at s = {s_m:.1f} m; {low:g} to {high:.1f} m fits on the block"
        )
    return s_m


def end_of(block: Block, size: Size) -> float:
    """Return the arc length at which a path along the block ends."""
    return block.length_m - size.front_m - END_MARGIN_M


def rectangle(
    from_s_m: float, to_s_m: float, from_l_m: float, to_l_m: float
) -> tuple[BlockPoint, ...]:
    """Return corners of a stretch of the block, counter-clockwise."""
    low, high = round(from_s_m, 3), round(to_s_m, 3)
    right, left = round(from_l_m, 3), round(to_l_m, 3)
    return (
        BlockPoint(low, right),
        BlockPoint(high, right),
        BlockPoint(high, left),
        BlockPoint(low, left),
    )
