"""Differences between domains, each with its interval and with what the labels alone give."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from ssp_eval.score.aggregate import EQUAL, Cell, mean, relative_difference
from ssp_eval.score.metrics import IVCS_FIRST, METRIC_LABELS
from ssp_eval.statistics.constants import CONSTANT, Place, instead
from ssp_eval.statistics.resampling import Interval, cluster_interval
from ssp_eval.statistics.rows import MACRO
from ssp_eval.statistics.table import COUNT, Column, Table, Value, in_order

# A row over all scenarios.
ALL = "all"
NO_UNITS = "one recording each: no interval"
# The same of means over scenarios that others published.
NO_CELLS = "published means: no interval"
NOT_OWED = "not attributable to the model"

LABELS_ALONE = Column("labels_alone", "labels alone", "signed")
FINDING = Column("finding", "finding", "text")
# What a table that has these columns says of them.
DOMAIN_NOTES = (
    "The comparison is between recordings, one of each event and domain: nothing here shows which "
    "of their properties causes a difference.",
    "95 %: Student's interval of the mean over pairs, with the scenarios as clusters, since all "
    "cells of a scenario rest on one recording in each domain; with one scenario there is no "
    f"interval ({NO_UNITS}). Scenarios chosen by hand are not a random sample.",
    f"labels alone: what the {CONSTANT} of each scenario, one text and one trajectory given "
    "without seeing anything, gains between the same recordings: there the labels differ in what "
    f"they ask for. A difference that isn't larger, whatever its sign, is {NOT_OWED}.",
)


def over_recordings(of_scenario: Mapping[str, Sequence[float]]) -> Interval:
    """Return Student's interval, over scenarios, of the mean difference between two domains.

    Args:
        of_scenario: by scenario the differences of its cells, which share two recordings.
    """
    cells = of_scenario.values()
    return cluster_interval([math.fsum(one) for one in cells], [len(one) for one in cells])


def no_interval(scenarios: Iterable[str]) -> str:
    """Say why a difference between two domains in these scenarios may have no interval."""
    return NO_CELLS if MACRO in scenarios else NO_UNITS


def finding(
    difference: float | None,
    interval: Interval,
    labels_alone: float | None,
    without: str = NO_UNITS,
) -> str:
    """Return what must be read beside a difference between two domains; empty for nothing.

    Args:
        difference: of the two; None: it isn't known.
        interval: of the difference.
        labels_alone: what the best blind constant gains; None: it isn't known.
        without: said where there is no interval, see no_interval.
    """
    if difference is None:
        return ""
    remarks = [without] if interval.low is None else []
    if labels_alone is not None and EQUAL < abs(labels_alone) >= abs(difference) - EQUAL:
        remarks.append(f"{NOT_OWED}: the labels alone give {labels_alone:+.3f}")
    return "; ".join(remarks)


def domain_differences(
    cells: Sequence[Cell], constants: Mapping[Place, Cell], notes: Sequence[str] = ()
) -> Table:
    """Compare each two domains, over all scenarios and in each (METHOD 6.13).

    The means of both are over the scenarios and models that both have, so that what is shown is no
    difference between cells.

    Args:
        cells: that enter means; those that weren't admitted are left out.
        constants: the best blind constant's cells; empty: they are unknown.
        notes: further notes under the table.
    """
    parts = _parts(cells)
    rows: list[tuple[Value, ...]] = []
    for metric in IVCS_FIRST:
        own, blind = _scores(cells, metric), _scores(instead(cells, constants), metric)
        label = METRIC_LABELS[metric]
        rows += [
            (second, first, scenario, label, *_row(own, blind, first, second, places))
            for first, second, scenario, places in parts
        ]
    explanations = (
        "difference: mean of domain minus mean of compared with; Δ: relative to |compared with|, "
        "from unrounded values, – where that is 0. n counts pairs of cells with the same scenario "
        "and model in both domains.",
        *DOMAIN_NOTES,
        "No domain is the true one: a difference is as much a property of the one compared with.",
    )
    return Table(
        "domain_differences",
        "Differences between domains",
        _columns(Column("metric", "score", "text")),
        tuple(rows),
        (*explanations, *notes),
    )


def domain_differences_by_model(
    cells: Sequence[Cell], constants: Mapping[Place, Cell], notes: Sequence[str] = ()
) -> Table:
    """Compare each two domains by IVCS model for model; see domain_differences."""
    own, blind = _scores(cells, "ivcs"), _scores(instead(cells, constants), "ivcs")
    rows: list[tuple[Value, ...]] = []
    by_model: dict[str, list[Cell]] = {}
    for cell in cells:
        by_model.setdefault(cell.model, []).append(cell)
    for model in sorted(by_model):
        rows += [
            (second, first, scenario, model, *_row(own, blind, first, second, places))
            for first, second, scenario, places in _parts(by_model[model])
        ]
    return Table(
        "domain_differences_model",
        "Differences of IVCS between domains, model for model",
        _columns(Column("model", "model", "text")),
        tuple(rows),
        ("n counts scenarios.", *DOMAIN_NOTES, *notes),
    )


def _columns(fourth: Column) -> tuple[Column, ...]:
    return (
        Column("domain", "domain", "text"),
        Column("reference", "compared with", "text"),
        Column("scenario", "scenario", "text"),
        fourth,
        COUNT,
        Column("difference", "difference", "signed"),
        Column("low", "95 % low", "signed"),
        Column("high", "95 % high", "signed"),
        LABELS_ALONE,
        Column("change", "Δ", "change"),
        FINDING,
    )


Model = tuple[str, str]


def _parts(cells: Iterable[Cell]) -> list[tuple[str, str, str, list[Model]]]:
    """Return each two domains with each scenario, and with all, and the places that both have."""
    there: dict[str, set[Model]] = {}
    for cell in cells:
        if cell.admitted:
            there.setdefault(cell.domain, set()).add((cell.scenario, cell.model))
    parts = []
    for first, second in combinations(sorted(there, key=lambda name: in_order([name])), 2):
        shared = sorted(there[first] & there[second])
        scenarios = sorted({scenario for scenario, _ in shared})
        if len(scenarios) != 1:
            parts.append((first, second, ALL, shared))
        parts += [(first, second, name, [x for x in shared if x[0] == name]) for name in scenarios]
    return parts


# By domain, scenario and model.
_Known = Mapping[tuple[str, str, str], float]


def _scores(cells: Iterable[Cell], metric: str) -> _Known:
    return {
        (cell.domain, cell.scenario, cell.model): value
        for cell in cells
        if (value := cell.score[metric]) is not None
    }


def _row(
    own: _Known, blind: _Known, first: str, second: str, places: Sequence[Model]
) -> tuple[Value, ...]:
    """Return a row's numbers, over the places where neither score is null."""
    common_places = [p for p in places if (first, *p) in own and (second, *p) in own]
    base, other = (mean(own[name, *p] for p in common_places).value for name in (first, second))
    difference = None if base is None or other is None else other - base
    of_scenario: dict[str, list[float]] = {}
    for place in common_places:
        of_scenario.setdefault(place[0], []).append(own[second, *place] - own[first, *place])
    interval = over_recordings(of_scenario)
    gained = [
        blind.get((second, *p), math.nan) - blind.get((first, *p), math.nan) for p in common_places
    ]
    labels_alone = None if not gained or any(map(math.isnan, gained)) else mean(gained).value
    return (
        len(common_places),
        difference,
        interval.low,
        interval.high,
        labels_alone,
        relative_difference(other, base),
        finding(difference, interval, labels_alone, no_interval(of_scenario)),
    )
