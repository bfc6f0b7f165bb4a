"""The road's surface as a table over the lateral position, and its colour at a place.

The block is straight, so everything on the ground is a function of the lateral position, times a
pattern along the road (dashes, zebra crossing, stop lines, paving joints). The table holds running
sums over the lateral position; the mean over any footprint is then one difference, and markings
are smooth at every distance.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from ssp_core.run_spec import Lane, Road
from ssp_ot_controller.camera.jit import Array, inlined
from ssp_ot_controller.camera.palettes import Palette
from ssp_ot_controller.camera.surfaces import noise_at

HALF_WIDTH_M = 80.0
CELL_M = 0.02
_CELLS_PER_M = 1.0 / CELL_M
KERB_HEIGHT_M = 0.12

# Channels of the surface table; blue, green and red come first in both.
DASHED, GRAIN, PAVING = 3, 4, 5
# Channels of the table that holds at a zebra crossing, where the centre line is interrupted.
ZEBRA, STOP_FORWARD, STOP_BACKWARD = 3, 4, 5
CHANNELS = 6

LINE_WIDTH_M = 0.14
_EDGE_INSET_M = 0.2
_DOUBLE_GAP_M = 0.14
_KERB_TOP_M = 0.16
_ZEBRA_BAR_M = 0.5
ZEBRA_HALF_LENGTH_M = 2.0
_STOP_WIDTH_M = 0.4
_STOP_DISTANCE_M = 1.2
_DASH_M, _DASH_PERIOD_M = 3.0, 9.0
_JOINT_M, _JOINT_PERIOD_M = 0.03, 0.9

# Layout of the vector of numbers that shade_ground wants beside the table.
(
    P_LEFT_EDGE,
    P_RIGHT_EDGE,
    P_LEFT_RAISED,
    P_RIGHT_RAISED,
    P_CROSSING_X,  # NaN: none
    P_TEXTURE,  # 0 or 1
    P_MARK_B,
    P_MARK_G,
    P_MARK_R,
    P_KERB_B,
    P_KERB_G,
    P_KERB_R,
) = range(12)
PARAMETERS = 12


def _paint(
    table: Array, channels: slice | int, start_m: float, end_m: float, value: object
) -> None:
    """Puts a value between two lateral positions, in proportion where a cell is cut."""
    low = -HALF_WIDTH_M + CELL_M * np.arange(len(table))
    share = np.clip((np.minimum(end_m, low + CELL_M) - np.maximum(start_m, low)) / CELL_M, 0.0, 1.0)
    if isinstance(channels, slice):
        share = share[:, None]
    table[:, channels] = table[:, channels] * (1.0 - share) + share * np.asarray(value)


def _line(table: Array, channels: slice | int, centre_m: float, value: object) -> None:
    _paint(table, channels, centre_m - LINE_WIDTH_M / 2, centre_m + LINE_WIDTH_M / 2, value)


def _surface(road: Road, palette: Palette) -> Array:
    """Ground, sidewalks, carriageway and edge lines; shape (cells, CHANNELS)."""
    table = np.zeros((round(2 * HALF_WIDTH_M / CELL_M), CHANNELS))
    left, right = road.left_edge_m, road.right_edge_m
    colour = slice(0, 3)
    table[:, colour] = palette.verge
    table[:, GRAIN] = palette.verge_texture
    for edge, outward, width in (
        (left, 1.0, road.sidewalk_left_m),
        (right, -1.0, road.sidewalk_right_m),
    ):
        near, far = sorted((edge, edge + outward * max(width, 0.5)))
        _paint(table, GRAIN, near, far, palette.asphalt_texture)
        if width > 0.0:
            _paint(table, colour, near, far, palette.sidewalk)
            _paint(table, PAVING, near, far, 1.0)
            near, far = sorted((edge, edge + outward * _KERB_TOP_M))
            _paint(table, colour, near, far, palette.kerb)
            _paint(table, PAVING, near, far, 0.0)
        else:
            _paint(table, colour, near, far, np.multiply(palette.asphalt, 0.93))
    _paint(table, colour, right, left, palette.asphalt)
    _paint(table, GRAIN, right, left, palette.asphalt_texture)
    for lane in road.lanes:  # wheel tracks
        for side in (-1, 1):
            track = lane.y_m + side * 0.8
            _paint(table, colour, track - 0.28, track + 0.28, np.multiply(palette.asphalt, 0.95))
    for y in (left - _EDGE_INSET_M, right + _EDGE_INSET_M):
        _line(table, colour, y, palette.marking)
    return table


def _paint_borders(table: Array, lanes: list[Lane], palette: Palette) -> None:
    """Dashes between lanes of one direction, the centre line between directions."""
    for lower, upper in pairwise(lanes):
        border = (lower.y_m + lower.width_m / 2 + upper.y_m - upper.width_m / 2) / 2
        if lower.direction == upper.direction:
            _line(table, DASHED, border, 1.0)
        elif palette.centre_line == "solid":
            _line(table, slice(0, 3), border, palette.centre_marking)
        else:
            for side in (-1, 1):
                y = border + side * (_DOUBLE_GAP_M + LINE_WIDTH_M) / 2
                _line(table, slice(0, 3), y, palette.centre_marking)


def _paint_crossing(table: Array, lanes: list[Lane], left_m: float, right_m: float) -> None:
    width = left_m - right_m
    bars = max(1, int((width - _ZEBRA_BAR_M) / (2 * _ZEBRA_BAR_M)))
    start = (left_m + right_m) / 2 - (2 * bars - 1) * _ZEBRA_BAR_M / 2
    table[:, 3:] = 0.0
    for i in range(bars):
        bar = start + 2 * i * _ZEBRA_BAR_M
        _paint(table, ZEBRA, bar, bar + _ZEBRA_BAR_M, 1.0)
    for lane in lanes:
        channel = STOP_FORWARD if lane.direction == "forward" else STOP_BACKWARD
        half = lane.width_m / 2 - 0.15
        _paint(table, channel, lane.y_m - half, lane.y_m + half, 1.0)


def _running_sums(table: Array) -> Array:
    return np.concatenate([np.zeros((1, CHANNELS)), np.cumsum(table, axis=0) * CELL_M])


def build_tables(road: Road, palette: Palette) -> Array:
    """Running sums over the lateral position, shape (2, cells + 1, CHANNELS).

    The first table holds along the road, the second at its zebra crossing.
    """
    lanes = sorted(road.lanes, key=lambda lane: lane.y_m)
    along = _surface(road, palette)
    crossing = along.copy()
    _paint_borders(along, lanes, palette)
    _paint_crossing(crossing, lanes, road.left_edge_m, road.right_edge_m)
    return np.stack([_running_sums(along), _running_sums(crossing)])


def build_parameters(road: Road, palette: Palette, texture: bool) -> Array:
    """The vector that shade_ground wants beside the table, shape (PARAMETERS,)."""
    numbers = np.zeros(PARAMETERS)
    numbers[P_LEFT_EDGE], numbers[P_RIGHT_EDGE] = road.left_edge_m, road.right_edge_m
    numbers[P_LEFT_RAISED] = road.sidewalk_left_m > 0.0
    numbers[P_RIGHT_RAISED] = road.sidewalk_right_m > 0.0
    numbers[P_CROSSING_X] = math.nan if road.crossing_x_m is None else road.crossing_x_m
    numbers[P_TEXTURE] = texture
    numbers[P_MARK_B : P_MARK_R + 1] = palette.marking
    numbers[P_KERB_B : P_KERB_R + 1] = palette.kerb
    return numbers


def ground_height(road: Road, y_m: float) -> float:
    """Height in m of the surface at a lateral position, with a short ramp for feet at the kerb."""
    for outside, width in (
        (y_m - road.left_edge_m, road.sidewalk_left_m),
        (road.right_edge_m - y_m, road.sidewalk_right_m),
    ):
        if width > 0.0 and outside > -0.2:
            return KERB_HEIGHT_M * min(1.0, (outside + 0.2) / 0.3)
    return 0.0


@inlined
def _pattern(x: float, width: float, mark: float, period: float) -> float:
    """Mean over [x - width/2, x + width/2] of marks of a length that repeat with a period."""
    a, b = x - width / 2, x + width / 2
    na, nb = math.floor(a / period), math.floor(b / period)
    fa = na * mark + min(a - na * period, mark)
    fb = nb * mark + min(b - nb * period, mark)
    share: float = (fb - fa) / width
    return share


@inlined
def _band(x: float, width: float, start: float, end: float) -> float:
    """Mean over [x - width/2, x + width/2] of one mark."""
    overlap = min(end, x + width / 2) - max(start, x - width / 2)
    share: float = max(0.0, overlap) / width
    return share


@inlined
def _mean(table: Array, y: float, width: float) -> tuple[float, float, float, float, float, float]:
    """Means of the channels of running sums over [y - width/2, y + width/2]."""
    last = table.shape[0] - 1
    a = (y - width / 2 + HALF_WIDTH_M) * _CELLS_PER_M
    b = (y + width / 2 + HALF_WIDTH_M) * _CELLS_PER_M
    a, b = min(max(a, 0.0), last - 1.0), max(min(b, float(last)), 1.0)
    ia, ib = min(int(a), last - 1), min(int(b), last - 1)
    fa, fb = a - ia, b - ib
    ga, gb = 1.0 - fa, 1.0 - fb
    scale = _CELLS_PER_M / (b - a)
    p, p1, q, q1 = table[ia], table[ia + 1], table[ib], table[ib + 1]
    return (
        scale * (gb * q[0] + fb * q1[0] - ga * p[0] - fa * p1[0]),
        scale * (gb * q[1] + fb * q1[1] - ga * p[1] - fa * p1[1]),
        scale * (gb * q[2] + fb * q1[2] - ga * p[2] - fa * p1[2]),
        scale * (gb * q[3] + fb * q1[3] - ga * p[3] - fa * p1[3]),
        scale * (gb * q[4] + fb * q1[4] - ga * p[4] - fa * p1[4]),
        scale * (gb * q[5] + fb * q1[5] - ga * p[5] - fa * p1[5]),
    )


@inlined
def _grain(noise: Array, x_m: float, y_m: float, footprint_m: float) -> float:
    """Grain and patches; each scale fades before a pixel can no longer resolve it."""
    fine = 1.0 - footprint_m / 0.12
    middle = 1.0 - footprint_m / 1.5
    coarse = 1.0 - footprint_m / 12.0
    grain = 0.0
    if coarse > 0.0:
        grain += 0.8 * coarse * noise_at(noise, 0.45 * x_m, 1.1 * y_m)
    if middle > 0.0:
        grain += 0.9 * middle * noise_at(noise, 4.0 * x_m + 31.0, 4.0 * y_m)
    if fine > 0.0:
        grain += 1.3 * fine * noise_at(noise, 60.0 * x_m, 60.0 * y_m)
    return grain


@inlined
def shade_ground(
    tables: Array,
    numbers: Array,
    noise: Array,
    x_m: float,
    y_m: float,
    width_x_m: float,
    width_y_m: float,
) -> tuple[float, float, float]:
    """Colour of the ground (blue, green, red), averaged over a footprint.

    Args:
        tables: running sums of build_tables.
        numbers: vector of build_parameters.
        noise: tileable noise.
        x_m, y_m: place in the block's frame.
        width_x_m, width_y_m: extents of the footprint along and across the road.
    """
    wx, wy = max(width_x_m, CELL_M), max(width_y_m, CELL_M)
    blue, green, red, mark, grain, paving = _mean(tables[0], y_m, wy)
    if mark > 0.0:
        mark *= _pattern(x_m, wx, _DASH_M, _DASH_PERIOD_M)
    crossing = numbers[P_CROSSING_X]
    half = ZEBRA_HALF_LENGTH_M
    reach = half + _STOP_DISTANCE_M + _STOP_WIDTH_M + wx / 2
    if abs(x_m - crossing) < reach:  # false without a crossing: NaN
        b, g, r, bars, forward, backward = _mean(tables[1], y_m, wy)
        zone = _band(x_m, wx, crossing - half - 0.2, crossing + half + 0.2)
        blue, green, red = (
            blue + zone * (b - blue),
            green + zone * (g - green),
            red + zone * (r - red),
        )
        mark *= 1.0 - zone
        mark += bars * _band(x_m, wx, crossing - half, crossing + half)
        stop = crossing - half - _STOP_DISTANCE_M
        mark += forward * _band(x_m, wx, stop - _STOP_WIDTH_M, stop)
        stop = crossing + half + _STOP_DISTANCE_M
        mark += backward * _band(x_m, wx, stop, stop + _STOP_WIDTH_M)
        mark = min(1.0, mark)
    blue += mark * (numbers[P_MARK_B] - blue)
    green += mark * (numbers[P_MARK_G] - green)
    red += mark * (numbers[P_MARK_R] - red)
    shade = 1.0
    if paving > 0.0:
        shade -= 0.22 * paving * _pattern(x_m, wx, _JOINT_M, _JOINT_PERIOD_M)
    if numbers[P_TEXTURE] > 0.0:
        grain *= _grain(noise, x_m, y_m, max(wx, wy))
    else:
        grain = 0.0
    return shade * blue + grain, shade * green + grain, shade * red + grain
