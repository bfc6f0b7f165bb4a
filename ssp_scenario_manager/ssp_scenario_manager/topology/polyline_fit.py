"""A smooth reference line along a polyline, for maps that know no curves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.run_file.road import CurvePiece
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.topology.plan_view import Unusable, piece

# The line cuts each corner by at most this.
CORNER_CUT_M = 0.25
_SHARPEST_RAD = math.radians(150.0)
_SAME_M = 0.01
_SMALLEST_TURN_RAD = 1e-7


def _distinct(points: Sequence[Point]) -> list[Point]:
    kept: list[Point] = []
    for point in points:
        if not kept or math.dist(point, kept[-1]) > _SAME_M:
            kept.append(point)
    return kept


def smooth_line(points: Sequence[Point]) -> ReferenceLine:
    """Straights with an arc at each corner, tangent to both sides of it.

    An arc begins and ends at the same distance from its corner, which is half of the shorter side,
    or less where the corner would be cut by more than 25 cm. Points that sample a bend thus give
    arcs that follow one another.

    Raises:
        Unusable: there are fewer than two places, or a corner turns by more than 150 degrees.
    """
    places = _distinct(points)
    if len(places) < 2:
        raise Unusable("has no length")
    sides = [math.dist(a, b) for a, b in pairwise(places)]
    yaws = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(places)]
    pieces: list[CurvePiece] = []
    done = 0.0
    for i, (before, after) in enumerate(pairwise(yaws)):
        turn = wrap_angle(after - before)
        if abs(turn) > _SHARPEST_RAD:
            x, y = places[i + 1]
            raise Unusable(f"turns by {math.degrees(turn):.0f} degrees at ({x:g}, {y:g})")
        if abs(turn) < _SMALLEST_TURN_RAD:
            reach = 0.0
        else:
            # An arc that begins t before a corner of angle a cuts it by t tan(a / 4).
            reach = min(0.5 * min(sides[i], sides[i + 1]), CORNER_CUT_M / math.tan(abs(turn) / 4))
        ahead = sides[i] - done - reach
        if ahead > _SMALLEST_TURN_RAD:
            pieces.append(piece(ahead))
        if reach > 0.0:
            k = math.tan(turn / 2) / reach
            pieces.append(piece(turn / k, k))
        done = reach
    last = sides[-1] - done
    if last > _SMALLEST_TURN_RAD:
        pieces.append(piece(last))
    try:
        return ReferenceLine(Pose2(*places[0], yaws[0]), pieces)
    except ValueError as error:
        raise Unusable(str(error)) from error
