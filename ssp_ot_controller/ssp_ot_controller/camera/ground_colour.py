"""Colour of the ground over a footprint, without light and fog."""

from __future__ import annotations

import math

from ssp_ot_controller.camera import ground
from ssp_ot_controller.camera.jit import Array, inlined

CELLS_PER_M = 1.0 / ground.CELL_M
CROSSING_REACH_M = ground.ZEBRA_HALF_LENGTH_M + ground.STOP_DISTANCE_M + ground.STOP_WIDTH_M


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
    a = (y - width / 2 + ground.HALF_WIDTH_M) * CELLS_PER_M
    b = (y + width / 2 + ground.HALF_WIDTH_M) * CELLS_PER_M
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
        mark *= _pattern(x, wx, ground.DASH_M, ground.DASH_PERIOD_M)
    crossing = numbers[ground.P_CROSSING_X]
    half = ground.ZEBRA_HALF_LENGTH_M
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
        stop = crossing - half - ground.STOP_DISTANCE_M
        mark += forward * _band(x, wx, stop - ground.STOP_WIDTH_M, stop)
        stop = crossing + half + ground.STOP_DISTANCE_M
        mark += backward * _band(x, wx, stop, stop + ground.STOP_WIDTH_M)
        mark = min(1.0, mark)
    if mark > 0.0:
        blue += mark * (numbers[ground.P_MARK_B] - blue)
        green += mark * (numbers[ground.P_MARK_G] - green)
        red += mark * (numbers[ground.P_MARK_R] - red)
    if paving > 0.0:
        shade = 1.0 - 0.22 * paving * _pattern(x, wx, ground.JOINT_M, ground.JOINT_PERIOD_M)
        blue, green, red = shade * blue, shade * green, shade * red
    grain *= strength
    return blue + grain, green + grain, red + grain
