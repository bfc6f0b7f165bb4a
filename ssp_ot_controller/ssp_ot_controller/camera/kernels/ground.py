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
from ssp_ot_controller.camera.kernels.jit import Array, inlined
from ssp_ot_controller.camera.kernels.palettes import Palette
from ssp_ot_controller.camera.kernels.shading import noise_at

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


CELLS_PER_M = 1.0 / CELL_M
CROSSING_REACH_M = ZEBRA_HALF_LENGTH_M + STOP_DISTANCE_M + STOP_WIDTH_M


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
def _difference(
    sums: Array,
    table: int,
    ia: int,
    ib: int,
    ga: float,
    fa: float,
    gb: float,
    fb: float,
    channel: int,
) -> float:
    """Running sum between cells ib and ib + 1 less that between ia and ia + 1, so weighted."""
    high = gb * sums[table, ib, channel] + fb * sums[table, ib + 1, channel]
    low = ga * sums[table, ia, channel] + fa * sums[table, ia + 1, channel]
    rise: float = high - low
    return rise


@inlined
def _mean(
    sums: Array, strips: Array, values: Array, table: int, y: float, width: float
) -> tuple[float, float, float, float, float, float]:
    """Means of the channels over [y - width/2, y + width/2]."""
    last = strips.shape[1]
    a = (y - width / 2 + HALF_WIDTH_M) * CELLS_PER_M
    b = (y + width / 2 + HALF_WIDTH_M) * CELLS_PER_M
    a, b = min(max(a, 0.0), last - 1.0), max(min(b, float(last)), 1.0)
    ia, ib = min(int(a), last - 1), min(int(b), last - 1)
    strip = strips[table, ia]
    # Elements one by one: counting references to rows of an array takes longer than all the rest.
    if strip == strips[table, ib]:
        return (
            values[table, strip, 0],
            values[table, strip, 1],
            values[table, strip, 2],
            values[table, strip, 3],
            values[table, strip, 4],
            values[table, strip, 5],
        )
    scale = CELLS_PER_M / (b - a)
    fa, fb = scale * (a - ia), scale * (b - ib)
    ga, gb = scale - fa, scale - fb
    return (
        _difference(sums, table, ia, ib, ga, fa, gb, fb, 0),
        _difference(sums, table, ia, ib, ga, fa, gb, fb, 1),
        _difference(sums, table, ia, ib, ga, fa, gb, fb, 2),
        _difference(sums, table, ia, ib, ga, fa, gb, fb, 3),
        _difference(sums, table, ia, ib, ga, fa, gb, fb, 4),
        _difference(sums, table, ia, ib, ga, fa, gb, fb, 5),
    )


@inlined
def ground_colour(
    sums: Array,
    strips: Array,
    values: Array,
    numbers: Array,
    x: float,
    y: float,
    wx: float,
    wy: float,
    grain: float,
) -> tuple[float, float, float]:
    """Colour of the ground (blue, green, red), averaged over a footprint.

    Args:
        sums, strips, values: see ground.Tables.
        numbers: vector of ground.build_parameters.
        x, y: place in the block's frame, m.
        wx, wy: extents of the footprint along and across the road, m.
        grain: texture, in shares of its strength.
    """
    blue, green, red, mark, strength, paving = _mean(sums, strips, values, 0, y, wy)
    if mark > 0.0:
        mark *= _pattern(x, wx, DASH_M, DASH_PERIOD_M)
    crossing = numbers[P_CROSSING_X]
    half = ZEBRA_HALF_LENGTH_M
    if abs(x - crossing) < CROSSING_REACH_M + wx / 2:  # false without a crossing: NaN
        b, g, r, bars, forward, backward = _mean(sums, strips, values, 1, y, wy)
        zone = _band(x, wx, crossing - half - 0.2, crossing + half + 0.2)
        blue, green, red = (
            blue + zone * (b - blue),
            green + zone * (g - green),
            red + zone * (r - red),
        )
        mark *= 1.0 - zone
        mark += bars * _band(x, wx, crossing - half, crossing + half)
        stop = crossing - half - STOP_DISTANCE_M
        mark += forward * _band(x, wx, stop - STOP_WIDTH_M, stop)
        stop = crossing + half + STOP_DISTANCE_M
        mark += backward * _band(x, wx, stop, stop + STOP_WIDTH_M)
        mark = min(1.0, mark)
    if mark > 0.0:
        blue += mark * (numbers[P_MARK_B] - blue)
        green += mark * (numbers[P_MARK_G] - green)
        red += mark * (numbers[P_MARK_R] - red)
    if paving > 0.0:
        shade = 1.0 - 0.22 * paving * _pattern(x, wx, JOINT_M, JOINT_PERIOD_M)
        blue, green, red = shade * blue, shade * green, shade * red
    grain *= strength
    return blue + grain, green + grain, red + grain


BLOCK = 8  # pixels between which patches are linear: they are wider than that
FINE_M = 0.12  # footprint from which on fine grain isn't resolved
KERB_FACE = 0.72  # its light


@inlined
def patches(noise: Array, x_m: float, y_m: float, footprint_m: float) -> float:
    """Light and dark patches; each scale fades before a pixel can no longer resolve it."""
    middle = 1.0 - footprint_m / 1.5
    coarse = 1.0 - footprint_m / 12.0
    patch = 0.0
    if coarse > 0.0:
        patch += 0.8 * coarse * noise_at(noise, 0.45 * x_m, 1.1 * y_m)
    if middle > 0.0:
        patch += 0.9 * middle * noise_at(noise, 4.0 * x_m + 31.0, 4.0 * y_m)
    return patch


@inlined
def plain_strip(
    strips: Array, values: Array, crossing: float, x: float, y: float, wx: float, wy: float
) -> int:
    """A number for the ground around a footprint if it has one colour but for grain, else -1.

    Footprints with the same number have the same colour, and so has the ground between them.
    """
    last = strips.shape[1] - 1
    low = (y - wy / 2 + HALF_WIDTH_M) * CELLS_PER_M
    high = (y + wy / 2 + HALF_WIDTH_M) * CELLS_PER_M
    strip = strips[0, int(min(max(low, 0.0), float(last)))]
    if strip != strips[0, int(min(max(high, 0.0), float(last)))]:
        return -1
    if values[0, strip, DASHED] > 0.0 or values[0, strip, PAVING] > 0.0:
        return -1
    if abs(x - crossing) < CROSSING_REACH_M + wx / 2:
        return -1
    return 2 * int(strip) + int(x > crossing)


@inlined
def fill_plain(
    values: Array,
    strip: int,
    noise: Array,
    x: float,
    x_step: float,
    y: float,
    y_step: float,
    patch: float,
    patch_step: float,
    fine: float,
    fine_step: float,
    row: Array,
) -> None:
    """Pixels of one strip: its colour and grain, whose shares change by steps along the row."""
    blue, green, red = values[0, strip, 0], values[0, strip, 1], values[0, strip, 2]
    strength = values[0, strip, GRAIN]
    if fine <= 0.0 and fine + BLOCK * fine_step <= 0.0:
        for k in range(BLOCK):
            grain = strength * (patch + k * patch_step)
            row[3 * k], row[3 * k + 1], row[3 * k + 2] = blue + grain, green + grain, red + grain
        return
    for k in range(BLOCK):
        share = 1.3 * max(0.0, fine + k * fine_step)
        at = noise_at(noise, 60.0 * (x + k * x_step), 60.0 * (y + k * y_step))
        grain = strength * (patch + k * patch_step + share * at)
        row[3 * k], row[3 * k + 1], row[3 * k + 2] = blue + grain, green + grain, red + grain


@inlined
def meets(y_raised: float, y_road: float, numbers: Array) -> int:
    """What a ray meets: 0 the road's level, 1 the raised sidewalks, 2 the face of a kerb."""
    left, right = numbers[P_LEFT_EDGE], numbers[P_RIGHT_EDGE]
    raised_left = numbers[P_LEFT_RAISED] > 0.0
    raised_right = numbers[P_RIGHT_RAISED] > 0.0
    if (raised_left and y_raised > left) or (raised_right and y_raised < right):
        return 1
    if (raised_left and y_road > left) or (raised_right and y_road < right):
        return 2
    return 0


@inlined
def ground_row(
    sums: Array,
    strips: Array,
    values: Array,
    numbers: Array,
    noise: Array,
    position: Array,
    start: Array,
    rays: Array,
    hidden: Array,
    row: Array,
) -> None:
    """Colours of one image row below the horizon, without light and fog.

    Most of the ground has one colour but for its grain: where both ends of a block of pixels lie
    in one strip, so does all between them.

    Args:
        sums, strips, values: see ground.Tables.
        numbers: vector of ground.build_parameters.
        noise: tileable noise.
        position: camera centre, block frame.
        start: ray direction at column 0; its z is negative.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        hidden: shape (width,); pixels where it is true may be left out.
        row: shape (3 width,), blue, green, red in turn; filled.
    """
    textured = numbers[P_TEXTURE] > 0.0
    crossing = numbers[P_CROSSING_X]
    road_depth = -position[2] / start[2]
    raised_depth = (KERB_HEIGHT_M - position[2]) / start[2]
    growth = -rays[2, 2] / start[2]  # of the depth per row, over the depth
    across_x, across_y = abs(rays[1, 0]), abs(rays[1, 1])
    width = hidden.shape[0]
    patch_end, fine_end, code_end = 0.0, 0.0, -1
    for first in range(-BLOCK, width, BLOCK):
        patch, fine, code = patch_end, fine_end, code_end
        dx, dy = start[0] + (first + BLOCK) * rays[1, 0], start[1] + (first + BLOCK) * rays[1, 1]
        plane = meets(position[1] + raised_depth * dy, position[1] + road_depth * dy, numbers)
        t = raised_depth if plane == 1 else road_depth
        wx = max(t * (across_x + abs(growth * dx + rays[2, 0])), CELL_M)
        wy = max(t * (across_y + 0.5 * abs(growth * dy + rays[2, 1])), CELL_M)
        x, y = position[0] + t * dx, position[1] + t * dy
        if textured:
            patch_end = patches(noise, x, y, max(wx, wy))
            fine_end = 1.0 - max(wx, wy) / FINE_M
        code_end = -1
        if plane != 2:
            code_end = plain_strip(strips, values, crossing, x, y, wx, wy)
            if code_end >= 0:
                code_end = 2 * code_end + plane
        if code >= 0 and code == code_end and first + BLOCK <= width:
            fill_plain(
                values, code >> 2, noise, x - BLOCK * t * rays[1, 0], t * rays[1, 0],
                y - BLOCK * t * rays[1, 1], t * rays[1, 1], patch, (patch_end - patch) / BLOCK,
                fine, (fine_end - fine) / BLOCK, row[3 * first : 3 * (first + BLOCK)],
            )  # fmt: skip
            continue
        for u in range(max(first, 0), min(first + BLOCK, width)):
            if hidden[u]:
                continue
            dx, dy = start[0] + u * rays[1, 0], start[1] + u * rays[1, 1]
            plane = meets(position[1] + raised_depth * dy, position[1] + road_depth * dy, numbers)
            if plane == 2:
                for k in range(3):
                    row[3 * u + k] = KERB_FACE * numbers[P_KERB_B + k]
                continue
            t = raised_depth if plane == 1 else road_depth
            x, y = position[0] + t * dx, position[1] + t * dy
            wx = max(t * (across_x + abs(growth * dx + rays[2, 0])), CELL_M)
            wy = max(t * (across_y + 0.5 * abs(growth * dy + rays[2, 1])), CELL_M)
            grain = 0.0
            if textured:
                grain = patch + (u - first) / BLOCK * (patch_end - patch)
                near = 1.0 - max(wx, wy) / FINE_M
                if near > 0.0:
                    grain += 1.3 * near * noise_at(noise, 60.0 * x, 60.0 * y)
            blue, green, red = ground_colour(sums, strips, values, numbers, x, y, wx, wy, grain)
            row[3 * u], row[3 * u + 1], row[3 * u + 2] = blue, green, red
