"""Means, ranks and first failures as tables of text (METHOD 6.12, 6.13)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.vocab import DOMAINS
from ssp_eval.evaluate.admission import ADMITTED
from ssp_eval.report.load import CellData
from ssp_eval.score import STAGES
from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    Cell,
    Mean,
    Ranking,
    means,
    ranking,
)
from ssp_eval.score.show import NULL

MEAN_COLUMNS = (
    ("jovr", "JOVR"),
    ("sem_acc_eff", "SemAcc"),
    ("cia_eff", "CIA"),
    ("tqsr", "TQSR"),
    ("rsr", "RSR"),
    ("rl_s", "RL (s)"),
    ("ivcs", "IVCS"),
    ("act_acc_eff", "ActAcc"),
    ("stfr", "STFR"),
    ("atc_eff", "ATC"),
)
_GROUPINGS = (
    ("By model", BY_MODEL),
    ("By domain", BY_DOMAIN),
    ("By scenario and domain", BY_SCENARIO_DOMAIN),
    ("By scenario and model", BY_SCENARIO_MODEL),
)
# Of more scenarios than these there are too many pairs to read.
_MOST_PAIRED = 6
STAGE_NAMES = dict(
    zip(
        STAGES,
        (
            "output validity", "semantics", "critical interaction", "action commitment",
            "trajectory quality", "text–trajectory consistency", "risk response",
        ),
        strict=True,
    )
)  # fmt: skip


@dataclass(frozen=True)
class MeanCell:
    """One mean: text, the share of a bar behind it, and n where it differs from the row's."""

    text: str
    bar: float | None
    n: str


@dataclass(frozen=True)
class MeanRow:
    """One group of cells."""

    keys: tuple[str, ...]
    n: int
    values: tuple[MeanCell, ...]


@dataclass(frozen=True)
class MeanTable:
    """One grouping, and how many cells it leaves out because the audit didn't admit them."""

    title: str
    keys: tuple[str, ...]
    rows: tuple[MeanRow, ...]
    left_out: int


def scored(cells: Sequence[CellData]) -> list[Cell]:
    """The cells that may enter means: valid ones, controls left out.

    Those that the audit didn't admit say so, and enter no domain mean (METHOD 4).
    """
    return [
        Cell(c.scenario, c.domain, c.model, c.score.to_json(), c.admission == ADMITTED)
        for c in cells
        if c.score is not None and not c.is_control
    ]


def mean_tables(cells: Sequence[Cell]) -> list[MeanTable]:
    """The groupings of METHOD 6.13, n with each mean."""
    tables = []
    for title, keys in _GROUPINGS:
        left_out = sum(not cell.admitted for cell in cells) if "domain" in keys else 0
        tables.append(MeanTable(title, keys, mean_rows(cells, keys), left_out))
    return tables


def mean_rows(cells: Sequence[Cell], keys: Sequence[str]) -> tuple[MeanRow, ...]:
    """One grouping as rows."""
    rows = []
    for group, by_metric in sorted(means(cells, keys).items(), key=lambda g: _order(g[0])):
        n = by_metric["ivcs"].n
        values = tuple(_mean_cell(by_metric[key], n, key) for key, _ in MEAN_COLUMNS)
        rows.append(MeanRow(group, n, values))
    return tuple(rows)


def _order(group: tuple[str, ...]) -> list[tuple[int, str]]:
    """Domains in their own order, everything else by name."""
    return [(DOMAINS.index(key) if key in DOMAINS else len(DOMAINS), key) for key in group]


def _mean_cell(found: Mean, n: int, key: str) -> MeanCell:
    if found.value is None:
        return MeanCell(NULL, None, "")
    digits = 2 if key == "rl_s" else 3
    bar = None if key == "rl_s" else min(max(found.value, 0.0), 1.0)
    return MeanCell(f"{found.value:.{digits}f}", bar, f"n={found.n}" if found.n != n else "")


@dataclass(frozen=True)
class RankTable:
    """Ranks of models or domains by IVCS, per scenario and over all; who lacks which cells."""

    title: str
    subject: str
    scenarios: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]
    changes: tuple[str, ...]
    uneven: str


def rank_tables(cells: Sequence[Cell]) -> list[RankTable]:
    """Ranks per scenario and for the macro average, with every change between scenarios."""
    tables = []
    for title, subject in (("Models", "model"), ("Domains", "domain")):
        found = ranking(cells, subject)
        if len(found.macro) < 2:
            continue
        scenarios = tuple(sorted(found.scenarios))
        rows = []
        for name in sorted(found.macro, key=lambda n: (found.macro[n] or 99, n)):
            columns = [found.scenarios[scenario].get(name) for scenario in scenarios]
            ranks = tuple(NULL if r is None else str(r) for r in (*columns, found.macro[name]))
            rows.append((name, ranks))
        changes = _change_lines(found)
        uneven = _uneven(cells, subject)
        tables.append(RankTable(title, subject, scenarios, tuple(rows), changes, uneven))
    return tables


def _uneven(cells: Sequence[Cell], subject: str) -> str:
    """Who lacks cells that another has: ranks then compare means over different cells."""
    other = "domain" if subject == "model" else "model"
    over: dict[str, set[tuple[str, str]]] = {}
    for cell in cells:
        if cell.admitted or subject != "domain":
            one = cell.scenario, getattr(cell, other)
            over.setdefault(getattr(cell, subject), set()).add(one)
    every = {one for found in over.values() for one in found}
    return ", ".join(
        f"{name} {len(found)} of {len(every)}"
        for name, found in sorted(over.items())
        if found != every
    )


def _change_lines(found: Ranking) -> tuple[str, ...]:
    """Every change of rank between two scenarios; of many scenarios the range of each subject."""
    if len(found.scenarios) <= _MOST_PAIRED:
        return tuple(
            f"{change.subject}: rank {change.ranks[0]} in {change.scenarios[0]}, "
            f"{change.ranks[1]} in {change.scenarios[1]}"
            for change in found.changes
        )
    lines = []
    for name in dict.fromkeys(change.subject for change in found.changes):
        ranks = [
            (rank, scenario)
            for scenario in sorted(found.scenarios)
            if (rank := found.scenarios[scenario].get(name)) is not None
        ]
        best, worst = min(ranks), max(ranks, key=lambda pair: pair[0])
        lines.append(
            f"{name}: from rank {best[0]} in {best[1]} to {worst[0]} in {worst[1]}, "
            f"{len({rank for rank, _ in ranks})} different ranks in {len(ranks)} scenarios"
        )
    return tuple(lines)


@dataclass(frozen=True)
class ModelFailures:
    """First failures of all records of one model: count and share per stage, and without one."""

    model: str
    cells: int
    counts: tuple[tuple[int, float], ...]
    clean: tuple[int, float]


def failures_by_model(cells: Sequence[CellData]) -> list[ModelFailures]:
    """Per model, how many labels fail first at which stage (METHOD 6.12)."""
    groups: dict[str, list[FailureRow]] = {}
    for row in failure_rows(cells):
        groups.setdefault(row.cell.model, []).append(row)
    found = []
    for model, rows in sorted(groups.items()):
        counts = [sum(row.counts[k][0] for row in rows) for k in range(len(STAGES))]
        clean = sum(row.clean[0] for row in rows)
        total = sum(counts) + clean
        shares = tuple((number, number / total) for number in counts)
        found.append(ModelFailures(model, len(rows), shares, (clean, clean / total)))
    return found


@dataclass(frozen=True)
class FailureRow:
    """First failures of one cell: count and share per stage, and of the records without one."""

    cell: CellData
    counts: tuple[tuple[int, float], ...]
    clean: tuple[int, float]


def failure_rows(cells: Sequence[CellData]) -> list[FailureRow]:
    """Per scored cell, how many labels fail first at which stage (METHOD 6.12)."""
    rows = []
    for cell in cells:
        if cell.score is None:
            continue
        counts = [cell.score.details.first_failures[stage] for stage in STAGES]
        clean = cell.score.n - sum(counts)
        rows.append(
            FailureRow(
                cell,
                tuple((count, count / cell.score.n) for count in counts),
                (clean, clean / cell.score.n),
            )
        )
    return rows
