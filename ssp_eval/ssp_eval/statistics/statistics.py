"""All statistics of a set of cells: from rows alone, and from records where there are any."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ssp_core.vocabulary import LAT_ACTIONS
from ssp_eval.data.ego_path import NS, SAME_S, Pose, pose_at, recorded_paths
from ssp_eval.evaluate.results import CellData
from ssp_eval.score.aggregate import BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL
from ssp_eval.score.columns import encode
from ssp_eval.score.engine import cell_terms
from ssp_eval.score.motion import Motion, lat_action, step_of
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.bootstrap import (
    RESAMPLES,
    SEED,
    Bootstrap,
    Estimate,
    Group,
    bootstrap_mean,
    bootstrap_records,
)
from ssp_eval.statistics.comparisons import Comparison, compare
from ssp_eval.statistics.resampling import NO_INTERVAL
from ssp_eval.statistics.rows import OK, CellRow, entering, one_scale, over_what
from ssp_eval.statistics.sensitivity import (
    GRID,
    Stability,
    Variation,
    WeightSamples,
    sample_weights,
    stability,
    vary_thresholds,
    vary_weights,
)

HORIZON_S = DEFAULT.support_end_s
BACK_S = 1.0


@dataclass(frozen=True)
class Curve:
    """The diagnostic at one label; None where the path isn't known about it.

    Args:
        label_t_s: clip time, s.
        shift_m: Δl of the recorded path, m, left positive.
        curve_m: Δl_κ, what of it follows from the curve, m.
        curvature_per_m: κ, 1/m, left positive.
        reads_as: the lateral action that METHOD 6.6 reads in Δl_κ alone.
    """

    label_t_s: float
    shift_m: float | None = None
    curve_m: float | None = None
    curvature_per_m: float | None = None
    reads_as: str | None = None


def curves(requests: Sequence[Mapping[str, Any]]) -> list[Curve]:
    """The diagnostic at each label time of a cell.

    Args:
        requests: lines of requests.jsonl in time order. Each one that was asked has the VUT's
            path before it; they are laid end to end by the time that two of them share.
    """
    paths = recorded_paths(requests)
    found = []
    for request in requests:
        label_t_s, stamp_ns = float(request["label_t_s"]), request.get("stamp_ns")
        curve = Curve(label_t_s)
        if stamp_ns is not None:
            t_s = stamp_ns * NS
            path = next((path for path in paths if path[-1].t_s >= t_s - SAME_S), [])
            curve = curve_at(path, t_s, label_t_s)
        found.append(curve)
    return found


def curve_at(path: Sequence[Pose], t_s: float, label_t_s: float) -> Curve:
    """The diagnostic at one time of a path.

    Args:
        path: in time order.
        t_s: in the path's time.
        label_t_s: what to call it.
    """
    start, now, end = (pose_at(path, t_s + d) for d in (-BACK_S, 0.0, HORIZON_S))
    if now is None or end is None:
        return Curve(label_t_s)
    dx, dy = end.x_m - now.x_m, end.y_m - now.y_m
    shift_m = dy * math.cos(now.yaw_rad) - dx * math.sin(now.yaw_rad)
    if start is None:
        return Curve(label_t_s, shift_m)
    ahead = _between(path, now, end)
    whole = [*_between(path, start, now), *ahead[1:]]
    turned = math.fsum(math.remainder(b.yaw_rad - a.yaw_rad, math.tau) for a, b in pairwise(whole))
    length_m, distance_m = _length_m(whole), _length_m(ahead)
    curvature_per_m = turned / length_m if length_m > 0 else 0.0
    curve_m = arc_shift_m(curvature_per_m, distance_m)
    still = np.zeros(1)
    aside = (still, still + curve_m / 2, still + curve_m)
    motion = Motion((still, still, still), aside, step_of(DEFAULT))
    word = LAT_ACTIONS[int(lat_action(motion)[0])]
    return Curve(label_t_s, shift_m, curve_m, curvature_per_m, word)


def _between(path: Sequence[Pose], first: Pose, last: Pose) -> list[Pose]:
    inside = (p for p in path if first.t_s + SAME_S < p.t_s < last.t_s - SAME_S)
    return [first, *inside, last]


def _length_m(path: Sequence[Pose]) -> float:
    return math.fsum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(path))


def arc_shift_m(curvature_per_m: float, distance_m: float) -> float:
    """(1 − cos(κ d)) / κ, how far an arc leads to the left after a distance, m; 0 for κ = 0."""
    half = curvature_per_m * distance_m / 2
    # 1 − cos 2h = 2 sin² h, which loses no digits near 0.
    return 0.0 if half == 0 else distance_m * math.sin(half) ** 2 / half


SUBJECTS = ("model", "domain")
GROUPINGS = (BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL)


@dataclass(frozen=True)
class Options:
    """What random numbers depend on.

    Args:
        resamples: of every bootstrap, and sets of weights.
        block: labels that are drawn together; None: ssp_eval.statistics.resampling.block_of.
    """

    resamples: int = RESAMPLES
    seed: int = SEED
    block: int | None = None


@dataclass(frozen=True)
class Beside:
    """The curvature diagnostic at a label, beside the lateral action.

    Args:
        planned: what METHOD 6.6 reads in the model's trajectory, None without a valid one.
    """

    curve: Curve
    allowed: tuple[str, ...]
    planned: str | None


@dataclass(frozen=True)
class Statistics:
    """What ``statistics.json`` holds.

    Args:
        records: intervals over records; None where only component scores are known.
        over_cells: mean IVCS by grouping and group, its interval over the cells, and over their
            scenarios where these differ from cells.
        comparisons: of domains, then of models.
        weights: ranks under random weights, per subject that has at least two names.
        variations: one number changed at a time; thresholds only where records are known.
        runs: how repetitions differ; None without any.
        curves: per cell and run the curvature diagnostic beside the lateral action.
    """

    records: Bootstrap | None
    over_cells: dict[Group, dict[Group, tuple[Estimate, ...]]]
    comparisons: tuple[Comparison, ...]
    weights: tuple[WeightSamples, ...]
    variations: tuple[Variation, ...]
    runs: Stability | None
    curves: dict[tuple[str, ...], tuple[Beside, ...]]


def steps_of(rows: Sequence[CellRow], has_records: bool) -> int:
    """How often compute calls on_step."""
    valid = [row for row in one_scale(rows) if row.status == OK and not row.control]
    from_records = len(valid) + sum(map(len, GRID.values())) if has_records and valid else 0
    return from_records + len(SUBJECTS)


def compute(
    rows: Sequence[CellRow],
    data: Sequence[CellData] = (),
    options: Options = Options(),
    on_step: Callable[[], None] = lambda: None,
) -> Statistics:
    """Everything that the cells allow.

    Args:
        data: the cells themselves in the order of the rows, none where they aren't known.
    """
    chosen = entering(rows)
    over = over_what(rows)
    alike = one_scale(rows)
    kept = {id(row) for row in alike if row.status == OK and not row.control}
    pairs = [(row, cell) for row, cell in zip(rows, data, strict=bool(data)) if id(row) in kept]
    comparisons: list[Comparison] = []
    weights: list[WeightSamples] = []
    variations: list[Variation] = []
    for subject in SUBJECTS:
        on_step()
        if subject in over:
            continue
        comparisons += compare(chosen, subject, options.seed)
        sampled = sample_weights(chosen, subject, options.seed, options.resamples)
        if sampled is not None:
            weights.append(sampled)
            variations += vary_weights(chosen, subject)
    records = None
    if pairs:
        with_terms = [
            (row, cell_terms(cell.labels, cell.records, cell.thresholds))
            for row, cell in pairs
            if cell.score
        ]
        thresholds = pairs[0][1].thresholds
        records = bootstrap_records(
            with_terms, GROUPINGS, options.resamples, options.seed, on_step, options.block,
            thresholds,
        )  # fmt: skip
        comparisons = [
            replace(
                one,
                over_labels=records.differences.get(
                    ((one.first, one.second), one.metric), NO_INTERVAL
                ),
            )
            if one.subject == "model"
            else one
            for one in comparisons
        ]
        first = _first_runs(pairs)
        columns = encode([(cell.labels, cell.records) for _, cell in first])
        variations += vary_thresholds(
            [row for row, _ in first], columns, SUBJECTS, on_step, thresholds
        )
    return Statistics(
        records,
        {by: _over_cells(chosen, by, options) for by in GROUPINGS if over.isdisjoint(by)},
        tuple(comparisons),
        tuple(weights),
        tuple(variations),
        stability(alike, options.resamples, options.seed),
        _curves(pairs),
    )


def _first_runs(pairs: Sequence[tuple[CellRow, CellData]]) -> list[tuple[CellRow, CellData]]:
    """One run of each cell, the first by name."""
    found: dict[tuple[str, str, str], tuple[CellRow, CellData]] = {}
    for row, cell in sorted(pairs, key=lambda one: (*one[0].key, one[0].run)):
        found.setdefault(row.key, (row, cell))
    return list(found.values())


def _over_cells(
    rows: Sequence[CellRow], by: Group, options: Options
) -> dict[Group, tuple[Estimate, ...]]:
    cells: dict[Group, dict[str, list[float]]] = {}
    scenarios: dict[Group, dict[str, list[float]]] = {}
    for row in rows:
        if row.ivcs is not None and (row.admitted or "domain" not in by):
            key = tuple(getattr(row, name) for name in by)
            cells.setdefault(key, {})["\0".join(row.key)] = [row.ivcs]
            scenarios.setdefault(key, {}).setdefault(row.scenario, []).append(row.ivcs)
    found = {}
    for key in sorted(cells):
        units = [(cells[key], "cells")]
        if 1 < len(scenarios[key]) < len(cells[key]):
            units.append((scenarios[key], "scenarios"))
        found[key] = tuple(
            bootstrap_mean(values, unit, options.resamples, options.seed, unit, *by, *key)
            for values, unit in units
        )
    return found


def _curves(pairs: Sequence[tuple[CellRow, CellData]]) -> dict[tuple[str, ...], tuple[Beside, ...]]:
    """Of each cell, by the time of the label."""
    found: dict[tuple[str, ...], tuple[Beside, ...]] = {}
    for row, cell in pairs:
        if cell.score is None:
            continue
        by_time = {curve.label_t_s: curve for curve in curves(cell.requests)}
        found[(*row.key, row.run)] = tuple(
            Beside(
                by_time.get(label.t_s, Curve(label.t_s)), label.lat_actions, judged.trajectory_lat
            )
            for label, judged in zip(cell.labels.labels, cell.score.details.judgements, strict=True)
        )
    return found
