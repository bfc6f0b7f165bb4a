"""Intervals as tables: over labels, over cells and scenarios, over runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from ssp_eval.analysis.bootstrap import Estimate, Group
from ssp_eval.analysis.resample import Interval
from ssp_eval.analysis.stability import Spread, Stability
from ssp_eval.analysis.table import Column, Table, Value
from ssp_eval.analysis.table_columns import in_order

# Below this many items an interval says little; the tables point it out.
FEW = 6
SHOWN = ("ivcs", "jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr")
METRICS_NOTE = (
    "All scores lie between 0 and 1, and more is better. ivcs: their weighted sum; jovr: share of "
    "labels with a valid text and trajectory; sem_acc_eff: what the text says of the scene is "
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
    "95 %: percentile interval of the resamples, expanded for how few units were drawn from; BCa: "
    "the same, corrected for bias and skewness."
)
_FEW_NOTE = (
    f"With fewer than {FEW} units an interval depends on very little; take it as a description."
)


def words(*keys: str) -> tuple[Column, ...]:
    """Columns of text with these keys."""
    return tuple(Column(key, key.replace("_", " "), "text") for key in keys)


def _interval(found: Estimate) -> tuple[Value, ...]:
    return (
        found.value, found.percentile.low, found.percentile.high, found.bca.low, found.bca.high,
        found.bias, found.null_share, found.unit, found.n,
    )  # fmt: skip


def _ends(interval: Interval) -> tuple[Value, Value]:
    return interval.low, interval.high


def _few(counts: Iterable[int]) -> list[str]:
    return [_FEW_NOTE] if any(0 < count < FEW for count in counts) else []


def cells_over_records(
    cells: Mapping[tuple[str, ...], Mapping[str, Estimate]], resamples: int
) -> Table:
    """Every cell, metric by metric."""
    rows = [
        (*key, metric, *_interval(estimates[metric]))
        for key, estimates in cells.items()
        for metric in SHOWN
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
            "bias: mean of the resamples less the value. null: share of the resamples without a "
            "denominator.",
            METRICS_NOTE,
            *_few(estimates["ivcs"].n for estimates in cells.values()),
        ),
    )


def _named(by: Group, key: Group) -> tuple[str, str]:
    return " × ".join(by), " / ".join(key)


def groups_over_records(
    groups: Mapping[Group, Mapping[Group, Mapping[str, Estimate]]], resamples: int
) -> Table:
    """Means by group, each cell's labels resampled."""
    rows = [
        (*_named(by, key), metric, *_interval(one)[:3], one.bias, one.unit, one.n)
        for by, found in groups.items()
        for key, estimates in sorted(found.items(), key=lambda g: in_order(g[0]))
        for metric in SHOWN
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
    """Mean IVCS by group, the cells resampled, and whole scenarios of them."""
    found = [
        (*_named(by, key), *_interval(one)[:5], *_ends(one.student), one.unit, one.n)
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
        tuple(found),
        (
            f"How far a mean depends on which cells there are: {resamples} resamples of the cells "
            "of a group, or of its scenarios with all their cells; n counts what is drawn.",
            "Cells of one scenario show the same event and are not independent, so the interval "
            "over scenarios is the one to read where it is wider. Both take what is drawn for a "
            "random sample, which scenarios chosen by hand are not.",
            _ENDS_NOTE,
            "Student: over the same units, taken for normal; it may reach beyond 0 to 1. With few "
            "units read this one: resamples of two never leave the range between them.",
            *_few(one.n for found in groups.values() for ones in found.values() for one in ones),
        ),
    )


def runs_table(found: Stability) -> Table:
    """Scores over K runs: macro means first, then cells."""

    def row(kind: str, spread: Spread) -> tuple[Value, ...]:
        return (
            kind, " / ".join(spread.names), spread.metric, spread.k, spread.value, spread.sd,
            spread.low, spread.high, spread.interval.low, spread.interval.high,
            spread.bootstrap.percentile.low, spread.bootstrap.percentile.high,
        )  # fmt: skip

    columns = (
        *words("of", "name", "metric"), Column("k", "K", "count"), Column("mean", "mean"),
        Column("sd", "sd"), Column("min", "min"), Column("max", "max"), Column("low", "95 % low"),
        Column("high", "95 % high"), Column("bootstrap_low", "bootstrap low"),
        Column("bootstrap_high", "bootstrap high"),
    )  # fmt: skip
    notes = [
        "How far repetitions of the same cells differ; drawn are runs. K: how many there are; sd: "
        "standard deviation between them (K − 1). 95 %: Student's interval of the mean over runs, "
        "which may reach beyond 0 to 1; bootstrap: expanded percentile interval over the runs.",
        f"Macro means and ranks are of the {len(found.runs)} runs that have the same cells.",
        *_few(spread.k for spread in found.cells),
    ]
    if found.tau is not None and found.same_order is not None:
        notes.append(
            f"Ranks of models between two runs: Kendall's τ {found.tau:.3f} on average (1: the "
            f"same order, −1: the opposite one); the same order in {found.same_order:.0%} of the "
            "pairs of runs."
        )
    notes.append(METRICS_NOTE)
    rows = [row("macro", one) for one in found.macro] + [row("cell", one) for one in found.cells]
    return Table("stability", "Stability over runs", columns, tuple(rows), tuple(notes))
