"""Where the ways through one junction meet or cross: its conflict areas (METHOD 2.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.topology.block import BlockLane, ConflictArea

_SAMPLES = 24
_GAP = 2
# More ways than this through one junction are no junction of a road network.
MOST_WAYS = 200


@dataclass(frozen=True)
class JunctionPath:
    """A block through a junction: its forward lanes, and which blocks it comes from and goes to."""

    block_id: str
    junction: str
    line: ReferenceLine
    lanes: tuple[BlockLane, ...]
    entrances: tuple[str, ...]
    exits: tuple[str, ...]

    @property
    def half_width_m(self) -> float:
        left = max(lane.y_m + lane.width_m / 2 for lane in self.lanes)
        return 0.5 * (left - min(lane.y_m - lane.width_m / 2 for lane in self.lanes))

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Arc lengths and places along the middle of its forward lanes."""
        s = np.linspace(0.0, self.line.length_m, _SAMPLES)
        middle = sum(lane.y_m for lane in self.lanes) / len(self.lanes)
        return s, self.line.to_map_many(s, middle)


def _stretches(s: FloatArray, hit: FloatArray) -> list[tuple[float, float]]:
    """Runs of samples that are hit, over gaps of up to two, each widened by half a step."""
    if not hit.any():
        return []
    half = 0.5 * float(s[1] - s[0])
    at = np.flatnonzero(hit)
    for a, b in pairwise(at):
        if b - a <= _GAP + 1:
            hit[a:b] = True
    padded = np.concatenate(([False], hit, [False]))
    starts = np.flatnonzero(padded[1:] & ~padded[:-1])
    ends = np.flatnonzero(~padded[1:] & padded[:-1]) - 1
    return [
        (max(0.0, float(s[a]) - half), min(float(s[-1]), float(s[b]) + half))
        for a, b in zip(starts, ends, strict=True)
    ]


def junction_areas(paths: Sequence[JunctionPath]) -> dict[str, tuple[ConflictArea, ...]]:
    """Areas per block of one junction, by kind and place.

    Two ways that come from different blocks conflict where their corridors overlap: as ``merge``
    where both go on to the same block, else as ``crossing``. Ways from the same block only part.

    Args:
        paths: of one junction; none are compared where there are more than 200.
    """
    if len(paths) > MOST_WAYS:
        return {}
    sampled = [path.samples() for path in paths]
    places = np.array([xy for _, xy in sampled]) if paths else np.zeros((0, _SAMPLES, 2))
    x, y = places[..., 0], places[..., 1]
    half = np.array([path.half_width_m for path in paths])
    found: dict[str, tuple[ConflictArea, ...]] = {}
    for i, path in enumerate(paths):
        dx = x[i][None, :, None] - x[:, None, :]
        dy = y[i][None, :, None] - y[:, None, :]
        near = (dx * dx + dy * dy < ((half + half[i]) ** 2)[:, None, None]).any(axis=2)
        hits = {"merge": np.zeros(_SAMPLES, dtype=bool), "crossing": np.zeros(_SAMPLES, dtype=bool)}
        for j in map(int, np.flatnonzero(near.any(axis=1))):
            other = paths[j]
            if j == i or set(path.entrances) & set(other.entrances):
                continue
            hits["merge" if set(path.exits) & set(other.exits) else "crossing"] |= near[j]
        s = sampled[i][0]
        areas = [ConflictArea("merge", a, b) for a, b in _stretches(s, hits["merge"])]
        areas += [ConflictArea("crossing", a, b) for a, b in _stretches(s, hits["crossing"])]
        found[path.block_id] = tuple(sorted(areas, key=lambda area: (area.kind, area.start_s_m)))
    return found
