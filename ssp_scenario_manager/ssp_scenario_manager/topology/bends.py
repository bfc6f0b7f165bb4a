"""How much a reference line bends, seen over the length of a car or two."""

from __future__ import annotations

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.topology.block import Segment

# A bend with a radius of more than 1000 m is driven, and seen, as a straight.
STRAIGHT_BELOW_1PM = 0.001
# Curvature is averaged over this: real maps have corrections of a few centimetres in their lines.
WINDOW_M = 10.0
# Straight parts of longer, bent blocks are blocks of their own from this length on.
SHORTEST_STRAIGHT_M = 50.0
_STEP_M = 1.0


def headings(line: ReferenceLine, s_m: FloatArray) -> FloatArray:
    """Heading at arc lengths, relative to the line's start, unwrapped; constant beyond the ends."""
    lengths = np.array([p.length_m for p in line.pieces])
    starts = np.array([p.start_curvature_1pm for p in line.pieces])
    ends = np.array([p.end_curvature_1pm for p in line.pieces])
    begins = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
    before = np.concatenate(([0.0], np.cumsum(0.5 * lengths * (starts + ends))))
    index = np.clip(np.searchsorted(begins, s_m, side="right") - 1, 0, len(lengths) - 1)
    u = np.clip(s_m - begins[index], 0.0, lengths[index])
    rate = (ends - starts)[index] / lengths[index]
    turned: FloatArray = before[index] + u * (starts[index] + 0.5 * rate * u)
    return turned


def _mean_curvatures(line: ReferenceLine) -> tuple[FloatArray, FloatArray]:
    """Arc lengths, and the mean curvature over the window around each, 1/m."""
    length = line.length_m
    s = np.linspace(0.0, length, max(2, int(np.ceil(length / _STEP_M)) + 1))
    low = np.clip(s - WINDOW_M / 2, 0.0, max(0.0, length - WINDOW_M))
    high = np.minimum(low + WINDOW_M, length)
    return s, np.abs(headings(line, high) - headings(line, low)) / WINDOW_M


def bend_1pm(line: ReferenceLine) -> float:
    """Largest mean curvature over any 10 m of a line, 1/m."""
    if line.is_straight:
        return 0.0
    return float(_mean_curvatures(line)[1].max())


def segment_of(line: ReferenceLine) -> Segment:
    """``straight`` where the radius over any 10 m is more than 1000 m, else ``curve``."""
    return "straight" if bend_1pm(line) < STRAIGHT_BELOW_1PM else "curve"


def straight_parts(line: ReferenceLine) -> list[tuple[float, float]]:
    """Straight stretches of at least 50 m of a line that bends elsewhere, as arc lengths."""
    s, curvature = _mean_curvatures(line)
    flat = np.concatenate(([False], curvature < STRAIGHT_BELOW_1PM, [False]))
    starts = np.flatnonzero(flat[1:] & ~flat[:-1])
    ends = np.flatnonzero(~flat[1:] & flat[:-1]) - 1
    return [
        (float(s[a]), float(s[b]))
        for a, b in zip(starts, ends, strict=True)
        if s[b] - s[a] >= SHORTEST_STRAIGHT_M
    ]
