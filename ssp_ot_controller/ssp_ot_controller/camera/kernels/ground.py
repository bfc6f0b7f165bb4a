"""The road's surface as tables over the lateral position.

The block is straight, so everything on the ground is a function of the lateral position, times a
pattern along the road (dashes, zebra crossing, stop lines, paving joints). The table holds running
sums over the lateral position; the mean over any footprint is then one difference, and markings
are smooth at every distance.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ssp_core.run_file.road import Lane, Road
from ssp_ot_controller.camera.kernels.bend import Bend, locate
from ssp_ot_controller.camera.kernels.jit import Array, inlined
from ssp_ot_controller.camera.kernels.junction import (
    SHARE,
    JunctionGround,
    build_junction,
    mean_of,
    touches,
)
from ssp_ot_controller.camera.kernels.palettes import Colour, Palette
from ssp_ot_controller.camera.kernels.shading import noise_at

HALF_WIDTH_M = 80.0
CELL_M = 0.02

# Channels of the surface table; blue, green and red come first in both.
DASHED, GRAIN, PAVING = 3, 4, 5
# Channels of the table that holds at a zebra crossing, where the centre line is interrupted.
ZEBRA, STOP_FORWARD, STOP_BACKWARD = 3, 4, 5
CHANNELS = 6

LINE_WIDTH_M = 0.14
_EDGE_INSET_M = 0.2
_DOUBLE_GAP_M = 0.14
_KERB_FACE_M, _KERB_TOP_M = 0.08, 0.24
_ZEBRA_BAR_M = 0.5
ZEBRA_HALF_LENGTH_M = 2.0
STOP_WIDTH_M = 0.4
STOP_DISTANCE_M = 1.2
DASH_M, DASH_PERIOD_M = 3.0, 9.0
JOINT_M, JOINT_PERIOD_M = 0.03, 0.9


def _paint(
    table: Array, channels: slice | int, start_m: float, end_m: float, value: object
) -> None:
    """Put a value between two lateral positions, in proportion where a cell is cut."""
    low = -HALF_WIDTH_M + CELL_M * np.arange(len(table))
    share = np.clip((np.minimum(end_m, low + CELL_M) - np.maximum(start_m, low)) / CELL_M, 0.0, 1.0)
    if isinstance(channels, slice):
        share = share[:, None]
    table[:, channels] = table[:, channels] * (1.0 - share) + share * np.asarray(value)


def _line(table: Array, channels: slice | int, centre_m: float, value: object) -> None:
    _paint(table, channels, centre_m - LINE_WIDTH_M / 2, centre_m + LINE_WIDTH_M / 2, value)


def _surface(road: Road, palette: Palette) -> Array:
    """Return the ground, sidewalks, carriageway and edge lines; shape (cells, CHANNELS)."""
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
            # The kerb is painted: a dark face towards the road, and its light top.
            for begin, end, light in ((0.0, _KERB_FACE_M, 0.6), (_KERB_FACE_M, _KERB_TOP_M, 1.0)):
                near, far = sorted((edge + outward * begin, edge + outward * end))
                _paint(table, colour, near, far, np.multiply(palette.kerb, light))
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
    """Paint dashes between lanes of one direction, and the centre line between directions."""
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


class Ground(NamedTuple):
    """A road's surface, as the kernels want it: two tables over the lateral position, and numbers.

    Args:
        sums: shape (2, cells + 1, CHANNELS): running sums, along the road and at its crossing.
        strips: shape (2, cells), int16: number of the strip of equal cells that a cell is in.
        values: shape (2, strips, CHANNELS), what the cells of a strip hold.
        zebras_m: middles, right and left borders of zebras, in order, shape (n, 3); those that
            cross the whole road have infinite borders, and stop lines.
        marking: blue, green, red.
        junction: that the road leads through.
    """

    sums: Array
    strips: Array
    values: Array
    zebras_m: Array
    textured: bool
    marking: Colour
    junction: JunctionGround


def build_ground(road: Road, palette: Palette, texture: bool) -> Ground:
    """Return the surface of a road."""
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
    return Ground(
        sums=np.stack([_running_sums(along), _running_sums(crossing)]),
        strips=strips,
        values=values,
        zebras_m=np.array(road.zebras_m, dtype=np.float64).reshape(-1, 3),
        textured=texture,
        marking=palette.marking,
        junction=build_junction(road, palette),
    )


CELLS_PER_M = 1.0 / CELL_M
CROSSING_REACH_M = ZEBRA_HALF_LENGTH_M + STOP_DISTANCE_M + STOP_WIDTH_M


@inlined
def _pattern(x: float, width: float, mark: float, period: float) -> float:
    """Return the mean over [x - width/2, x + width/2] of marks that repeat with a period."""
    a, b = x - width / 2, x + width / 2
    na, nb = math.floor(a / period), math.floor(b / period)
    fa = na * mark + min(a - na * period, mark)
    fb = nb * mark + min(b - nb * period, mark)
    share: float = (fb - fa) / width
    return share


@inlined
def _band(x: float, width: float, start: float, end: float) -> float:
    """Return the mean over [x - width/2, x + width/2] of one mark."""
    overlap = min(end, x + width / 2) - max(start, x - width / 2)
    share: float = max(0.0, overlap) / width
    return share


@inlined
def _mean(
    ground: Ground, table: int, y: float, width: float
) -> tuple[float, float, float, float, float, float]:
    """Return the means of the channels over [y - width/2, y + width/2]."""
    sums, strips, values = ground.sums, ground.strips, ground.values
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
    weights = (
        scale - scale * (a - ia),
        scale * (a - ia),
        scale - scale * (b - ib),
        scale * (b - ib),
    )
    return (
        _rise(sums, table, ia, ib, weights, 0),
        _rise(sums, table, ia, ib, weights, 1),
        _rise(sums, table, ia, ib, weights, 2),
        _rise(sums, table, ia, ib, weights, 3),
        _rise(sums, table, ia, ib, weights, 4),
        _rise(sums, table, ia, ib, weights, 5),
    )


@inlined
def _rise(
    sums: Array, table: int, ia: int, ib: int, weights: tuple[float, ...], channel: int
) -> float:
    """Return a weighted running sum between cells ib and ib + 1 less that between ia and ia + 1."""
    ga, fa, gb, fb = weights
    high = gb * sums[table, ib, channel] + fb * sums[table, ib + 1, channel]
    low = ga * sums[table, ia, channel] + fa * sums[table, ia + 1, channel]
    rise: float = high - low
    return rise


@inlined
def _nearest_zebra(ground: Ground, x: float) -> int:
    """Return the zebra nearest to a place along the road, -1 where the road has none."""
    zebras = ground.zebras_m
    nearest = -1
    for i in range(zebras.shape[0]):
        if i == 0 or abs(zebras[i, 0] - x) < abs(zebras[nearest, 0] - x):
            nearest = i
    return nearest


@inlined
def _colour(
    ground: Ground, x: float, y: float, wx: float, wy: float, grain: float
) -> tuple[float, float, float]:
    """Return the colour of the ground (blue, green, red), averaged over a footprint.

    Args:
        ground: of the road.
        x: place along the road, m.
        y: place across the road, m, + is left.
        wx: extent of the footprint along the road, m.
        wy: extent of the footprint across the road, m.
        grain: texture, in shares of its strength.
    """
    blue, green, red, mark, strength, paving = _mean(ground, 0, y, wy)
    if mark > 0.0:
        mark *= _pattern(x, wx, DASH_M, DASH_PERIOD_M)
    nearest = _nearest_zebra(ground, x)
    crossing = ground.zebras_m[nearest, 0] if nearest >= 0 else math.nan
    half = ZEBRA_HALF_LENGTH_M
    if abs(x - crossing) < CROSSING_REACH_M + wx / 2:  # false without a crossing: NaN
        b, g, r, bars, forward, backward = _mean(ground, 1, y, wy)
        zone = _band(x, wx, crossing - half - 0.2, crossing + half + 0.2)
        if ground.zebras_m[nearest, 2] < math.inf:
            share = _band(y, wy, ground.zebras_m[nearest, 1], ground.zebras_m[nearest, 2])
            zone *= share
            bars *= share
            forward = backward = 0.0
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
    if touches(ground.junction, x, y, wx, wy):
        rest = 1.0 - mean_of(ground.junction, x, y, wx, wy, SHARE)
        if mark > 0.0:
            blue += mark * (ground.marking[0] - blue)
            green += mark * (ground.marking[1] - green)
            red += mark * (ground.marking[2] - red)
            mark = 0.0
        blue = rest * blue + mean_of(ground.junction, x, y, wx, wy, 0)
        green = rest * green + mean_of(ground.junction, x, y, wx, wy, 1)
        red = rest * red + mean_of(ground.junction, x, y, wx, wy, 2)
        strength = rest * strength + mean_of(ground.junction, x, y, wx, wy, GRAIN)
        paving = rest * paving + mean_of(ground.junction, x, y, wx, wy, PAVING)
    if mark > 0.0:
        blue += mark * (ground.marking[0] - blue)
        green += mark * (ground.marking[1] - green)
        red += mark * (ground.marking[2] - red)
    if paving > 0.0:
        shade = 1.0 - 0.22 * paving * _pattern(x, wx, JOINT_M, JOINT_PERIOD_M)
        blue, green, red = shade * blue, shade * green, shade * red
    grain *= strength
    return blue + grain, green + grain, red + grain


BLOCK = 8  # pixels between which patches are linear: they are wider than that
FINE_M = 0.12  # footprint from which on fine grain isn't resolved


@inlined
def _patches(noise: Array, x_m: float, y_m: float, footprint_m: float) -> float:
    """Return the light of patches; each scale fades before a pixel can no longer resolve it."""
    middle = 1.0 - footprint_m / 1.5
    coarse = 1.0 - footprint_m / 12.0
    patch = 0.0
    if coarse > 0.0:
        patch += 0.8 * coarse * noise_at(noise, 0.45 * x_m, 1.1 * y_m)
    if middle > 0.0:
        patch += 0.9 * middle * noise_at(noise, 4.0 * x_m + 31.0, 4.0 * y_m)
    return patch


@inlined
def _plain_strip(ground: Ground, x: float, y: float, wx: float, wy: float) -> int:
    """Return a number for the ground around a footprint of one colour but for grain, else -1.

    Footprints with the same number have the same colour, and so has the ground between them.
    """
    if touches(ground.junction, x, y, wx, wy):
        return -1
    strips, values = ground.strips, ground.values
    last = strips.shape[1] - 1
    low = (y - wy / 2 + HALF_WIDTH_M) * CELLS_PER_M
    high = (y + wy / 2 + HALF_WIDTH_M) * CELLS_PER_M
    strip = strips[0, int(min(max(low, 0.0), float(last)))]
    if strip != strips[0, int(min(max(high, 0.0), float(last)))]:
        return -1
    if values[0, strip, DASHED] > 0.0 or values[0, strip, PAVING] > 0.0:
        return -1
    zebras = ground.zebras_m
    behind = 0
    for i in range(zebras.shape[0]):
        if abs(x - zebras[i, 0]) < CROSSING_REACH_M + wx / 2:
            return -1
        behind += int(x > zebras[i, 0])
    number: int = (zebras.shape[0] + 1) * int(strip) + behind
    return number


@inlined
def _fill_plain(
    values: Array,
    strip: int,
    noise: Array,
    place: tuple[float, ...],
    step: tuple[float, ...],
    row: Array,
) -> None:
    """Fill the pixels of one strip with its colour and grain; shares change by steps along the row.

    Place and step are those of x, y, patch and fine grain.
    """
    x, y, patch, fine = place
    x_step, y_step, patch_step, fine_step = step
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
def _straight_place(
    depth: float, growth: float, position: Array, rays: Array, dx: float, dy: float
) -> tuple[float, float, float, float]:
    """Find where a ray meets a straight road, along and across it, and a pixel's extents there.

    Args:
        depth: at which it meets the ground.
        growth: of the depth per row of the image, over the depth.
        position: of the camera, block frame, m.
        rays: direction at pixel (0, 0), its change per column and per row.
        dx: way of the ray along the road, over the depth.
        dy: way of the ray across the road, over the depth.
    """
    wx = max(depth * (abs(rays[1, 0]) + abs(growth * dx + rays[2, 0])), CELL_M)
    wy = max(depth * (abs(rays[1, 1]) + 0.5 * abs(growth * dy + rays[2, 1])), CELL_M)
    return position[0] + depth * dx, position[1] + depth * dy, wx, wy


@inlined
def _bent_place(
    bend: Bend, depth: float, growth: float, position: Array, rays: Array, dx: float, dy: float
) -> tuple[float, float, float, float]:
    """Find the same as ``_straight_place`` for a road that bends."""
    s, offset, c, w, stretch = locate(bend, position[0] + depth * dx, position[1] + depth * dy)
    ax, ay = depth * rays[1, 0], depth * rays[1, 1]
    bx, by = depth * (growth * dx + rays[2, 0]), depth * (growth * dy + rays[2, 1])
    along = (abs(c * ax + w * ay) + abs(c * bx + w * by)) / stretch
    across = abs(c * ay - w * ax) + 0.5 * abs(c * by - w * bx)
    return s, offset, max(along, CELL_M), max(across, CELL_M)


@inlined
def ground_row(
    ground: Ground,
    bend: Bend | None,
    noise: Array,
    position: Array,
    rays: Array,
    start: Array,
    hidden: Array,
    row: Array,
) -> None:
    """Write the colours of one image row below the horizon, without light and fog.

    Most of the ground has one colour but for its grain: where both ends of a block of pixels lie
    in one strip, so does all between them.

    Args:
        ground: of the road.
        bend: of the road; None: it is straight, which is compiled by itself.
        noise: tileable noise.
        position: camera centre, block frame.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        start: ray direction at column 0; its z is negative.
        hidden: shape (width,); pixels where it is true may be left out.
        row: shape (3 width,), blue, green, red in turn; filled.
    """
    depth, growth = -position[2] / start[2], -rays[2, 2] / start[2]
    width = hidden.shape[0]
    patch_end, fine_end, code_end, s_end, side_end = 0.0, 0.0, -1, 0.0, 0.0
    for first in range(-BLOCK, width, BLOCK):
        patch, fine, code, s, side = patch_end, fine_end, code_end, s_end, side_end
        dx, dy = start[0] + (first + BLOCK) * rays[1, 0], start[1] + (first + BLOCK) * rays[1, 1]
        if bend is None:
            s_end, side_end, ws, wl = _straight_place(depth, growth, position, rays, dx, dy)
        else:
            s_end, side_end, ws, wl = _bent_place(bend, depth, growth, position, rays, dx, dy)
        if ground.textured:
            patch_end = _patches(noise, s_end, side_end, max(ws, wl))
            fine_end = 1.0 - max(ws, wl) / FINE_M
        code_end = _plain_strip(ground, s_end, side_end, ws, wl)
        if code >= 0 and code == code_end and first + BLOCK <= width:
            s_step, side_step = (s_end - s) / BLOCK, (side_end - side) / BLOCK
            if bend is None:
                s_step, side_step = depth * rays[1, 0], depth * rays[1, 1]
                s, side = s_end - BLOCK * s_step, side_end - BLOCK * side_step
            place = (s, side, patch, fine)
            step = (s_step, side_step, (patch_end - patch) / BLOCK, (fine_end - fine) / BLOCK)
            part = row[3 * first : 3 * (first + BLOCK)]
            strip = code // (ground.zebras_m.shape[0] + 1)
            _fill_plain(ground.values, strip, noise, place, step, part)
            continue
        for u in range(max(first, 0), min(first + BLOCK, width)):
            if hidden[u]:
                continue
            dx, dy = start[0] + u * rays[1, 0], start[1] + u * rays[1, 1]
            if bend is None:
                s, side, ws, wl = _straight_place(depth, growth, position, rays, dx, dy)
            else:
                s, side, ws, wl = _bent_place(bend, depth, growth, position, rays, dx, dy)
            grain = 0.0
            if ground.textured:
                grain = patch + (u - first) / BLOCK * (patch_end - patch)
                near = 1.0 - max(ws, wl) / FINE_M
                if near > 0.0:
                    grain += 1.3 * near * noise_at(noise, 60.0 * s, 60.0 * side)
            row[3 * u], row[3 * u + 1], row[3 * u + 2] = _colour(ground, s, side, ws, wl, grain)
