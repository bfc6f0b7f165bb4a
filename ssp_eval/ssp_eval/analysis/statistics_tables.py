"""Statistics as tables, each with what it can't say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ssp_eval.analysis.compare import FLIPS, Comparison
from ssp_eval.analysis.interval_tables import (
    cells_over_records,
    groups_over_records,
    over_cells,
    runs_table,
    words,
)
from ssp_eval.analysis.sensitivity import Variation, WeightSamples
from ssp_eval.analysis.statistics import Beside, Statistics
from ssp_eval.analysis.table import Column, Kind, Table


def statistics_tables(found: Statistics, resamples: int) -> list[Table]:
    """All that there is to show, most general first.

    Args:
        found: the statistics.
        resamples: of the bootstrap, for the notes.
    """
    tables = []
    if found.records is not None:
        tables.append(groups_over_records(found.records.groups, resamples))
        tables.append(cells_over_records(found.records.cells, resamples))
    tables.append(over_cells(found.over_cells, resamples))
    tables.append(comparison_table(found.comparisons))
    tables += [table for one in found.weights for table in _weights(one)]
    if found.variations:
        tables.append(_variations(found.variations))
    if found.runs is not None:
        tables.append(runs_table(found.runs))
    if found.curves:
        tables.append(_curves(found.curves))
    return tables


def comparison_table(comparisons: Iterable[Comparison]) -> Table:
    """Paired comparisons, with what so few pairs can't show."""
    listed = list(comparisons)
    rows = [
        (
            c.subject, c.first, c.second, c.metric, c.n, c.difference, c.interval.low,
            c.interval.high, c.standardised, c.favour, c.p, c.p_holm, c.p_least,
            c.family or None, c.scenarios, c.p_scenarios,
        )
        for c in listed
    ]  # fmt: skip
    numbers: tuple[tuple[str, str, Kind], ...] = (
        ("difference", "difference", "ratio"), ("low", "95 % low", "ratio"),
        ("high", "95 % high", "ratio"), ("d_z", "d_z", "ratio"), ("ahead", "ahead", "ratio"),
        ("p", "p", "p"), ("p_holm", "p (Holm)", "p"), ("p_least", "least p", "p"),
    )  # fmt: skip
    notes = [
        "difference: mean of first less second over pairs of cells, with Student's interval; n "
        "counts pairs, that is scenario × the other factor. d_z: mean over standard deviation. "
        "ahead: share of pairs in which the first leads.",
        "p: two-sided sign flips of IVCS, Holm over all comparisons of domains, and over all of "
        "models; components are described and not tested. No p with fewer than two pairs.",
        "family: how many comparisons are corrected together. Pairs of a scenario share its "
        "event: p takes them for independent, and speaks of these recordings alone. p (scenarios): "
        "all signs of a scenario flipped together, not corrected.",
        *_powerless(listed),
    ]
    if any(c.p is not None and not c.exact for c in listed):
        notes.append(f"With many pairs {FLIPS} patterns of signs were drawn instead of all.")
    return Table(
        "comparisons",
        "Paired comparisons",
        (
            *words("subject", "first", "second", "metric"),
            Column("n", "pairs", "count"),
            *(Column(key, title, kind) for key, title, kind in numbers),
            Column("family", "family", "count"),
            Column("scenarios", "scenarios", "count"),
            Column("p_scenarios", "p (scenarios)", "p"),
        ),
        tuple(rows),
        tuple(notes),
    )


def _powerless(comparisons: Iterable[Comparison]) -> list[str]:
    """Where even the clearest result couldn't have a p of 0.05 after correction."""
    found = []
    for subject in ("domain", "model"):
        tested = [c for c in comparisons if c.subject == subject and c.p_least is not None]
        if not tested:
            continue
        if all((c.p_least or 0.0) * c.family > 0.05 for c in tested):
            found.append(
                f"No comparison of {subject}s can have p (Holm) below 0.05 with so few pairs, "
                "however clear the difference: a large p there is no sign of equality."
            )
    return found


def _weights(found: WeightSamples) -> list[Table]:
    pairs = tuple(
        (one.first, one.second, "yes" if one.tied else "", one.held) for one in found.pairs
    )
    firsts = tuple(sorted(found.first.items(), key=lambda one: (-one[1], one[0])))
    tau = (
        "Kendall's τ to the defined ranks: not defined, all are equal."
        if found.tau_mean is None or found.tau_low is None
        else f"Kendall's τ to the defined ranks: mean {found.tau_mean:.3f}, 5 % quantile "
        f"{found.tau_low:.3f}."
    )
    drawn = f"{found.samples} sets of weights, drawn evenly from all that are ≥ 0 and sum to 1."
    return [
        Table(
            f"weights_{found.subject}_order",
            f"Order of {found.subject}s under other weights of IVCS",
            (*words("ahead", "behind", "tied"), Column("held", "order holds")),
            pairs,
            (drawn, tau),
        ),
        Table(
            f"weights_{found.subject}_first",
            f"Share of weights under which a {found.subject} leads",
            (*words(found.subject), Column("share", "share")),
            firsts,
            (drawn,),
        ),
    ]


def _variations(variations: Iterable[Variation]) -> Table:
    rows = [
        (
            v.subject, v.parameter, v.defined, v.value, v.tau, v.largest,
            "; ".join(f"{behind} passes {ahead}" for ahead, behind in v.changed) or None,
            "; ".join(f"{name} {value:.3f}" for name, value in v.means.items()),
        )
        for v in variations
    ]  # fmt: skip
    return Table(
        "sensitivity",
        "Mean IVCS and ranks with one number changed",
        (
            *words("subject", "parameter"),
            Column("defined", "defined"),
            Column("value", "changed to"),
            Column("tau", "τ"),
            Column("largest", "largest change of a cell"),
            *words("order_changed", "mean_ivcs"),
        ),
        tuple(rows),
        (
            "τ: Kendall's τ_b of the ranks to the defined ones. Weights that aren't changed keep "
            "their ratios and the sum is 1. Thresholds: every record scored again.",
        ),
    )


def _curves(found: Mapping[tuple[str, ...], Iterable[Beside]]) -> Table:
    rows = [
        (
            *key, one.curve.label_t_s, " / ".join(one.allowed), one.planned, one.curve.reads_as,
            one.curve.shift_m, one.curve.curve_m, one.curve.curvature_per_m,
        )
        for key, of_cell in sorted(found.items())
        for one in of_cell
    ]  # fmt: skip
    return Table(
        "curvature",
        "Lateral shift of the recorded path that follows from the curve",
        (
            *words("scenario", "domain", "model", "run"),
            Column("label_t_s", "t (s)", "seconds"),
            *words("allowed", "planned", "reads_as"),
            Column("shift_m", "shift (m)"),
            Column("curve_m", "from the curve (m)"),
            Column("curvature_per_m", "curvature (1/m)", "curvature"),
        ),
        tuple(rows),
        (
            "shift: of the recorded path within 1.0 s, left positive. reads as: the lateral action "
            "that the curve alone would be taken for, beside the allowed and the planned ones. It "
            "changes no score.",
            "A part of a change of lane turns the heading like a curve does; a path alone can't "
            "tell them apart.",
        ),
    )
