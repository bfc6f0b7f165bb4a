"""The tables of METHOD 6.13, from rows: means, strata and foundation models; and all together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

from ssp_core.errors import InputError
from ssp_eval.analysis.control_tables import control_tables
from ssp_eval.analysis.matrix_table import matrix_table
from ssp_eval.analysis.rank_table import rank_table
from ssp_eval.analysis.row import OK, CellRow, entering, one_scale, over_what, repeated
from ssp_eval.analysis.table import Column, Table, Value, some
from ssp_eval.analysis.table_columns import COUNT, MEANS, TITLES, in_order
from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    EQUAL,
    Cell,
    Mean,
    mean,
    means,
    relative_difference,
)

BY_DOMAIN_MODEL = ("domain", "model")
# A row over all scenarios.
ALL = "all"
COMPARED = ("jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr", "ivcs")
_GROUPINGS = (
    ("by_model", "Means by model", BY_MODEL),
    ("by_domain", "Means by domain", BY_DOMAIN),
    ("by_scenario_domain", "Means by scenario and domain", BY_SCENARIO_DOMAIN),
    ("by_scenario_model", "Means by scenario and model", BY_SCENARIO_MODEL),
    ("by_domain_model", "Means by domain and model", BY_DOMAIN_MODEL),
)


MEAN_TABLES = tuple(name for name, _, _ in _GROUPINGS)


def all_tables(rows: Sequence[CellRow], reference: str | None = None) -> list[Table]:
    """Every table that rows alone give.

    Args:
        rows: of one or several runs.
        reference: model that the foundation models are compared with.

    Raises:
        InputError: no cell is of that model.
    """
    chosen = entering(rows)
    cells = [row.cell() for row in chosen]
    notes = run_notes(rows)
    over = over_what(rows)
    found = [matrix_table(rows)]
    found += [
        mean_table(cells, name, title, by, notes)
        for name, title, by in _GROUPINGS
        if over.isdisjoint(by)
    ]
    if not over:
        found.append(strata_table(cells, notes))
    if "domain" not in over:
        found.append(domain_differences(cells, notes))
    found.append(foundation_table(chosen, reference, notes))
    for subject in ("model", "domain"):
        if subject not in over:
            told = (*uneven(cells, subject), *_left_out(cells, (subject,)), *notes)
            found.append(rank_table(cells, subject, told))
    found += control_tables(rows)
    return found


def with_notices(tables: Iterable[Table], notices: Iterable[str]) -> list[Table]:
    """The tables with what must stand under each of them."""
    told = tuple(notices)
    return [replace(table, notices=told) for table in tables]


def run_notes(rows: Sequence[CellRow]) -> tuple[str, ...]:
    """What a mean leaves out, and what it takes together."""
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
            f"{_counted(runs, 'run')} without a score left out of cells that have others; see the "
            "matrix for reasons."
        )
    if nulls:
        notes.append(f"In {_cells(len(nulls))} a component has no denominator: 0 in IVCS.")
    controls = sorted({row.model for row in rows if row.control})
    if controls:
        notes.append(f"Controls left out: {', '.join(controls)}.")
    return tuple(notes)


def _cells(count: int) -> str:
    return _counted(count, "cell")


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"


def _key_columns(by: Iterable[str]) -> tuple[Column, ...]:
    return tuple(Column(key, key, "text") for key in by)


def mean_table(
    cells: Sequence[Cell], name: str, title: str, by: Sequence[str], notes: Sequence[str]
) -> Table:
    """One grouping of METHOD 6.13, n with each mean."""
    groups = sorted(means(cells, by).items(), key=lambda one: in_order(one[0]))
    rows: list[tuple[Value, ...]] = [
        (*key, found["ivcs"].n, *(found[column.key] for column in MEANS)) for key, found in groups
    ]
    said = ["Unweighted means over cells; n counts cells. RL is the mean over responses only."]
    said += uneven(cells, by[0]) if len(by) == 1 else []
    return Table(
        name,
        title,
        (*_key_columns(by), COUNT, *MEANS),
        tuple(rows),
        (*said, *_left_out(cells, by), *notes),
    )


def _left_out(cells: Sequence[Cell], by: Sequence[str]) -> list[str]:
    count = sum(not cell.admitted for cell in cells) if "domain" in by else 0
    if not count:
        return []
    return [
        f"{_cells(count)} left out: the transfer audit did not admit the recording, or there was "
        "none, or its labels don't compare with those of other domains."
    ]


def uneven(cells: Sequence[Cell], subject: str) -> list[str]:
    """A sentence where the models or domains were not scored on the same cells.

    Args:
        cells: that enter means; for domains those that aren't admitted don't count.
        subject: ``model`` or ``domain``.
    """
    other = "domain" if subject == "model" else "model"
    over: dict[str, set[tuple[str, str]]] = {}
    for cell in cells:
        if cell.admitted or subject != "domain":
            place = cell.scenario, getattr(cell, other)
            over.setdefault(getattr(cell, subject), set()).add(place)
    every = {place for found in over.values() for place in found}
    lacking = [f"{name} {len(over[name])}" for name in sorted(over) if over[name] != every]
    if not lacking:
        return []
    return [
        f"The {subject}s were not scored on the same cells (of {len(every)}: "
        f"{some(lacking)}): a difference between two of them, or in rank, may be one between "
        "cells."
    ]


def strata_table(cells: Sequence[Cell], notes: Sequence[str]) -> Table:
    """IVCS within each scenario and domain: how far the models lie apart, and which leads."""
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
        *_key_columns(BY_SCENARIO_DOMAIN), COUNT, Column("mean", "mean"), Column("sd", "sd"),
        Column("min", "min"), Column("max", "max"), Column("best", "best", "text"),
    )  # fmt: skip
    said = ("n counts models; sd is that of a sample, and null for one model.",)
    left_out = _left_out(cells, BY_SCENARIO_DOMAIN)
    return Table("strata", "IVCS within strata", columns, tuple(rows), (*said, *left_out, *notes))


def sd(values: Iterable[float]) -> float | None:
    """The standard deviation of a sample (n − 1); None of fewer than two values."""
    present = list(values)
    if len(present) < 2:
        return None
    centre = math.fsum(present) / len(present)
    return math.sqrt(math.fsum((v - centre) ** 2 for v in present) / (len(present) - 1))


def foundation_table(
    rows: Sequence[CellRow], reference: str | None, notes: Sequence[str] = ()
) -> Table:
    """Models with their parameters and the relative difference to a reference (METHOD 6.13).

    Args:
        rows: that enter means.
        reference: name of the model that the others are compared with; None compares nothing.
        notes: to stand under it.

    Raises:
        InputError: no row is of the reference.
    """
    found = {key[0]: value for key, value in means([r.cell() for r in rows], BY_MODEL).items()}
    if reference is not None and reference not in found:
        raise InputError(
            "is no model with a valid cell",
            field="--reference",
            value=reference,
            remedy=f"known are {', '.join(sorted(found)) or 'none'}",
        )
    facts = {row.model: row for row in rows}
    base = found[reference] if reference is not None else None
    table_rows = []
    for model in sorted(found, key=lambda name: (-(found[name]["ivcs"].value or 0.0), name)):
        row, values = facts[model], found[model]
        table_rows.append(
            (
                model, row.architecture or None, row.total_b, row.active_b, values["ivcs"].n,
                *(values[key] for key in COMPARED), *_differences(values, base),
            )
        )  # fmt: skip
    columns = (
        Column("model", "model", "text"),
        Column("architecture", "architecture", "text"),
        Column("total_b", "total (B)", "billions"),
        Column("active_b", "active (B)", "billions"),
        COUNT,
        *(Column(key, TITLES[key]) for key in COMPARED),
        *(_changes() if base else ()),
    )
    said = ["Unweighted means over cells; n counts cells. B: billions of parameters."]
    if base is not None:
        said.append(f"Δ: relative difference to {reference}, from unrounded values.")
    said += uneven([row.cell() for row in rows], "model")
    return Table(
        "foundation_models", "Foundation models", columns, tuple(table_rows), (*said, *notes)
    )


def domain_differences(cells: Sequence[Cell], notes: Sequence[str] = ()) -> Table:
    """Each domain beside each other one, over all scenarios and in each (METHOD 6.13).

    The means of both are over the scenarios and models that both have, so that what is shown is no
    difference between cells.

    Args:
        cells: that enter means; those that weren't admitted are left out.
        notes: to stand under it.
    """
    values: dict[str, dict[tuple[str, str], Cell]] = {}
    for cell in cells:
        if cell.admitted:
            values.setdefault(cell.domain, {})[(cell.scenario, cell.model)] = cell
    names = sorted(values, key=lambda name: in_order([name]))
    rows: list[tuple[Value, ...]] = []
    for first, second in combinations(names, 2):
        shared = sorted(values[first].keys() & values[second].keys())
        scenarios = sorted({scenario for scenario, _ in shared})
        parts = [(name, [one for one in shared if one[0] == name]) for name in scenarios]
        if len(scenarios) != 1:
            parts.insert(0, (ALL, shared))
        for scenario, places in parts:
            base, own = (
                {key: mean(values[d][place].score[key] for place in places) for key in COMPARED}
                for d in (first, second)
            )
            rows.append((second, first, scenario, len(places), *_differences(own, base)))
    columns = (
        Column("domain", "domain", "text"),
        Column("reference", "compared with", "text"),
        Column("scenario", "scenario", "text"),
        COUNT,
        *_changes(),
    )
    said = (
        "Δ: relative difference of the means, (domain − compared with) / |compared with|, from "
        "unrounded values; – where the latter is 0. n counts pairs of cells, the same scenario and "
        "model in both domains.",
        "No domain is the true one: the difference is as much that of the one it is compared with.",
    )
    return Table(
        "domain_differences",
        "Relative differences between domains",
        columns,
        tuple(rows),
        (*said, *_left_out(cells, BY_DOMAIN), *notes),
    )


def _changes() -> Iterable[Column]:
    return (Column(f"d_{key}", f"Δ {TITLES[key]}", "change") for key in COMPARED)


def _differences(values: Mapping[str, Mean], base: Mapping[str, Mean] | None) -> list[float | None]:
    if base is None:
        return []
    return [relative_difference(values[key].value, base[key].value) for key in COMPARED]
