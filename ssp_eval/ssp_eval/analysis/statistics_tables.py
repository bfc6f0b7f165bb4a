"""Statistics as tables, each with what it can't say."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ssp_eval.analysis.compare import FLIPS, Comparison
from ssp_eval.analysis.interval_tables import (
    METRICS_NOTE,
    cells_over_records,
    groups_over_records,
    over_cells,
    runs_table,
    words,
)
from ssp_eval.analysis.sensitivity import Variation, WeightSamples
from ssp_eval.analysis.statistics import Beside, Statistics
from ssp_eval.analysis.table import Column, Kind, Table
from ssp_eval.score.ivcs import ivcs_weights


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
            c.interval.high, c.over_labels.low, c.over_labels.high, c.standardised, c.favour, c.p,
            c.p_holm, c.p_least, c.family or None, c.scenarios, c.p_scenarios, c.p_scenarios_holm,
        )
        for c in listed
    ]  # fmt: skip
    numbers: tuple[tuple[str, str, Kind], ...] = (
        ("difference", "difference", "ratio"), ("low", "95 % low", "ratio"),
        ("high", "95 % high", "ratio"), ("labels_low", "labels low", "ratio"),
        ("labels_high", "labels high", "ratio"), ("d_z", "d_z", "ratio"),
        ("ahead", "ahead", "ratio"), ("p", "p", "p"), ("p_holm", "p (Holm)", "p"),
        ("p_least", "least p", "p"),
    )  # fmt: skip
    notes = [
        "Pairs: cells of the same scenario and model for two domains, of the same scenario and "
        "domain for two models. difference: mean of first less second over the pairs, with "
        "Student's interval over them; ahead: share of pairs in which the first leads, equal ones "
        "half.",
        "p: two-sided, from flipping the signs of the pairs' differences of ivcs at random; p "
        "(Holm) holds for all comparisons of domains together, and for all of models together. "
        f"{_families(listed)} Components are described and not tested. No p with fewer than two "
        "pairs. least p: what p would be, were all differences of one sign.",
        "Pairs of a scenario share its event: p takes them for independent, and speaks of these "
        "recordings alone. p (scenarios): all signs of a scenario flipped together, which speaks "
        "of other scenarios too; the last column is corrected like p.",
        *_over_labels(listed),
        METRICS_NOTE,
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
            *(Column(key, title, kind, printed=key != "d_z") for key, title, kind in numbers),
            Column("family", "family", "count", printed=False),
            Column("scenarios", "scenarios", "count"),
            Column("p_scenarios", "p (scenarios)", "p"),
            Column("p_scenarios_holm", "p (scenarios, Holm)", "p"),
        ),
        tuple(rows),
        tuple(notes),
    )


def _over_labels(comparisons: Iterable[Comparison]) -> list[str]:
    if not any(c.over_labels.low is not None for c in comparisons):
        return []
    return [
        "labels: 95 % interval of two models' difference over the labels of the clips that both "
        "have, drawn alike for both, in blocks of neighbours. It says how far the difference "
        "depends on which moments were labelled, also where there is one clip, and nothing of "
        "other clips."
    ]


def _families(comparisons: Sequence[Comparison]) -> str:
    counts = {c.subject: c.family for c in comparisons if c.family}
    listed = ", ".join(f"{count} of {subject}s" for subject, count in sorted(counts.items()))
    return f"Comparisons tested: {listed or 'none'}."


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
        else f"Kendall's τ to the defined ranks (1: the same order, −1: the opposite one): mean "
        f"{found.tau_mean:.3f}, 5 % quantile {found.tau_low:.3f}."
    )
    weights = ", ".join(f"{weight:.2f} {name}" for name, weight in ivcs_weights().items())
    drawn = (
        f"IVCS is a weighted sum ({weights}). Here {found.samples} other sets of weights were "
        "tried, drawn evenly from all that are ≥ 0 and sum to 1."
    )
    return [
        Table(
            f"weights_{found.subject}_order",
            f"Does the order of {found.subject}s hold under other weights of IVCS?",
            (*words("ahead", "behind", "tied"), Column("held", "order holds (share)")),
            pairs,
            (
                drawn,
                "ahead and behind: as with the defined weights; tied: equal under them, and the "
                "share is that of weights that leave them equal.",
                tau,
            ),
        ),
        Table(
            f"weights_{found.subject}_first",
            f"Which {found.subject} leads under other weights of IVCS?",
            (*words(found.subject), Column("share", "leads (share)")),
            firsts,
            (drawn, "Where several are equal in front, each of them leads."),
        ),
    ]


# What a threshold is, with its unit.
_THRESHOLDS = {
    "match_window_s": "matching window of labels and answers, s",
    "stop_speed_mps": "speed that counts as stopped, m/s",
    "accel_mps2": "acceleration that counts as such, m/s²",
    "lateral_shift_m": "lateral shift that counts as such, m",
    "response_gap_s": "longest gap within a response, s",
}


def _what(parameter: str) -> str:
    return _THRESHOLDS.get(parameter, f"weight of {parameter} in IVCS")


def _variations(variations: Iterable[Variation]) -> Table:
    rows = [
        (
            v.subject, v.parameter, _what(v.parameter), v.defined, v.value, v.tau, v.largest,
            "; ".join(f"{behind} passes {ahead}" for ahead, behind in v.changed) or None,
            "; ".join(f"{name} {value:.3f}" for name, value in v.means.items()),
        )
        for v in variations
    ]  # fmt: skip
    return Table(
        "sensitivity",
        "Mean IVCS and ranks with one number of the method changed",
        (
            Column("subject", "ranked", "text"),
            Column("parameter", "parameter", "text", printed=False),
            Column("what", "number", "text"),
            Column("defined", "defined"),
            Column("value", "changed to"),
            Column("tau", "τ"),
            Column("largest", "largest change of a cell"),
            Column("order_changed", "changes of order", "text"),
            Column("mean_ivcs", "mean IVCS then", "text", printed=False),
        ),
        tuple(rows),
        (
            "Each line changes one number that the method fixes and leaves all others: how far do "
            "results depend on it? τ: Kendall's τ_b of the ranks to the defined ones, 1 for the "
            "same order, −1 for the opposite one.",
            "Weights that aren't changed keep their ratios, and the sum stays 1. Thresholds: every "
            "record was scored again; largest change: of the IVCS of one cell.",
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
            Column("allowed", "allowed action", "text"),
            Column("planned", "planned action", "text"),
            Column("reads_as", "curve reads as", "text"),
            Column("shift_m", "shift (m)"),
            Column("curve_m", "from the curve (m)"),
            Column("curvature_per_m", "curvature (1/m)", "curvature"),
        ),
        tuple(rows),
        (
            "In the VUT's own frame, following a curve is a shift to the side, which scoring reads "
            "as a lateral action. shift: of the recorded path within 1.0 s, left positive. curve "
            "reads as: the lateral action that the curve alone would be taken for, beside the ones "
            "that the label allows and the model plans. It changes no score.",
            "A part of a change of lane turns the heading like a curve does; a path alone can't "
            "tell them apart.",
        ),
    )
