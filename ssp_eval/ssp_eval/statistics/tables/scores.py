"""The tables of METHOD 6.13, from rows: matrix, means, strata, ranks, controls."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from ssp_core.errors import InputError
from ssp_eval.evaluate.clients.models import BLIND, condition_of
from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    EQUAL,
    Cell,
    Mean,
    Ranking,
    means,
    ranking,
    relative_difference,
)
from ssp_eval.score.metrics import IVCS_LAST, METRIC_LABELS
from ssp_eval.statistics.constants import (
    BELOW,
    CONSTANT,
    Place,
    constant_means,
    constants_in,
    is_below,
)
from ssp_eval.statistics.domains import domain_differences, domain_differences_by_model
from ssp_eval.statistics.resampling import sd
from ssp_eval.statistics.rows import MACRO, OK, CellRow, entering, one_scale, over_what, repeated
from ssp_eval.statistics.table import (
    AFTER_RISK,
    BEFORE_RISK,
    BEHIND,
    COUNT,
    MEANS,
    Column,
    Outcome,
    Table,
    Value,
    counted,
    in_order,
    metric_columns,
    some,
)
from ssp_eval.statistics.tables.controls import control_tables

YES, NO = "yes", "no"
# In CSV and JSON alone: what another analysis of the same cells needs, and no reader of a page.
_BEHIND = (
    *BEHIND,
    Column("total_b", "total (B)", "billions", printed=False),
    Column("active_b", "active (B)", "billions", printed=False),
    *(
        Column(key, key, "text", printed=False)
        for key in (
            "architecture",
            "control",
            "admitted",
            "stand_in",
            "status",
            "reason",
        )
    ),
    Column("lost", "answers lost", "count", printed=False),
    *(Column(key, key, "text", printed=False) for key in ("thresholds", "declared_by")),
)


def matrix_table(rows: Sequence[CellRow]) -> Table:
    """Return every run of every cell, controls and lost ones too (METHOD 6.13)."""
    runs, seeds = any(row.run for row in rows), any(row.seed is not None for row in rows)
    constants = constants_in(one_scale(rows))
    columns = (
        *(Column(key, key, "text") for key in ("scenario", "domain", "model")),
        *((Column("run", "run", "text"),) if runs else ()),
        *((Column("seed", "seed", "count"),) if seeds else ()),
        COUNT,
        *BEFORE_RISK,
        Column("response", "risk", "response"),
        *AFTER_RISK,
        Column("remark", "remark", "text"),
        *_BEHIND,
    )

    def key(row: CellRow) -> tuple[object, ...]:
        seed = -1 if row.seed is None else row.seed
        return row.scenario, in_order([row.domain]), row.control, row.model, row.run, seed

    table_rows: list[tuple[Value, ...]] = [
        (
            row.scenario,
            row.domain,
            row.model,
            *((row.run,) if runs else ()),
            *((row.seed,) if seeds else ()),
            row.n,
            *_scores(row, BEFORE_RISK),
            Outcome(row.rsr, row.rl_s, bool(row.over)),
            *_scores(row, AFTER_RISK),
            _remark(row, constants.get((row.scenario, row.domain))),
            *_scores(row, BEHIND),
            row.total_b,
            row.active_b,
            row.architecture,
            YES if row.control else NO,
            YES if row.admitted else NO,
            YES if row.stand_in else NO,
            row.status,
            row.reason,
            row.lost,
            row.thresholds,
            row.declared_by,
        )
        for row in sorted(rows, key=key)
    ]
    notes = ["n counts labels."]
    if over_what(rows):
        notes.append("risk of a macro row: the share of cells with a response, @ their mean RL.")
    if any(row.ivcs_nulls for row in rows):
        notes.append("A component without a denominator counts as 0 in IVCS.")
    return Table("matrix", "Scores per cell", columns, tuple(table_rows), tuple(notes))


def _scores(row: CellRow, columns: Iterable[Column]) -> list[float | None]:
    return [getattr(row, column.key) for column in columns]


def _remark(row: CellRow, constant: Cell | None) -> str:
    parts = []
    if row.control:
        parts.append(f"control, {BLIND}" if condition_of(row.model)[1] == BLIND else "control")
    elif constant is not None and is_below(row.ivcs, constant.score["ivcs"]):
        parts.append(BELOW)
    if row.status != OK:
        parts.append(f"{row.status}: {row.reason}" if row.reason else row.status)
    elif row.reason or not row.admitted:
        parts.append(row.reason or "not admitted")
    if row.thresholds:
        parts.append("other thresholds")
    if row.ivcs_nulls:
        parts.append("null: " + ", ".join(METRIC_LABELS[name] for name in row.ivcs_nulls))
    return "; ".join(parts)


# Of more scenarios than these there are too many pairs to read.
MOST_PAIRED = 6
CHANGES = "changes"


def rank_table(
    cells: Sequence[Cell],
    subject: str,
    notes: Sequence[str],
    constants: Mapping[Place, Cell] = MappingProxyType({}),
) -> Table:
    """Tabulate ranks by IVCS per scenario and over all, and point out every change of rank.

    Args:
        cells: those that enter means.
        subject: what is ranked: "model" or "domain".
        notes: further notes under the table.
        constants: the best blind constant's cells, which have no rank.
    """
    standings = ranking(cells, subject)
    blind = constant_means(cells, constants, (subject,))
    below = names_below(cells, constants, subject)
    scenarios = sorted(name for name in standings.scenarios if name != MACRO)
    values = {key[0]: value["ivcs"] for key, value in means(cells, (subject,)).items()}
    rows = tuple(
        (
            name,
            *(standings.scenarios[scenario].get(name) for scenario in scenarios),
            standings.macro[name],
            values[name],
            blind.get((name,)),
            below.get(name, ""),
            _rank_changes(standings, name),
        )
        for name in sorted(standings.macro, key=lambda n: (standings.macro[n] or len(values), n))
    )
    columns = (
        Column(subject, subject, "text"),
        *(Column(f"rank_{name}", name.replace("_", " "), "count") for name in scenarios),
        Column("rank_all", "all", "count"),
        Column("ivcs", "mean IVCS"),
        Column("constant", CONSTANT, printed=bool(constants)),
        Column("below", BELOW, "text", printed=bool(constants)),
        Column(CHANGES, "changes of rank", "text"),
    )
    explanations = [
        "Rank 1 is the largest mean IVCS, from unrounded values; equal ones share a rank."
    ]
    if constants:
        explanations.append(
            f"{CONSTANT}: mean IVCS over the same cells of the one answer that scores most without "
            f"looking; it has no rank. {BELOW}: where the {subject} scores less than that."
        )
    if not standings.changes and len(scenarios) > 1:
        explanations.append("No rank changes between scenarios.")
    return Table(f"ranks_{subject}", f"Ranks of {subject}s", columns, rows, (*explanations, *notes))


def names_below(
    cells: Sequence[Cell], constants: Mapping[Place, Cell], subject: str
) -> dict[str, str]:
    """Say of each model or domain that scores less than the constant in which scenarios it does.

    Returns:
        By name ``all`` for the mean over all cells, and scenarios.
    """
    places: dict[str, list[str]] = {}
    for by in ((subject,), ("scenario", subject)):
        own, blind = means(cells, by), constant_means(cells, constants, by)
        for key, constant in blind.items():
            if is_below(own[key]["ivcs"].value, constant.value):
                places.setdefault(key[-1], []).append("all" if len(by) == 1 else key[0])
    return {name: ", ".join(where) for name, where in places.items()}


def _rank_changes(standings: Ranking, name: str) -> str:
    """Return ``2 in cut_in, 1 in vru_crossing`` for each pair; of many scenarios the range."""
    changes = [change for change in standings.changes if change.subject == name]
    if not changes:
        return ""
    if len(standings.scenarios) <= MOST_PAIRED:
        return "; ".join(
            f"{change.ranks[0]} in {change.scenarios[0]}, {change.ranks[1]} in "
            f"{change.scenarios[1]}"
            for change in changes
        )
    ranks = [
        (rank, scenario)
        for scenario in sorted(standings.scenarios)
        if (rank := standings.scenarios[scenario].get(name)) is not None
    ]
    best, worst = min(ranks), max(ranks, key=lambda pair: pair[0])
    return (
        f"from {best[0]} in {best[1]} to {worst[0]} in {worst[1]}, "
        f"{len({rank for rank, _ in ranks})} different ranks in {len(ranks)} scenarios"
    )


BY_DOMAIN_MODEL = ("domain", "model")
_GROUPINGS = (
    ("by_model", "Means by model", BY_MODEL),
    ("by_domain", "Means by domain", BY_DOMAIN),
    ("by_scenario_domain", "Means by scenario and domain", BY_SCENARIO_DOMAIN),
    ("by_scenario_model", "Means by scenario and model", BY_SCENARIO_MODEL),
    ("by_domain_model", "Means by domain and model", BY_DOMAIN_MODEL),
)


MEAN_TABLES = tuple(name for name, _, _ in _GROUPINGS)


def all_tables(rows: Sequence[CellRow], reference: str | None = None) -> list[Table]:
    """Return every table that rows alone give.

    Raises:
        InputError: no cell is of that model.
    """
    entrants = entering(rows)
    cells = [row.cell() for row in entrants]
    constants = constants_in(one_scale(rows))
    notes = run_notes(rows)
    over = over_what(rows)
    tables = [matrix_table(rows)]
    tables += [
        mean_table(cells, name, title, by, notes)
        for name, title, by in _GROUPINGS
        if over.isdisjoint(by)
    ]
    if not over:
        tables.append(strata_table(cells, notes))
    if "domain" not in over:
        table_notes = (*_left_out(cells, BY_DOMAIN), *notes)
        tables.append(domain_differences(cells, constants, table_notes))
        tables.append(domain_differences_by_model(cells, constants, table_notes))
    tables.append(foundation_table(entrants, reference, notes))
    for subject in ("model", "domain"):
        if subject not in over:
            table_notes = (*uneven(cells, subject), *_left_out(cells, (subject,)), *notes)
            tables.append(rank_table(cells, subject, table_notes, constants))
    tables += control_tables(rows)
    return tables


def with_notices(tables: Iterable[Table], notices: Iterable[str]) -> list[Table]:
    """Return the tables with what must stand under each of them."""
    texts = tuple(notices)
    return [replace(table, notices=texts) for table in tables]


def run_notes(rows: Sequence[CellRow]) -> tuple[str, ...]:
    """List what a mean leaves out, and what it takes together."""
    models = [row for row in one_scale(rows) if not row.control]
    scored = {row.key for row in models if row.status == OK}
    lost = [row for row in models if row.status != OK]
    cells = {row.key for row in lost} - scored
    runs = sum(row.key in scored for row in lost)
    nulls = {row.key for row in models if row.ivcs_nulls}
    apart = {row.key for row in rows if not row.control} - {row.key for row in models}
    notes = []
    if apart:
        notes.append(f"{_cells(len(apart))} scored with other thresholds left out.")
    if repeated(rows):
        notes.append("A cell with several runs enters as the mean over its runs.")
    if cells:
        notes.append(f"{_cells(len(cells))} without a score left out; see the matrix for reasons.")
    if runs:
        notes.append(
            f"{counted(runs, 'run')} without a score left out of cells that have other runs; see "
            "the matrix for reasons."
        )
    if nulls:
        notes.append(f"In {_cells(len(nulls))} a component has no denominator: 0 in IVCS.")
    controls = sorted({row.model for row in rows if row.control})
    if controls:
        notes.append(f"Controls left out: {some(controls)}.")
    return tuple(notes)


def _cells(count: int) -> str:
    return counted(count, "cell")


def _key_columns(by: Iterable[str]) -> tuple[Column, ...]:
    return tuple(Column(key, key, "text") for key in by)


def mean_table(
    cells: Sequence[Cell], name: str, title: str, by: Sequence[str], notes: Sequence[str]
) -> Table:
    """Return one grouping of METHOD 6.13, n with each mean."""
    groups = sorted(means(cells, by).items(), key=lambda one: in_order(one[0]))
    rows: list[tuple[Value, ...]] = [
        (*key, scores["ivcs"].n, *(scores[column.key] for column in MEANS))
        for key, scores in groups
    ]
    explanations = [
        "Unweighted means over cells; n counts cells. RL is the mean over responses only."
    ]
    explanations += uneven(cells, by[0]) if len(by) == 1 else []
    return Table(
        name,
        title,
        (*_key_columns(by), COUNT, *MEANS),
        tuple(rows),
        (*explanations, *_left_out(cells, by), *notes),
    )


def _left_out(cells: Sequence[Cell], by: Sequence[str]) -> list[str]:
    count = sum(not cell.admitted for cell in cells) if "domain" in by else 0
    if not count:
        return []
    return [
        f"{_cells(count)} left out: the transfer audit did not admit the recording, or there was "
        "none, or its labels aren't comparable with those of other domains."
    ]


def uneven(cells: Sequence[Cell], subject: str) -> list[str]:
    """Return a sentence where the models or domains were not scored on the same cells.

    Args:
        cells: that enter means; for domains those that aren't admitted don't count.
        subject: what is compared: "model" or "domain".
    """
    other = "domain" if subject == "model" else "model"
    over: dict[str, set[tuple[str, str]]] = {}
    for cell in cells:
        if cell.admitted or subject != "domain":
            place = cell.scenario, getattr(cell, other)
            over.setdefault(getattr(cell, subject), set()).add(place)
    every = {place for places in over.values() for place in places}
    lacking = [f"{name} {len(over[name])}" for name in sorted(over) if over[name] != every]
    if not lacking:
        return []
    return [
        f"The {subject}s were not scored on the same cells (of {len(every)}: "
        f"{some(lacking)}): a difference between two of them, or in rank, may come from the "
        "cells."
    ]


def strata_table(cells: Sequence[Cell], notes: Sequence[str]) -> Table:
    """Tabulate IVCS within each scenario and domain: spread of the models, and the leader."""
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        if cell.admitted:
            groups.setdefault((cell.scenario, cell.domain), []).append(cell)
    rows = []
    for (scenario, domain), group in sorted(groups.items(), key=lambda one: in_order(one[0])):
        values = {cell.model: cell.score["ivcs"] or 0.0 for cell in group}
        low, high = min(values.values()), max(values.values())
        best = ", ".join(sorted(model for model, value in values.items() if value >= high - EQUAL))
        middle = math.fsum(values.values()) / len(values)
        rows.append((scenario, domain, len(values), middle, sd(values.values()), low, high, best))
    columns = (
        *_key_columns(BY_SCENARIO_DOMAIN),
        COUNT,
        Column("mean", "mean"),
        Column("sd", "sd"),
        Column("min", "min"),
        Column("max", "max"),
        Column("best", "best", "text"),
    )
    explanations = ("n counts models; sd is that of a sample, and null for one model.",)
    left_out = _left_out(cells, BY_SCENARIO_DOMAIN)
    return Table(
        "strata", "IVCS within strata", columns, tuple(rows), (*explanations, *left_out, *notes)
    )


def foundation_table(
    rows: Sequence[CellRow], reference: str | None, notes: Sequence[str] = ()
) -> Table:
    """Tabulate models with their parameters and the difference to a reference (METHOD 6.13).

    Args:
        rows: those that enter means.
        reference: name of the model that the others are compared with; None compares nothing.
        notes: further notes under the table.

    Raises:
        InputError: no row is of the reference.
    """
    means_by_model = {
        key[0]: value for key, value in means([r.cell() for r in rows], BY_MODEL).items()
    }
    if reference is not None and reference not in means_by_model:
        raise InputError(
            "is no model with a valid cell",
            field="--reference",
            value=reference,
            remedy=f"known: {', '.join(sorted(means_by_model)) or 'none'}",
        )
    facts = {row.model: row for row in rows}
    base = means_by_model[reference] if reference is not None else None
    table_rows = []
    for model in sorted(
        means_by_model, key=lambda name: (-(means_by_model[name]["ivcs"].value or 0.0), name)
    ):
        row, values = facts[model], means_by_model[model]
        table_rows.append(
            (
                model,
                row.architecture or None,
                row.total_b,
                row.active_b,
                values["ivcs"].n,
                *(values[key] for key in IVCS_LAST),
                *_differences(values, base),
            )
        )
    columns = (
        Column("model", "model", "text"),
        Column("architecture", "architecture", "text"),
        Column("total_b", "total (B)", "billions"),
        Column("active_b", "active (B)", "billions"),
        COUNT,
        *metric_columns(*IVCS_LAST),
        *(_changes() if base else ()),
    )
    explanations = ["Unweighted means over cells; n counts cells. B: billions of parameters."]
    if base is not None:
        explanations.append(f"Δ: relative difference to {reference}, from unrounded values.")
    explanations += uneven([row.cell() for row in rows], "model")
    return Table(
        "foundation_models",
        "Foundation models",
        columns,
        tuple(table_rows),
        (*explanations, *notes),
    )


def _changes() -> Iterable[Column]:
    return (Column(f"d_{key}", f"Δ {METRIC_LABELS[key]}", "change") for key in IVCS_LAST)


def _differences(values: Mapping[str, Mean], base: Mapping[str, Mean] | None) -> list[float | None]:
    if base is None:
        return []
    return [relative_difference(values[key].value, base[key].value) for key in IVCS_LAST]
