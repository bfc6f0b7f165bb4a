"""A bent reference line as tables, and the kernel that finds arc length and offset of a place.

Pictures are drawn in the block's Cartesian frame; what lies on the ground is a function of arc
length and offset. The line is kept as nodes a quarter of a metre apart, each with the circle that
touches there, and a grid of cells over the plane says which node is nearest. From that node the
foot of a place is found on the circle, which is exact on arcs and to a tenth of a millimetre on the
clothoids of roads. A straight road needs none of this and has no tables.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import Road
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.camera.kernels.jit import Array, compiled, inlined

_NODE_STEP_M = 0.25
_CELL_M = 2.0
_MOST_CELLS = 250_000
_MARGIN_M = 100.0  # of the nodes beyond the line's ends, and of the grid around them
# Where the map along the line shrinks to less than this there is nothing of the road any more.
_LEAST_STRETCH = 0.05
_STEPS = 6
_NEAREST = 0.501  # of the distance between nodes

N_X, N_Y, N_COS, N_SIN, N_CURVATURE = range(5)


class Bend(NamedTuple):
    """The line of a road that bends, in the block's frame.

    Args:
        nodes: shape (n, 5): x, y, cosine and sine of the heading, curvature; the first and the last
            100 m lie on the straight extensions.
        cells: shape (rows, columns), int32: the node that is nearest to a cell's middle.
        x_m: of the grid's corner.
        y_m: of the grid's corner.
        cells_per_m: of the grid.
        start_m: arc length of the first node.
        step_m: arc length between nodes.
    """

    nodes: Array
    cells: Array
    x_m: float
    y_m: float
    cells_per_m: float
    start_m: float
    step_m: float


def build_bend(road: Road) -> Bend | None:
    """Return the tables of a road's line; None for a straight road."""
    line = block_line(road)
    if line.is_straight:
        return None
    count = math.ceil(line.length_m / _NODE_STEP_M)
    step = line.length_m / count
    # At both ends the line goes on straight.
    beyond = math.ceil(_MARGIN_M / step)
    stations = step * np.arange(-beyond, count + beyond + 1)
    nodes = np.empty((len(stations), 5))
    for node, s in zip(nodes, stations.tolist(), strict=True):
        pose = line.pose(s)
        node[:4] = pose.x_m, pose.y_m, math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        node[N_CURVATURE] = line.curvature_1pm(s)
    # Half a second to import, which a straight road needs not.
    from scipy.spatial import cKDTree  # type: ignore[import-untyped] # has no types

    low = nodes[:, :2].min(axis=0) - _MARGIN_M
    size = nodes[:, :2].max(axis=0) + _MARGIN_M - low
    cell = max(_CELL_M, math.sqrt(float(size[0] * size[1]) / _MOST_CELLS))
    columns, rows = np.ceil(size / cell).astype(int)
    row, column = np.mgrid[0:rows, 0:columns]
    middles = low + cell * (np.stack([column, row], axis=2) + 0.5)
    _, nearest = cKDTree(nodes[:, :2]).query(middles)
    return Bend(
        nodes,
        nearest.astype(np.int32),
        float(low[0]),
        float(low[1]),
        1.0 / cell,
        float(stations[0]),
        step,
    )


def block_line(road: Road) -> ReferenceLine:
    """Return the road's line in the block's frame: its start is the origin."""
    line = ReferenceLine.of_road(road)
    return ReferenceLine(Pose2(0.0, 0.0, 0.0), line.pieces)


@inlined
def _seed(bend: Bend, x: float, y: float) -> int:
    """Return a node near the foot of a place."""
    nodes, cells = bend.nodes, bend.cells
    column = (x - bend.x_m) * bend.cells_per_m
    row = (y - bend.y_m) * bend.cells_per_m
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
def locate(bend: Bend, x: float, y: float) -> tuple[float, float, float, float, float]:
    """Return arc length, offset, cosine and sine of the line's heading, stretch of the map there.

    With curvature k and the place a to the left of a node and b ahead of it, the touching circle
    gives r^2 = (1 - k a)^2 + (k b)^2, l = (1 - r) / k and s = atan2(k b, 1 - k a) / k, here in a
    form that holds for k = 0. The stretch is r. Beyond the centre of curvature nothing of the road
    lies, and the offset is a.
    """
    nodes, step = bend.nodes, bend.step_m
    last = nodes.shape[0] - 1
    i = _seed(bend, x, y)
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
    s = bend.start_m + i * step
    if q < _LEAST_STRETCH:
        return s, a, c, w, _LEAST_STRETCH
    turn = k * u
    r = q * math.sqrt(1.0 + turn * turn)
    return s + u * (1.0 - turn * turn / 3.0), (2.0 * a - k * (a * a + b * b)) / (1.0 + r), c, w, r


@compiled
def locate_all(bend: Bend, xy: Array, out: Array) -> None:
    """Write arc length and offset of places into ``out``, shape (n, 2) both."""
    for n in range(xy.shape[0]):
        s, offset, _, _, _ = locate(bend, xy[n, 0], xy[n, 1])
        out[n, 0], out[n, 1] = s, offset


def offsets_of(bend: Bend | None, xy_m: Array) -> Array:
    """Return offsets to the left of the line, shape (n,), of places, shape (n, 2).

    The places are in the block's frame.
    """
    places = np.asarray(xy_m, dtype=np.float64).reshape(-1, 2)
    if bend is None:
        return np.asarray(places[:, 1])
    out = np.empty_like(places)
    locate_all(bend, places, out)
    return np.asarray(out[:, 1])
