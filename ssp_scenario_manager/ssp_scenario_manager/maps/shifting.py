"""Lanes of an OpenDRIVE road that shift, each along its own middle.

A block has lanes at constant offsets, so that no block has a lane over a taper. A route needs only
the lane's own middle: it leads over a lane that stays wide enough, however far that shifts.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.lane_layout import (
    DRIVING,
    Stretch,
    breaks,
    drivable_widths,
    laid_out,
    runs_along,
)
from ssp_scenario_manager.maps.opendrive_road import RoadRecord, Section
from ssp_scenario_manager.maps.reference_line import Unusable, smooth_line

# Parts of a section under this are rounding.
_SHORTEST_M = 1e-6
# The middle is sampled at this step.
_STEP_M = 1.0
# A middle that is nearer to the centre of a bend, as a share of its radius, isn't followed.
_REACH = 0.95


@dataclass(frozen=True, slots=True)
class ShiftingLane:
    """A driving lane over a part of one lane section in which it shifts.

    Args:
        along: traffic runs in the road's direction.
        width_m: narrowest.
    """

    section: Section
    lane_id: int
    along: bool
    start_m: float
    end_m: float
    width_m: float


def shifting_lanes(road: RoadRecord, steady: Sequence[Stretch]) -> Iterator[ShiftingLane]:
    """Yield the lanes of a road that stay wide enough where no steady stretch has them.

    Args:
        road: that they are of.
        steady: its stretches.
    """
    steady_spans: dict[tuple[float, int], list[tuple[float, float]]] = {}
    for stretch in steady:
        for slot in stretch.slots:
            if slot.driving:
                spans = steady_spans.setdefault((stretch.section.start_m, slot.id), [])
                spans.append((stretch.start_m, stretch.end_m))
    for section in road.sections:
        lanes = [lane for lane in section.lanes if lane.type in DRIVING]
        whole = [(section.start_m, section.end_m)]
        if all(steady_spans.get((section.start_m, lane.id)) == whole for lane in lanes):
            continue
        widths: dict[float, dict[int, float]] = {}
        steps = [(a, b) for a, b in pairwise(breaks(road, section)) if b - a > _SHORTEST_M]
        for lane in lanes:
            spans = steady_spans.get((section.start_m, lane.id), [])
            starts = [low for low, _ in spans]
            run: list[tuple[float, float, float]] = []
            for a, b in [*steps, (math.inf, math.inf)]:
                i = bisect_right(starts, a) - 1
                is_held = i >= 0 and b <= spans[i][1]
                width = math.nan
                if not is_held and b < math.inf:
                    if a not in widths:
                        widths[a] = drivable_widths(road, section, a, b)
                    width = widths[a].get(lane.id, math.nan)
                if width > 0.0:
                    run.append((a, b, width))
                elif run:
                    along = runs_along(road, lane)
                    narrowest = min(width for _, _, width in run)
                    yield ShiftingLane(section, lane.id, along, run[0][0], run[-1][1], narrowest)
                    run = []


def middle_line(road: RoadRecord, line: ReferenceLine, lane: ShiftingLane) -> ReferenceLine:
    """Return the line along the middle of a lane, in the road's direction.

    Args:
        road: that the lane is of.
        line: the road's own.
        lane: the lane.

    Raises:
        Unusable: the lane has no such line.
    """
    high = min(lane.end_m, line.length_m)
    count = max(2, math.ceil((high - lane.start_m) / _STEP_M) + 1)
    s = np.linspace(lane.start_m, high, count)
    offsets = np.zeros_like(s)
    for a, b in pairwise(breaks(road, lane.section)):
        here = (s >= a) & (s <= b)
        for laid in laid_out(road, lane.section, s[here], 0.5 * (a + b)):
            if laid.lane.id == lane.lane_id:
                offsets[here] = laid.centre_m
    for at_m, offset_m in zip(s.tolist(), offsets.tolist(), strict=True):
        if offset_m * line.curvature_1pm(at_m) >= _REACH:
            raise Unusable(
                f"lane {lane.lane_id} lies {abs(offset_m):.1f} m from the reference line at s = "
                f"{at_m:g} m, at the centre of its bend"
            )
    poses = line.poses(s.tolist())
    return smooth_line(
        [pose.to_parent(0.0, y_m) for pose, y_m in zip(poses, offsets.tolist(), strict=True)]
    )
