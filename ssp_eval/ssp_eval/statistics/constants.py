"""Best blind constants as rows of the matrix, and models and domains held against them.

A constant's score is what the labels of a recording give to an answer that looks at nothing: a
model below it showed less than that, and so much of a difference between domains is the labels'.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ssp_eval.data.labels import Labels
from ssp_eval.evaluate.clients.models import BEST_CONSTANT
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.score.aggregate import EQUAL, Cell, Mean, mean, means
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_eval.statistics.best_constant import Constant, best_constant
from ssp_eval.statistics.rows import GIVEN, OK, CellRow, merged, scale
from ssp_eval.statistics.table import COUNT, Column, Table, Value, metric_columns

BEST_CONSTANTS = "best_constants"
# What a figure or table calls it.
CONSTANT = "best blind constant"
BELOW = f"below the {CONSTANT}"
# Stands after the name of what scores less than the constant, where there is no room for words.
MARK = "↓"

Place = tuple[str, str]


@dataclass(frozen=True)
class OfScenario:
    """The best blind constant of a scenario.

    Args:
        recordings: domain by domain a row that was scored on it; in the order of constant.scores.
    """

    scenario: str
    constant: Constant
    recordings: tuple[CellRow, ...]


def constants_of_cells(rows: Sequence[CellRow], cells: Sequence[CellData]) -> list[OfScenario]:
    """Choose the best blind constant of each scenario from the labels of all its recordings.

    Args:
        rows: those of the cells, in their order, of one run.
        cells: of several of one recording the first that was scored counts.
    """
    main = scale(rows)
    thresholds: Thresholds = DEFAULT
    by_scenario: dict[str, dict[str, tuple[CellRow, Labels]]] = {}
    for row, cell in zip(rows, cells, strict=True):
        if cell.score is None:
            continue
        by_scenario.setdefault(row.scenario, {}).setdefault(row.domain, (row, cell.labels))
        if main and row.thresholds == main:
            thresholds = cell.thresholds
    return [
        OfScenario(
            scenario,
            best_constant(tuple(labels for _, labels in of.values()), thresholds),
            tuple(replace(row, thresholds=main) for row, _ in of.values()),
        )
        for scenario, of in sorted(by_scenario.items())
    ]


def constant_rows(constants: Iterable[OfScenario]) -> list[CellRow]:
    """Return a row of each recording, a control, with the scores of its scenario's constant."""
    return [
        CellRow(
            *(row.scenario, row.domain, BEST_CONSTANT),
            **{name: getattr(score, name) for name in GIVEN},
            n=score.n,
            run=row.run,
            control=True,
            admitted=row.admitted,
            stand_in=row.stand_in,
            declared_by=row.declared_by,
            thresholds=row.thresholds,
        )
        for one in constants
        for row, score in zip(one.recordings, one.constant.scores, strict=True)
    ]


def constant_table(constants: Sequence[OfScenario]) -> Table:
    """Return what each constant says and does, with its mean scores over the recordings."""
    keys = ("sem_acc_eff", "cia_eff", "tqsr", "rsr", "ivcs")
    has_runs = any(row.run for one in constants for row in one.recordings)
    columns = (
        Column("scenario", "scenario", "text"),
        Column("run", "run", "text", printed=has_runs),
        COUNT,
        Column("text", "text", "text"),
        Column("trajectory", "trajectory: x, y in m", "text"),
        *metric_columns(*keys),
        Column("domains", "IVCS by domain", "text"),
    )
    rows: list[tuple[Value, ...]] = []
    for one in constants:
        scores = one.constant.scores
        path = one.constant.plan.trajectory
        points = zip(path.t_s, path.x_m, path.y_m, strict=True)
        rows.append(
            (
                one.scenario,
                one.recordings[0].run,
                len(scores),
                one.constant.text,
                "; ".join(f"{x:.2f}, {y:.2f} at {t:g} s" for t, x, y in points),
                *(mean(getattr(score, key) for score in scores) for key in keys),
                ", ".join(
                    f"{row.domain} {score.ivcs:.3f}"
                    for row, score in zip(one.recordings, scores, strict=True)
                ),
            )
        )
    return Table(
        BEST_CONSTANTS,
        "The best blind constant of each scenario",
        columns,
        tuple(rows),
        (
            "The one text and trajectory that score most when they are the answer at every label "
            "time of every recording of the scenario; n counts recordings. They were chosen using "
            "the labels, which no model knows, and see nothing.",
            f"A model that scores less is marked ({MARK}, {BELOW}): it would have scored more by "
            "always giving this answer. What the constant gains from one domain to another comes "
            "from the labels alone.",
        ),
    )


def constants_in(rows: Iterable[CellRow]) -> dict[Place, Cell]:
    """Return the constant's cell of each scenario and domain, as its rows have it."""
    merged_rows = merged([row for row in rows if row.status == OK and row.model == BEST_CONSTANT])
    return {(row.scenario, row.domain): row.cell() for row in merged_rows}


def instead(cells: Iterable[Cell], constants: Mapping[Place, Cell]) -> list[Cell]:
    """Return the same cells with the scores of the constant of their recording.

    Means and ranks of these stand beside those of the cells. A recording without one is left out.
    """
    return [
        replace(cell, score=constants[place].score)
        for cell in cells
        if (place := (cell.scenario, cell.domain)) in constants
    ]


def constant_means(
    cells: Sequence[Cell], constants: Mapping[Place, Cell], by: Sequence[str]
) -> dict[tuple[str, ...], Mean]:
    """Return the constant's mean IVCS over the cells of each group, where it has all of them."""
    own, others = means(cells, by), means(instead(cells, constants), by)
    return {
        key: group["ivcs"] for key, group in others.items() if group["ivcs"].n == own[key]["ivcs"].n
    }


def is_below(value: float | None, constant: float | None) -> bool:
    """Return whether a score is less than the constant's; rounding doesn't count."""
    return value is not None and constant is not None and value < constant - EQUAL
