"""The surface of a junction as a table over the plane.

A junction isn't a function of the lateral position alone, as the road's own surface is. Its roads
are painted into a grid in the road's frame, and the grid holds running sums over both directions,
so that the mean over any footprint is four differences.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.run_file.road import JunctionRoad, Road
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.camera.kernels.jit import Array, inlined
from ssp_ot_controller.camera.kernels.palettes import Palette

CELL_M = 0.08
# The grid covers so much of each arm, from the junction's middle; beyond, the road's table is seen.
_REACH_M = 45.0
_FRACTION_BITS = 8
_CHORD_M = 0.02
_LINE_M, _INSET_M, _CENTRE_GAP_M = 0.14, 0.2, 0.14
_DASH_M, _PERIOD_M = 3.0, 9.0
_STOP_M, _STOP_BEFORE_M, _STOP_INSET_M = 0.4, 0.6, 0.15
_KERB_FACE_M, _KERB_TOP_M = 0.08, 0.24
# An arm whose direction differs from the road's by less is the road's own. It has a stop line only
# if each way on from it bends by more than this somewhere, as into a ring.
_OWN_ARM_RAD = math.radians(30.0)
_ONE_PLACE_M = 0.5

# Channels: blue, green and red, then how much of the ground is the junction's, and its texture.
BLUE, GREEN, RED, SHARE, GRAIN, PAVING = range(6)
_CHANNELS = 6


class JunctionGround(NamedTuple):
    """A junction's surface: channels are weighted with its share of the ground.

    Args:
        sums: shape (rows + 1, columns + 1, 6), running sums over cells along and across the road;
            (1, 1, 6) where there is no junction.
        s_m: arc length at which the grid begins.
        l_m: offset at which the grid begins.
    """

    sums: Array
    s_m: float
    l_m: float


def build_junction(road: Road, palette: Palette) -> JunctionGround:
    """Return the surface of the junction that a road leads through."""
    if not road.junction:
        return JunctionGround(np.zeros((1, 1, _CHANNELS)), 0.0, 0.0)
    canvas = _Canvas(road)
    inside = np.zeros(canvas.shape, dtype=np.uint8)
    surface = np.zeros(canvas.shape, dtype=np.uint8)
    for one in road.junction:
        line, length = ReferenceLine.of_road(one), one.length_m
        canvas.strip(surface, line, (0.0, length), (one.right_edge_m, one.left_edge_m))
        if one.junction_at == "both":
            canvas.strip(inside, line, (0.0, length), (one.right_edge_m, one.left_edge_m))
    table = _ground(road, palette, surface)
    marks = np.zeros(canvas.shape, dtype=np.uint8)
    centre = np.zeros(canvas.shape, dtype=np.uint8)
    for one in road.junction:
        if one.junction_at != "both":
            stops = not (is_own_arm(canvas.line, one) and _goes_on(road, one))
            _mark(canvas, marks, centre, one, palette.centre_line == "solid", stops)
    # Markings of an arm end where the connecting roads begin.
    for mask, colour in ((marks, palette.marking), (centre, palette.centre_marking)):
        table[(mask > 0) & (inside == 0), :SHARE] = colour
    return JunctionGround(_running_sums(table), *canvas.corner)


def _ground(road: Road, palette: Palette, surface: Array) -> Array:
    """Return carriageway, kerbs and sidewalks, channels not yet weighted."""
    from scipy.ndimage import distance_transform_edt  # type: ignore[import-untyped] # has no types

    away = CELL_M * distance_transform_edt(surface == 0)
    walk = max(road.sidewalk_left_m, road.sidewalk_right_m, _KERB_TOP_M)
    table = np.zeros((*surface.shape, _CHANNELS))
    table[surface > 0, :SHARE] = palette.asphalt
    table[surface > 0, GRAIN] = palette.asphalt_texture
    for low, high, colour, light, paving in (
        (0.0, _KERB_FACE_M, palette.kerb, 0.6, 0.0),
        (_KERB_FACE_M, _KERB_TOP_M, palette.kerb, 1.0, 0.0),
        (_KERB_TOP_M, walk, palette.sidewalk, 1.0, 1.0),
    ):
        band = (away > low) & (away <= high)
        table[band, :SHARE] = np.multiply(colour, light)
        table[band, GRAIN] = palette.asphalt_texture
        table[band, PAVING] = paving
    table[away <= walk, SHARE] = 1.0
    return table


def _running_sums(table: Array) -> Array:
    table[..., [BLUE, GREEN, RED, GRAIN, PAVING]] *= table[..., SHARE, None]
    sums = np.zeros((table.shape[0] + 1, table.shape[1] + 1, _CHANNELS))
    np.cumsum(table, axis=0, out=sums[1:, 1:])
    np.cumsum(sums[1:, 1:], axis=1, out=sums[1:, 1:])
    return sums


class _Canvas:
    """The grid of a junction: rows along the road, columns across it."""

    def __init__(self, road: Road) -> None:
        self.line = ReferenceLine.of_road(road)
        ends = [
            place
            for one in road.junction
            if one.junction_at == "both"
            for place in ReferenceLine.of_road(one).path(0.0, one.length_m, 0.0)
        ]
        places = self.local(np.array(ends))
        low, high = places.min(axis=0), places.max(axis=0)
        middle = 0.5 * (low + high)
        half = np.maximum(0.5 * (high - low) + 10.0, _REACH_M)
        # Beyond its own arms the road's table goes on, so that little of them is needed, unless
        # they have lanes that the road hasn't.
        first, last = self._own_arms(road, low[0] - 10.0, high[0] + 10.0)
        middle[0], half[0] = 0.5 * (first + last), 0.5 * (last - first)
        self.corner = float(middle[0] - half[0]), float(middle[1] - half[1])
        rows, columns = np.ceil(2 * half / CELL_M).astype(int)
        self.shape = int(rows), int(columns)

    def _own_arms(self, road: Road, first_m: float, last_m: float) -> tuple[float, float]:
        """Return arc lengths between which also the road's own arms lie that are wider than it."""
        for arm in road.junction:
            if is_wider_own_arm(road, self.line, arm):
                far = ReferenceLine.of_road(arm).to_map(_far_end_m(arm), 0.0)
                stations = self.local(np.array([far]))[:, 0].tolist()
                first_m, last_m = min(first_m, *stations), max(last_m, *stations)
        return first_m, last_m

    def local(self, places: FloatArray) -> FloatArray:
        """Return places of frame map in the road's frame, without those that have none there."""
        local_places = self.line.to_local_many(places)
        return local_places[np.isfinite(local_places).all(axis=1)]

    def strip(
        self, mask: Array, line: ReferenceLine, along: tuple[float, float], across: Sequence[float]
    ) -> None:
        """Paint the part of a road between two arc lengths and two offsets."""
        right, left = across
        outline = [*line.path(*along, right, _CHORD_M), *line.path(*along[::-1], left, _CHORD_M)]
        places = (self.local(np.array(outline)) - self.corner) / CELL_M - 0.5
        # OpenCV has columns first.
        points = np.round(places[:, ::-1] * (1 << _FRACTION_BITS)).astype(np.int32)
        cv2.fillPoly(mask, [points], 1, cv2.LINE_8, _FRACTION_BITS)


def is_own_arm(line: ReferenceLine, arm: JunctionRoad) -> bool:
    """Tell whether an arm leads along a road, whose line is given, or against it."""
    its = ReferenceLine.of_road(arm)
    pose = its.pose(arm.length_m if arm.junction_at == "end" else 0.0)
    at = float(np.nan_to_num(line.to_local_many(np.array([[pose.x_m, pose.y_m]]))[0, 0]))
    turn = abs(wrap_angle(pose.yaw_rad - line.pose(at).yaw_rad))
    return min(turn, math.pi - turn) < _OWN_ARM_RAD


def is_wider_own_arm(road: Road, line: ReferenceLine, arm: JunctionRoad) -> bool:
    """Tell whether an arm is a road's own and has lanes that the road, with its line, hasn't."""
    if arm.junction_at == "both" or not is_own_arm(line, arm):
        return False
    its = ReferenceLine.of_road(arm)
    ends = [its.to_map(station, 0.0) for station in (0.0, arm.length_m)]
    offsets = line.to_local_many(np.array(ends))[:, 1]
    lies_on_it = bool((np.abs(offsets) < arm.left_edge_m - arm.right_edge_m).all())
    road_m = sum(lane.width_m for lane in road.lanes)
    return lies_on_it and arm.left_edge_m - arm.right_edge_m > road_m + _ONE_PLACE_M


def _far_end_m(arm: JunctionRoad) -> float:
    return 0.0 if arm.junction_at == "end" else arm.length_m


def _goes_on(road: Road, arm: JunctionRoad) -> bool:
    """Tell whether a way leads straight on from an arm."""
    line, at_end = ReferenceLine.of_road(arm), arm.junction_at == "end"
    station = arm.length_m if at_end else 0.0
    ends = [
        line.to_map(station, lane.y_m)
        for lane in arm.lanes
        if (lane.direction == "forward") == at_end
    ]
    for one in road.junction:
        way = ReferenceLine.of_road(one)
        start = (way.origin.x_m, way.origin.y_m)
        if one.junction_at == "both" and any(math.dist(start, e) < _ONE_PLACE_M for e in ends):
            stations = np.linspace(0.0, one.length_m, 20).tolist()
            turns = [wrap_angle(way.pose(s).yaw_rad - way.origin.yaw_rad) for s in stations]
            if max(map(abs, turns)) < _OWN_ARM_RAD:
                return True
    return not ends


def _mark(
    canvas: _Canvas, marks: Array, centre: Array, arm: JunctionRoad, solid: bool, stops: bool
) -> None:
    """Paint the markings of an arm: its edges, the borders of its lanes, and its stop lines."""
    line, length = ReferenceLine.of_road(arm), arm.length_m
    lanes = sorted(arm.lanes, key=lambda lane: lane.y_m)

    def stripe(mask: Array, along: tuple[float, float], middle_m: float) -> None:
        canvas.strip(mask, line, along, (middle_m - _LINE_M / 2, middle_m + _LINE_M / 2))

    for edge_m in (arm.right_edge_m + _INSET_M, arm.left_edge_m - _INSET_M):
        stripe(marks, (0.0, length), edge_m)
    for lower, upper in pairwise(lanes):
        border = (lower.y_m + lower.width_m / 2 + upper.y_m - upper.width_m / 2) / 2
        if lower.direction == upper.direction:
            for begin in np.arange(0.0, length, _PERIOD_M).tolist():
                stripe(marks, (begin, min(begin + _DASH_M, length)), border)
        elif solid:
            stripe(centre, (0.0, length), border)
        else:
            for side in (-1, 1):
                stripe(centre, (0.0, length), border + side * (_CENTRE_GAP_M + _LINE_M) / 2)
    at_end = arm.junction_at == "end"
    if not stops:
        return
    near = length - _STOP_BEFORE_M if at_end else _STOP_BEFORE_M
    far = near - _STOP_M if at_end else near + _STOP_M
    for lane in lanes:
        if (lane.direction == "forward") == at_end:
            half = lane.width_m / 2 - _STOP_INSET_M
            along = (min(near, far), max(near, far))
            canvas.strip(marks, line, along, (lane.y_m - half, lane.y_m + half))


CELLS_PER_M = 1.0 / CELL_M


@inlined
def touches(junction: JunctionGround, x: float, y: float, wx: float, wy: float) -> bool:
    """Tell whether a footprint reaches into the grid of a junction."""
    rows, columns = junction.sums.shape[0] - 1, junction.sums.shape[1] - 1
    if rows == 0:
        return False
    low_x, low_y = x - wx / 2 - junction.s_m, y - wy / 2 - junction.l_m
    reaches: bool = (
        low_x < rows * CELL_M and low_y < columns * CELL_M and low_x + wx > 0.0 and low_y + wy > 0.0
    )
    return reaches


@inlined
def _sum_up_to(sums: Array, row: float, column: float, channel: int) -> float:
    """Return the sum over all cells up to a place in the grid, linear within cells."""
    rows, columns = sums.shape[0] - 1, sums.shape[1] - 1
    r, c = min(max(row, 0.0), float(rows)), min(max(column, 0.0), float(columns))
    i, j = min(int(r), rows - 1), min(int(c), columns - 1)
    fr, fc = r - i, c - j
    low = (1.0 - fc) * sums[i, j, channel] + fc * sums[i, j + 1, channel]
    high = (1.0 - fc) * sums[i + 1, j, channel] + fc * sums[i + 1, j + 1, channel]
    total: float = (1.0 - fr) * low + fr * high
    return total


@inlined
def mean_of(
    junction: JunctionGround, x: float, y: float, wx: float, wy: float, channel: int
) -> float:
    """Return the mean of a channel over a footprint, which is at least a cell wide.

    Args:
        junction: the junction's surface.
        x: arc length of the footprint's middle, m.
        y: offset of the footprint's middle, m.
        wx: extent along the road, m.
        wy: extent across the road, m.
        channel: of the surface.
    """
    wx, wy = max(wx, CELL_M), max(wy, CELL_M)
    a = (x - wx / 2 - junction.s_m) * CELLS_PER_M
    b = (x + wx / 2 - junction.s_m) * CELLS_PER_M
    c = (y - wy / 2 - junction.l_m) * CELLS_PER_M
    d = (y + wy / 2 - junction.l_m) * CELLS_PER_M
    sums = junction.sums
    total = _sum_up_to(sums, b, d, channel) - _sum_up_to(sums, a, d, channel)
    total += _sum_up_to(sums, a, c, channel) - _sum_up_to(sums, b, c, channel)
    mean: float = total / ((b - a) * (d - c))
    return mean
