"""The road's surface as tables over the lateral position.

The block is straight, so everything on the ground is a function of the lateral position, times a
pattern along the road (dashes, zebra crossing, stop lines, paving joints). The table holds running
sums over the lateral position; the mean over any footprint is then one difference, and markings
are smooth at every distance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ssp_core.run_file.road import Lane, Road
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.palettes import Palette

HALF_WIDTH_M = 80.0
CELL_M = 0.02
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
STOP_WIDTH_M = 0.4
STOP_DISTANCE_M = 1.2
DASH_M, DASH_PERIOD_M = 3.0, 9.0
JOINT_M, JOINT_PERIOD_M = 0.03, 0.9

# Layout of the vector of numbers that ground_row wants beside the table.
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
    _,
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


@dataclass(frozen=True)
class Tables:
    """Two tables over the lateral position: along the road, and at its zebra crossing.

    Args:
        sums: shape (2, cells + 1, CHANNELS), running sums.
        strips: shape (2, cells), int16: number of the strip of equal cells that a cell is in.
        values: shape (2, strips, CHANNELS), what the cells of a strip hold.
    """

    sums: Array
    strips: Array
    values: Array


def build_tables(road: Road, palette: Palette) -> Tables:
    """The surface of a road."""
    lanes = sorted(road.lanes, key=lambda lane: lane.y_m)
    along = _surface(road, palette)
    crossing = along.copy()
    _paint_borders(along, lanes, palette)
    _paint_crossing(crossing, lanes, road.left_edge_m, road.right_edge_m)
    both = np.stack([along, crossing])
    changes = np.zeros(both.shape[:2], dtype=np.int16)
    changes[:, 1:] = (both[:, 1:] != both[:, :-1]).any(axis=2)
    strips = np.cumsum(changes, axis=1, dtype=np.int16)
    values = np.zeros((2, int(strips.max()) + 1, CHANNELS))
    for table in range(2):
        values[table, strips[table]] = both[table]
    return Tables(np.stack([_running_sums(along), _running_sums(crossing)]), strips, values)


def build_parameters(road: Road, palette: Palette, texture: bool) -> Array:
    """The vector that ground_row wants beside the table, shape (PARAMETERS,)."""
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
