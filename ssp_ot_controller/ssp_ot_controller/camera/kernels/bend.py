"""A bent reference line as tables, and the kernel that finds arc length and offset of a place.

Pictures are drawn in the block's Cartesian frame; what lies on the ground is a function of arc
length and offset. The line is kept as nodes a quarter of a metre apart, each with the circle that
touches there, and a grid of cells over the plane says which node is nearest. From that node the
foot of a place is found on the circle, which is exact on arcs and to a tenth of a millimetre on the
clothoids of roads. A straight road needs none of this and has empty tables.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import Road
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.camera.kernels import ground
from ssp_ot_controller.camera.kernels.ground import (
    BLOCK,
    FINE_M,
    KERB_FACE,
    fill_plain,
    ground_colour,
    meets,
    patches,
    plain_strip,
)
from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined
from ssp_ot_controller.camera.kernels.shading import noise_at

_NODE_STEP_M = 0.25
_CELL_M = 2.0
_MOST_CELLS = 250_000
_MARGIN_M = 100.0  # of the grid around the line
_SEED_STRIDE = 8  # of the nodes that cells are compared with
# Where the map along the line shrinks to less than this there is nothing of the road any more.
_LEAST_STRETCH = 0.05
_STEPS = 6
_NEAREST = 0.501  # of the distance between nodes

N_X, N_Y, N_COS, N_SIN, N_CURVATURE = range(5)
B_X, B_Y, B_PER_CELL, B_START, B_STEP = range(5)


@dataclass(frozen=True)
class Bend:
    """The line of a road in the block's frame.

    Args:
        nodes: shape (n, 5): x, y, cosine and sine of the heading, curvature; the first and the last
            lie on the straight extensions. None (n = 0) for a straight road.
        cells: shape (rows, columns), int32: the node that is nearest to a cell's middle.
        numbers: x and y of the grid's corner, cells per metre, arc length of the first node, and
            between nodes.
    """

    nodes: Array
    cells: Array
    numbers: Array

    @property
    def is_straight(self) -> bool:
        return len(self.nodes) == 0


@compiled
def _fill(nodes: Array, stride: int, numbers: Array, cells: Array) -> None:
    """Finds each cell's node; the line goes on straight from its first and last."""
    last = nodes.shape[0] - 1
    for row in range(cells.shape[0]):
        y = numbers[B_Y] + (row + 0.5) / numbers[B_PER_CELL]
        for column in range(cells.shape[1]):
            x = numbers[B_X] + (column + 0.5) / numbers[B_PER_CELL]
            best, nearest = 0, math.inf
            for i in range(0, last + stride, stride):
                j = min(i, last)
                dx, dy = x - nodes[j, N_X], y - nodes[j, N_Y]
                away = dx * dx + dy * dy
                if j == 0 or j == last:
                    along = nodes[j, N_COS] * dx + nodes[j, N_SIN] * dy
                    if (along > 0.0) == (j == last):
                        away -= along * along
                if away < nearest:
                    best, nearest = j, away
            cells[row, column] = best


def build_bend(road: Road) -> Bend:
    """The tables of a road's line; empty ones for a straight road."""
    line = block_line(road)
    if line.is_straight:
        return Bend(np.zeros((0, 5)), np.zeros((0, 0), np.int32), np.zeros(5))
    count = math.ceil(line.length_m / _NODE_STEP_M)
    step = line.length_m / count
    stations = step * np.arange(-1, count + 2)
    nodes = np.empty((len(stations), 5))
    for node, s in zip(nodes, stations, strict=True):
        pose = line.pose(float(s))
        node[:4] = pose.x_m, pose.y_m, math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        node[N_CURVATURE] = line.curvature_1pm(float(s))
    low = nodes[:, :2].min(axis=0) - _MARGIN_M
    size = nodes[:, :2].max(axis=0) + _MARGIN_M - low
    cell = max(_CELL_M, math.sqrt(float(size[0] * size[1]) / _MOST_CELLS))
    numbers = np.array([low[0], low[1], 1.0 / cell, -step, step])
    columns, rows = np.ceil(size / cell).astype(int)
    cells = np.empty((rows, columns), np.int32)
    _fill(nodes, _SEED_STRIDE, numbers, cells)
    return Bend(nodes, cells, numbers)


def block_line(road: Road) -> ReferenceLine:
    """The road's line in the block's frame: its start is the origin."""
    line = ReferenceLine.of_road(road)
    return ReferenceLine(Pose2(0.0, 0.0, 0.0), line.pieces)


@inlined
def _seed(nodes: Array, cells: Array, numbers: Array, x: float, y: float) -> int:
    """A node near the foot of a place."""
    column = (x - numbers[B_X]) * numbers[B_PER_CELL]
    row = (y - numbers[B_Y]) * numbers[B_PER_CELL]
    columns, rows = float(cells.shape[1]), float(cells.shape[0])
    if not (0.0 <= column < columns and 0.0 <= row < rows):
        # Out there the road is on its straight extensions, or too far to be seen.
        for j, sign in ((nodes.shape[0] - 1, 1.0), (0, -1.0)):
            dx, dy = x - nodes[j, N_X], y - nodes[j, N_Y]
            along = nodes[j, N_COS] * dx + nodes[j, N_SIN] * dy
            across = nodes[j, N_COS] * dy - nodes[j, N_SIN] * dx
            if sign * along > 0.0 and abs(across) < _MARGIN_M:
                return j
        column = min(max(column, 0.0), columns - 1.0)
        row = min(max(row, 0.0), rows - 1.0)
    return int(cells[int(row), int(column)])


@inlined
def locate(
    nodes: Array, cells: Array, numbers: Array, x: float, y: float
) -> tuple[float, float, float, float, float]:
    """Arc length, offset, cosine and sine of the line's heading, stretch of the map there.

    With curvature k and the place a to the left of a node and b ahead of it, the touching circle
    gives r^2 = (1 - k a)^2 + (k b)^2, l = (1 - r) / k and s = atan2(k b, 1 - k a) / k, here in a
    form that holds for k = 0. The stretch is r. Beyond the centre of curvature nothing of the road
    lies, and the offset is a.
    """
    last = nodes.shape[0] - 1
    i = _seed(nodes, cells, numbers, x, y)
    step = numbers[B_STEP]
    a, b, q, u = 0.0, 0.0, 1.0, 0.0
    for _ in range(_STEPS):
        dx, dy = x - nodes[i, N_X], y - nodes[i, N_Y]
        b = nodes[i, N_COS] * dx + nodes[i, N_SIN] * dy
        a = nodes[i, N_COS] * dy - nodes[i, N_SIN] * dx
        q = 1.0 - nodes[i, N_CURVATURE] * a
        if q < _LEAST_STRETCH:
            break
        u = b / q
        # Half way between two nodes either will do; without the margin it would go to and fro.
        if abs(u) < _NEAREST * step:
            break
        j = min(max(i + math.floor(u / step + 0.5), 0), last)
        if j == i:
            break
        i = j
    c, w, k = nodes[i, N_COS], nodes[i, N_SIN], nodes[i, N_CURVATURE]
    s = numbers[B_START] + i * step
    if q < _LEAST_STRETCH:
        return s, a, c, w, _LEAST_STRETCH
    turn = k * u
    r = q * math.sqrt(1.0 + turn * turn)
    return s + u * (1.0 - turn * turn / 3.0), (2.0 * a - k * (a * a + b * b)) / (1.0 + r), c, w, r


@compiled
def locate_all(nodes: Array, cells: Array, numbers: Array, xy: Array, out: Array) -> None:
    """Arc length and offset of places, shape (n, 2) both."""
    for n in range(xy.shape[0]):
        s, offset, _, _, _ = locate(nodes, cells, numbers, xy[n, 0], xy[n, 1])
        out[n, 0], out[n, 1] = s, offset


def offsets_of(bend: Bend, xy_m: Array) -> Array:
    """Offset to the left of the line, shape (n,), of places in the block's frame, shape (n, 2)."""
    places = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
    if bend.is_straight:
        return np.asarray(places[:, 1])
    out = np.empty_like(places)
    locate_all(bend.nodes, bend.cells, bend.numbers, places, out)
    return np.asarray(out[:, 1])


@inlined
def _footprint(
    c: float, w: float, stretch: float, t: float, dx: float, dy: float, growth: float, rays: Array
) -> tuple[float, float]:
    """Extents along and across the line of a pixel that meets the ground at t times (dx, dy)."""
    ax, ay = t * rays[1, 0], t * rays[1, 1]
    bx, by = t * (growth * dx + rays[2, 0]), t * (growth * dy + rays[2, 1])
    along = (abs(c * ax + w * ay) + abs(c * bx + w * by)) / stretch
    across = abs(c * ay - w * ax) + 0.5 * abs(c * by - w * bx)
    return max(along, ground.CELL_M), max(across, ground.CELL_M)


@inlined
def _meet(
    nodes: Array,
    cells: Array,
    line: Array,
    numbers: Array,
    position: Array,
    road_depth: float,
    raised_depth: float,
    dx: float,
    dy: float,
) -> tuple[int, float, float, float, float, float]:
    """What a ray meets, as ``meets`` says, and the place there, as ``locate`` does."""
    x, y = position[0] + road_depth * dx, position[1] + road_depth * dy
    s, offset, c, w, stretch = locate(nodes, cells, line, x, y)
    # Offsets of two places differ by no more than the places are apart.
    apart = (road_depth - raised_depth) * (abs(dx) + abs(dy))
    left, right = numbers[ground.P_LEFT_EDGE], numbers[ground.P_RIGHT_EDGE]
    if right + apart < offset < left - apart:
        return 0, s, offset, c, w, stretch
    x, y = position[0] + raised_depth * dx, position[1] + raised_depth * dy
    rs, raised, rc, rw, rstretch = locate(nodes, cells, line, x, y)
    plane = meets(raised, offset, numbers)
    if plane == 1:
        return 1, rs, raised, rc, rw, rstretch
    return plane, s, offset, c, w, stretch


@inlined
def bent_row(
    sums: Array,
    strips: Array,
    values: Array,
    numbers: Array,
    nodes: Array,
    cells: Array,
    line: Array,
    noise: Array,
    position: Array,
    start: Array,
    rays: Array,
    hidden: Array,
    row: Array,
) -> None:
    """Colours of one image row below the horizon, without light and fog.

    Args:
        sums, strips, values: see ground.Tables.
        numbers: vector of ground.build_parameters.
        nodes, cells, line: see bend.Bend.
        noise: tileable noise.
        position: camera centre, block frame.
        start: ray direction at column 0; its z is negative.
        rays: shape (3, 3): direction at pixel (0, 0), and its change per column and per row.
        hidden: shape (width,); pixels where it is true may be left out.
        row: shape (3 width,), blue, green, red in turn; filled.
    """
    textured = numbers[ground.P_TEXTURE] > 0.0
    crossing = numbers[ground.P_CROSSING_X]
    road_depth = -position[2] / start[2]
    raised_depth = (ground.KERB_HEIGHT_M - position[2]) / start[2]
    growth = -rays[2, 2] / start[2]  # of the depth per row, over the depth
    width = hidden.shape[0]
    patch_end, fine_end, code_end, s_end, l_end = 0.0, 0.0, -1, 0.0, 0.0
    for first in range(-BLOCK, width, BLOCK):
        patch, fine, code, s_begin, l_begin = patch_end, fine_end, code_end, s_end, l_end
        dx, dy = start[0] + (first + BLOCK) * rays[1, 0], start[1] + (first + BLOCK) * rays[1, 1]
        plane, s_end, l_end, c, w, stretch = _meet(
            nodes, cells, line, numbers, position, road_depth, raised_depth, dx, dy
        )
        t = raised_depth if plane == 1 else road_depth
        ws, wl = _footprint(c, w, stretch, t, dx, dy, growth, rays)
        if textured:
            patch_end = patches(noise, s_end, l_end, max(ws, wl))
            fine_end = 1.0 - max(ws, wl) / FINE_M
        code_end = -1
        if plane != 2:
            code_end = plain_strip(strips, values, crossing, s_end, l_end, ws, wl)
            if code_end >= 0:
                code_end = 2 * code_end + plane
        if code >= 0 and code == code_end and first + BLOCK <= width:
            fill_plain(
                values, code >> 2, noise, s_begin, (s_end - s_begin) / BLOCK, l_begin,
                (l_end - l_begin) / BLOCK, patch, (patch_end - patch) / BLOCK, fine,
                (fine_end - fine) / BLOCK, row[3 * first : 3 * (first + BLOCK)],
            )  # fmt: skip
            continue
        for u in range(max(first, 0), min(first + BLOCK, width)):
            if hidden[u]:
                continue
            dx, dy = start[0] + u * rays[1, 0], start[1] + u * rays[1, 1]
            plane, s, offset, c, w, stretch = _meet(
                nodes, cells, line, numbers, position, road_depth, raised_depth, dx, dy
            )
            if plane == 2:
                for k in range(3):
                    row[3 * u + k] = KERB_FACE * numbers[ground.P_KERB_B + k]
                continue
            t = raised_depth if plane == 1 else road_depth
            ws, wl = _footprint(c, w, stretch, t, dx, dy, growth, rays)
            grain = 0.0
            if textured:
                grain = patch + (u - first) / BLOCK * (patch_end - patch)
                near = 1.0 - max(ws, wl) / FINE_M
                if near > 0.0:
                    grain += 1.3 * near * noise_at(noise, 60.0 * s, 60.0 * offset)
            blue, green, red = ground_colour(
                sums, strips, values, numbers, s, offset, ws, wl, grain
            )
            row[3 * u], row[3 * u + 1], row[3 * u + 2] = blue, green, red
