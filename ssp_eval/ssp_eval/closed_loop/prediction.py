"""Open loop against closed loop: does the score predict the headline (METHOD 8.9)?"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from statistics import fmean

from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop.folder import LoopCampaign
from ssp_eval.score.metrics import COMPONENTS
from ssp_eval.statistics.rows import OK, CellRow
from ssp_eval.statistics.table import Column, Table
from ssp_scenario_manager.closed_loop.campaigns.plan_file import BASELINES

# METHOD 8.9: fewer drivers have no correlation.
LEAST_DRIVERS = 10
IVCS = "ivcs"
_NOBODY = "No model with a score has the name of a driver of this campaign: give one a label."


@dataclass(frozen=True)
class Point:
    """One driver: its open-loop score, and its headline with Wilson's interval."""

    driver: str
    score: float
    headline: float
    low: float
    high: float


@dataclass(frozen=True)
class Prediction:
    """The open-loop scores of the drivers against their headlines on one event at one latency.

    Args:
        rho: Spearman's; None under LEAST_DRIVERS, or where one of the two is the same for all.
        inversions: pairs that the two order differently, where the intervals of their headlines
            don't overlap: the one with the better score first.
    """

    event: str
    latency: Latency
    metric: str
    n: int
    rho: float | None
    inversions: tuple[tuple[str, str], ...]


def scores_by_driver(
    rows: Iterable[CellRow], metric: str, events: Iterable[str]
) -> dict[tuple[str, str], float]:
    """Return the mean score of each (event, model) on recordings of the built-in driver.

    Args:
        rows: cells of `ssp evaluate`, none of a driven recording.
        metric: ``ivcs``, or a component of it.
        events: of the campaign.
    """
    event_names, scores = set(events), dict[tuple[str, str], list[float]]()
    for row in rows:
        value = getattr(row, metric)
        usual = row.status == OK and row.domain == "simulation" and not row.control
        if usual and row.scenario in event_names and value is not None:
            scores.setdefault((row.scenario, row.model), []).append(float(value))
    return {cell: fmean(values) for cell, values in scores.items()}


def predict(
    campaign: LoopCampaign, scores: Mapping[tuple[str, str], float], metric: str
) -> list[Prediction]:
    """Compare scores with headlines, by event, latency and drivers with like cards.

    Baselines, under whatever label, and starved drivers aren't counted.

    Args:
        campaign: gives the headlines; a model has its score under the driver's name.
        scores: by event and model.
        metric: name of the score.
    """
    models = {one.display_name for one in campaign.plan.everybody if one.driver not in BASELINES}
    group_of = {name: k for k, group in campaign.groups.items() for name in group}
    cells: dict[tuple[str, Latency, int], list[Point]] = {}
    for one in campaign.rates:
        score = scores.get((one.event, one.driver))
        if one.driver not in models or one.starved or score is None or one.headline is None:
            continue
        if one.low is None or one.high is None:
            continue
        cell = one.event, one.latency, group_of[one.driver]
        points = cells.setdefault(cell, [])
        points.append(Point(one.driver, score, one.headline, one.low, one.high))
    return [
        Prediction(event, latency, metric, len(points), rho_of(points), inversions_of(points))
        for (event, latency, _), points in cells.items()
    ]


def rho_of(points: Sequence[Point]) -> float | None:
    """Return Spearman's rank correlation; None of few drivers, or where nothing varies."""
    if len(points) < LEAST_DRIVERS:
        return None
    x, y = [one.score for one in points], [one.headline for one in points]
    if len(set(x)) < 2 or len(set(y)) < 2:
        return None
    from scipy.stats import spearmanr  # type: ignore[import-untyped]  # slow to import, no types

    return float(spearmanr(x, y).statistic)


def inversions_of(points: Sequence[Point]) -> tuple[tuple[str, str], ...]:
    """Return the pairs that are ordered differently, the one with the better score first."""
    inversions = []
    for one, other in combinations(points, 2):
        better, worse = (one, other) if one.score > other.score else (other, one)
        if better.score > worse.score and better.high < worse.low:
            inversions.append((better.driver, worse.driver))
    return tuple(inversions)


def prediction_table(campaign: LoopCampaign, rows: Sequence[CellRow]) -> Table:
    """Return how IVCS and its components go with the headlines.

    Args:
        campaign: gives the headlines.
        rows: cells of `ssp evaluate` on the same events, none of a driven recording.
    """
    predictions = [
        one
        for metric in (IVCS, *COMPONENTS)
        for one in predict(campaign, scores_by_driver(rows, metric, campaign.plan.events), metric)
    ]
    return Table(
        "prediction",
        "Open loop against closed loop",
        (
            Column("event", "event", "text"),
            Column("latency", "L, s", "number"),
            Column("metric", "score", "text"),
            Column("n", "drivers", "count"),
            Column("rho", "ρ", "signed"),
            Column("inversions", "better score, worse headline", "text"),
        ),
        tuple(
            (
                *(o.event, o.latency.cell_text, o.metric, o.n, o.rho),
                ", ".join(f"{a} over {b}" for a, b in o.inversions),
            )
            for o in predictions
        ),
        notes=(
            "The unit is the driver; its score is that of the model of its name on the built-in "
            f"driver's recording of the event. Spearman's ρ from {LEAST_DRIVERS} drivers on, "
            "baselines and starved drivers not counted, those with unlike cards in separate "
            "rows. Pairs are named where the intervals of their headlines don't "
            "overlap.",
            *([] if predictions else [_NOBODY]),
        ),
    )
