"""Statistics as tables, each with what it can't say; first failures by stage (METHOD 6.12)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from ssp_core import __version__
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.score.cell import STAGES
from ssp_eval.score.cli import DISCLAIMER
from ssp_eval.score.metrics import IVCS_FIRST, ivcs_weights
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.bootstrap import Estimate, Group
from ssp_eval.statistics.comparisons import FLIPS, Comparison
from ssp_eval.statistics.domains import DOMAIN_NOTES, FINDING, LABELS_ALONE
from ssp_eval.statistics.resampling import LEVEL, Interval
from ssp_eval.statistics.sensitivity import WeightSamples
from ssp_eval.statistics.statistics import Options, Spread, Stability, Statistics
from ssp_eval.statistics.table import Column, Kind, Table, Value, in_order, to_data
from ssp_eval.statistics.tables.notices import Notice

STAGE_NAMES = dict(
    zip(
        STAGES,
        (
            "output validity",
            "semantics",
            "critical interaction",
            "action commitment",
            "trajectory quality",
            "text–trajectory consistency",
            "risk response",
        ),
        strict=True,
    )
)
NONE = "none"
_COUNTS = (*(Column(key, name, "count") for key, name in STAGE_NAMES.items()),)
_NOTES = (
    "Counts of label times by the first stage of the chain that fails; none: all stages pass.",
)


def failures_by_cell(cells: Sequence[CellData]) -> Table:
    """Return every scored cell in the order given, controls too."""
    rows: tuple[tuple[Value, ...], ...] = tuple(
        (cell.scenario, cell.domain, cell.model, cell.score.n, *_counts(cell))
        for cell in cells
        if cell.score is not None
    )
    keys = (Column(key, key, "text") for key in ("scenario", "domain", "model"))
    return Table("first_failures", "First failures of each cell", _columns(*keys), rows, _NOTES)


def failures_by_model(cells: Sequence[CellData]) -> Table:
    """Return every model and control over all its scored cells, controls last."""
    groups: dict[tuple[bool, str], list[CellData]] = {}
    for cell in cells:
        if cell.score is not None:
            groups.setdefault((cell.is_control, cell.model), []).append(cell)
    rows: list[tuple[Value, ...]] = []
    for (_, model), group in sorted(groups.items()):
        counts = [_counts(cell) for cell in group]
        labels = sum(cell.score.n for cell in group if cell.score is not None)
        rows.append((model, len(group), labels, *map(sum, zip(*counts, strict=True))))
    keys = (Column("model", "model", "text"), Column("cells", "cells", "count"))
    return Table(
        "first_failures_model", "First failures of each model", _columns(*keys), tuple(rows), _NOTES
    )


def _columns(*keys: Column) -> tuple[Column, ...]:
    return (*keys, Column("n", "labels", "count"), *_COUNTS, Column(NONE, "none", "count"))


def _counts(cell: CellData) -> tuple[int, ...]:
    """Count the failures per stage, and the labels that pass all."""
    if cell.score is None:
        return ()
    failures = [cell.score.details.first_failures[stage] for stage in STAGES]
    return (*failures, cell.score.n - sum(failures))


# Below this many items an interval says little; the tables point it out.
FEW = 6
METRICS_NOTE = (
    "All scores lie between 0 and 1; higher is better. ivcs: their weighted sum; jovr: share of "
    "labels with a valid text and trajectory; sem_acc_eff: what the text says about the scene is "
    "right; cia_eff: object, position and motion of the critical object are all right; tqsr: the "
    "trajectory is feasible and its action allowed; rsr: the model responds to the risk."
)
_N = Column("n", "n", "count")
_UNIT = Column("unit", "drawn", "text")
_INTERVAL = (
    Column("value", "value"),
    Column("low", "95 % low"),
    Column("high", "95 % high"),
    Column("bca_low", "BCa low"),
    Column("bca_high", "BCa high"),
    Column("bias", "bias"),
    Column("null_share", "null"),
    _UNIT,
    _N,
)
_ENDS_NOTE = (
    "95 %: percentile interval of the resamples, expanded for the small number of units; BCa: "
    "the same, corrected for bias and skewness."
)
_FEW_NOTE = (
    f"With fewer than {FEW} units an interval rests on very little data; read it as a description."
)


def words(*keys: str) -> tuple[Column, ...]:
    """Return columns of text with these keys."""
    return tuple(Column(key, key.replace("_", " "), "text") for key in keys)


def _interval(estimate: Estimate) -> tuple[Value, ...]:
    return (
        estimate.value,
        estimate.percentile.low,
        estimate.percentile.high,
        estimate.bca.low,
        estimate.bca.high,
        estimate.bias,
        estimate.null_share,
        estimate.unit,
        estimate.n,
    )


def _ends(interval: Interval) -> tuple[Value, Value]:
    return interval.low, interval.high


def _few(counts: Iterable[int]) -> list[str]:
    return [_FEW_NOTE] if any(0 < count < FEW for count in counts) else []


def cells_over_records(
    cells: Mapping[tuple[str, ...], Mapping[str, Estimate]], resamples: int
) -> Table:
    """Return every cell, metric by metric."""
    rows = [
        (*key, metric, *_interval(estimates[metric]))
        for key, estimates in cells.items()
        for metric in IVCS_FIRST
    ]
    return Table(
        "intervals_cells",
        "Scores of cells, with intervals over their labels",
        (*words("scenario", "domain", "model", "run", "metric"), *_INTERVAL),
        tuple(rows),
        (
            f"How far a score depends on which moments of the clip were labelled: {resamples} "
            "resamples of the labels of a cell, neighbours drawn together in blocks, since they "
            "resemble each other; n counts labels.",
            _ENDS_NOTE,
            "A label keeps the response that begins with it. A cell without a response has none "
            "in any resample, so its interval for rsr is a point and says nothing.",
            "bias: mean of the resamples minus the value. null: share of the resamples without a "
            "denominator.",
            METRICS_NOTE,
            *_few(estimates["ivcs"].n for estimates in cells.values()),
        ),
    )


def _group_names(by: Group, key: Group) -> tuple[str, str]:
    return " × ".join(by), " / ".join(key)


def groups_over_records(
    groups: Mapping[Group, Mapping[Group, Mapping[str, Estimate]]], resamples: int
) -> Table:
    """Return means by group, each cell's labels resampled."""
    rows = [
        (*_group_names(by, key), metric, *_interval(one)[:3], one.bias, one.unit, one.n)
        for by, by_key in groups.items()
        for key, estimates in sorted(by_key.items(), key=lambda g: in_order(g[0]))
        for metric in IVCS_FIRST
        for one in [estimates[metric]]
    ]
    return Table(
        "intervals_groups",
        "Means over cells, with intervals over their labels",
        (*words("grouping", "group", "metric"), *_INTERVAL[:3], _INTERVAL[5], _UNIT, _N),
        tuple(rows),
        (
            f"{resamples} resamples of the labels within each cell, in blocks of neighbours, the "
            "same ones for all models and runs of a scenario and domain; n counts cells.",
            "The cells stay as they are: the interval says how far the mean depends on which "
            "label times were taken, not what other scenarios or runs would give.",
            _ENDS_NOTE,
            METRICS_NOTE,
        ),
    )


def over_cells(groups: Mapping[Group, Mapping[Group, Sequence[Estimate]]], resamples: int) -> Table:
    """Return mean IVCS by group, the cells resampled, and whole scenarios of them."""
    rows = [
        (*_group_names(by, key), *_interval(one)[:5], *_ends(one.student), one.unit, one.n)
        for by, estimates in groups.items()
        for key, ones in sorted(estimates.items(), key=lambda g: in_order(g[0]))
        for one in ones
    ]
    return Table(
        "intervals_over_cells",
        "Mean IVCS, with intervals over cells and over scenarios",
        (
            *words("grouping", "group"),
            *_INTERVAL[:5],
            Column("student_low", "Student low"),
            Column("student_high", "Student high"),
            _UNIT,
            _N,
        ),
        tuple(rows),
        (
            f"How far a mean depends on which cells there are: {resamples} resamples of the cells "
            "of a group, or of its scenarios with all their cells; n counts what is drawn.",
            "Cells of one scenario show the same event and are not independent, so the interval "
            "over scenarios is the one to read where it is wider. Both treat the units drawn as "
            "a random sample, which scenarios chosen by hand are not.",
            _ENDS_NOTE,
            "Student: over the same units, assumed normal; it may extend beyond 0 to 1. With few "
            "units read this one: resamples of two units never leave the range between them.",
            *_few(one.n for by_key in groups.values() for ones in by_key.values() for one in ones),
        ),
    )


def runs_table(stability: Stability) -> Table:
    """Tabulate scores over K runs: macro means first, then cells."""

    def row(kind: str, spread: Spread) -> tuple[Value, ...]:
        return (
            kind,
            " / ".join(spread.names),
            spread.metric,
            spread.k,
            spread.value,
            spread.sd,
            spread.low,
            spread.high,
            spread.interval.low,
            spread.interval.high,
            spread.bootstrap.percentile.low,
            spread.bootstrap.percentile.high,
        )

    columns = (
        *words("of", "name", "metric"),
        Column("k", "K", "count"),
        Column("mean", "mean"),
        Column("sd", "sd"),
        Column("min", "min"),
        Column("max", "max"),
        Column("low", "95 % low"),
        Column("high", "95 % high"),
        Column("bootstrap_low", "bootstrap low"),
        Column("bootstrap_high", "bootstrap high"),
    )
    notes = [
        "How far repetitions of the same cells differ; the units drawn are runs. K: their number; "
        "sd: their standard deviation (K − 1). 95 %: Student's interval of the mean over runs, "
        "which may extend beyond 0 to 1; bootstrap: expanded percentile interval over the runs.",
        f"Macro means and ranks are of the {len(stability.runs)} runs that have the same cells.",
        *_few(spread.k for spread in stability.cells),
    ]
    if stability.tau is not None and stability.same_order is not None:
        notes.append(
            f"Ranks of models between two runs: Kendall's τ {stability.tau:.3f} on average (1: the "
            f"same order, −1: the opposite one); the same order in {stability.same_order:.0%} of "
            "the pairs of runs."
        )
    notes.append(METRICS_NOTE)
    rows = [row("macro", one) for one in stability.macro] + [
        row("cell", one) for one in stability.cells
    ]
    return Table("stability", "Stability over runs", columns, tuple(rows), tuple(notes))


def statistics_tables(statistics: Statistics, resamples: int) -> list[Table]:
    """Return all tables that there is something to show in, most general first."""
    tables = []
    if statistics.records is not None:
        tables.append(groups_over_records(statistics.records.groups, resamples))
        tables.append(cells_over_records(statistics.records.cells, resamples))
    tables.append(over_cells(statistics.over_cells, resamples))
    tables.append(comparison_table(statistics.comparisons))
    tables += [table for one in statistics.weights for table in _weights(one)]
    if statistics.runs is not None:
        tables.append(runs_table(statistics.runs))
    return tables


def comparison_table(comparisons: Iterable[Comparison]) -> Table:
    """Return paired comparisons, with what so few pairs can't show."""
    listed = list(comparisons)
    rows = [
        (
            c.subject,
            c.first,
            c.second,
            c.metric,
            c.n,
            c.difference,
            c.interval.low,
            c.interval.high,
            c.labels_alone,
            c.finding,
            c.over_labels.low,
            c.over_labels.high,
            c.standardised,
            c.favour,
            c.scenarios,
            c.p_scenarios,
            c.p_scenarios_holm,
            c.p,
            c.p_holm,
            c.p_least,
            c.family or None,
        )
        for c in listed
    ]
    difference: tuple[tuple[str, str, Kind], ...] = (
        ("difference", "difference", "ratio"),
        ("low", "95 % low", "ratio"),
        ("high", "95 % high", "ratio"),
    )
    numbers: tuple[tuple[str, str, Kind], ...] = (
        ("labels_low", "labels low", "ratio"),
        ("labels_high", "labels high", "ratio"),
        ("d_z", "d_z", "ratio"),
        ("ahead", "ahead", "ratio"),
        ("scenarios", "scenarios", "count"),
        ("p_scenarios", "p (scenarios)", "p"),
        ("p_scenarios_holm", "p (scenarios, Holm)", "p"),
        ("p", "p", "p"),
        ("p_holm", "p (Holm)", "p"),
        ("p_least", "least p", "p"),
    )
    notes = [
        "Pairs: cells of the same scenario and model for two domains, of the same scenario and "
        "domain for two models. difference: mean of first minus second over the pairs, with "
        "Student's interval over the pairs of two models; ahead: share of pairs in which the first "
        "leads, ties counted half.",
        *(DOMAIN_NOTES if any(c.subject == "domain" for c in listed) else ()),
        "p (scenarios): two-sided, from flipping the signs of ivcs of all pairs of a scenario "
        "together at random. It comes first, since it alone keeps its size where scenarios matter "
        "and applies to other scenarios too; the Holm-corrected value stands beside it.",
        "p: the same, from flipping the sign of each pair on its own. Pairs of a scenario share "
        "its event, but p treats them as independent and applies to these recordings only. p "
        "(Holm) is corrected over all comparisons of domains together, and over all of models "
        f"together. {_families(listed)} Components are described but not tested. There is no p "
        "with fewer than two pairs. least p: what p would be if all differences had the same sign.",
        *_over_labels(listed),
        METRICS_NOTE,
        *_powerless(listed),
    ]
    if any(c.p is not None and not c.exact for c in listed):
        notes.append(f"With many pairs, {FLIPS} sign patterns were drawn at random instead of all.")
    return Table(
        "comparisons",
        "Paired comparisons",
        (
            *words("subject", "first", "second", "metric"),
            Column("n", "pairs", "count"),
            *(Column(key, title, kind) for key, title, kind in difference),
            LABELS_ALONE,
            FINDING,
            *(Column(key, title, kind, printed=key != "d_z") for key, title, kind in numbers),
            Column("family", "family", "count", printed=False),
        ),
        tuple(rows),
        tuple(notes),
    )


def _over_labels(comparisons: Iterable[Comparison]) -> list[str]:
    if not any(c.over_labels.low is not None for c in comparisons):
        return []
    return [
        "labels: 95 % interval of two models' difference over the labels of the clips that both "
        "have, the same ones drawn for both, in blocks of neighbours. It says how far the "
        "difference depends on which moments were labelled, even with one clip, and nothing about "
        "other clips."
    ]


def _families(comparisons: Sequence[Comparison]) -> str:
    counts = {c.subject: c.family for c in comparisons if c.family}
    listed = ", ".join(f"{count} of {subject}s" for subject, count in sorted(counts.items()))
    return f"Comparisons tested: {listed or 'none'}."


def _powerless(comparisons: Iterable[Comparison]) -> list[str]:
    """List comparisons in which even the clearest result misses p = 0.05 after correction."""
    notes = []
    for subject in ("domain", "model"):
        tested = [c for c in comparisons if c.subject == subject and c.p_least is not None]
        if not tested:
            continue
        if all((c.p_least or 0.0) * c.family > 0.05 for c in tested):
            notes.append(
                f"No comparison of {subject}s can have p (Holm) below 0.05 with so few pairs, "
                "however clear the difference: a large p is no evidence of equality."
            )
    return notes


def _weights(samples: WeightSamples) -> list[Table]:
    pairs = tuple(
        (one.first, one.second, "yes" if one.tied else "", one.share) for one in samples.pairs
    )
    firsts = tuple(sorted(samples.first.items(), key=lambda one: (-one[1], one[0])))
    tau = (
        "Kendall's τ to the defined ranks: not defined, all are equal."
        if samples.tau_mean is None or samples.tau_low is None
        else f"Kendall's τ to the defined ranks (1: the same order, −1: the opposite one): mean "
        f"{samples.tau_mean:.3f}, 5 % quantile {samples.tau_low:.3f}."
    )
    weights = ", ".join(f"{weight:.2f} {name}" for name, weight in ivcs_weights().items())
    sampling_note = (
        f"IVCS is a weighted sum ({weights}). Here {samples.samples} other sets of weights were "
        "tried, drawn uniformly from all that are ≥ 0 and sum to 1."
    )
    return [
        Table(
            f"weights_{samples.subject}_order",
            f"Does the order of {samples.subject}s hold under other weights of IVCS?",
            (*words("ahead", "behind", "tied"), Column("held", "order holds (share)")),
            pairs,
            (
                sampling_note,
                "ahead and behind: as with the defined weights; tied: equal under the defined "
                "weights, and the share is that of weights under which they stay equal.",
                tau,
            ),
        ),
        Table(
            f"weights_{samples.subject}_first",
            f"Which {samples.subject} leads under other weights of IVCS?",
            (*words(samples.subject), Column("share", "leads (share)")),
            firsts,
            (sampling_note, "Where several tie for first, each of them leads."),
        ),
    ]


STATISTICS_FILE = "statistics.json"
STATISTICS_SCHEMA = "ssp.statistics/2"


def write_statistics(
    folder: Path,
    tables: Iterable[Table],
    options: Options,
    notices: Sequence[Notice] = (),
    thresholds: str = "",
) -> Path:
    """Write ``statistics.json``: all digits of the statistics, and their settings.

    Args:
        folder: made if it isn't there.
        tables: of the statistics.
        options: seed, resamples and block.
        notices: what must be known before reading them.
        thresholds: hash of those of the cells; empty: METHOD's.
    """
    path = make_folder(folder) / STATISTICS_FILE
    write_json(
        path,
        {
            "schema": STATISTICS_SCHEMA,
            "seed": options.seed,
            "resamples": options.resamples,
            "block_labels": options.block,
            "level": LEVEL,
            "thresholds": thresholds or DEFAULT.sha256,
            "software": f"ssp {__version__}",
            "note": DISCLAIMER,
            "notices": [asdict(notice) for notice in notices],
            "tables": [to_data(table) for table in tables],
        },
    )
    return path
