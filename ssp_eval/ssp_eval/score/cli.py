"""``ssp score``: records against labels, and how scores are written for people."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from rich.table import Table
from rich.text import Text

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import check_folder
from ssp_eval.score.columns import load_columns
from ssp_eval.score.engine import score_columns
from ssp_eval.score.metrics import COMPONENTS, RATIOS, CellMetrics
from ssp_eval.score.thresholds import (
    OTHER_THRESHOLDS,
    Thresholds,
    changes,
    load_thresholds,
    thresholds_option,
)

NULL = "–"
DISCLAIMER = "IVCS is no safety certificate."


def format_ratio(value: float | None) -> str:
    """Return three decimals, ``–`` for null (METHOD 6.11)."""
    return NULL if value is None else f"{value:.3f}"


def format_response(rsr: int, rl_s: float | None) -> str:
    """Return ``S@1.50`` with the latency in seconds, or ``F`` (METHOD 6.9)."""
    return f"S@{rl_s:.2f}" if rsr and rl_s is not None else "F"


@dataclass(frozen=True)
class ScoredCase:
    """A case and its scores."""

    name: str
    records: int
    metrics: CellMetrics

    @property
    def nulls(self) -> list[str]:
        """Components that are null and count as 0 in IVCS (METHOD 6.11)."""
        return [name for name in COMPONENTS if getattr(self.metrics, name) is None]


def score_table(cases: Sequence[ScoredCase]) -> Table:
    """Return the scores of several cells; ``*`` marks an IVCS with a null component as 0."""
    table = Table(title="Scores per cell (METHOD 6)")
    table.add_column("case", no_wrap=True)
    table.add_column("matched", justify="right", no_wrap=True)
    for heading in (*(metric.label for metric in RATIOS), "response", "IVCS"):
        table.add_column(heading, justify="right", no_wrap=True)
    for case in cases:
        score = case.metrics
        flag = "*" if case.nulls else ""
        table.add_row(
            Text(case.name),
            f"{score.matched}/{score.n}",
            *(format_ratio(getattr(score, metric.name)) for metric in RATIOS),
            format_response(score.rsr, score.rl_s),
            format_ratio(score.ivcs) + flag,
        )
    return table


def score_notes(cases: Sequence[ScoredCase]) -> list[str]:
    """Return the lines that belong under the table."""
    notes = [DISCLAIMER]
    for case in cases:
        if case.nulls:
            names = ", ".join(case.nulls)
            notes.append(f"* {case.name}: no denominator for {names}, counted as 0 in IVCS.")
        if unmatched := case.records - case.metrics.matched:
            notes.append(f"{case.name}: records that match no label, ignored: {unmatched}.")
    return notes


LABELS_FILES = ("labels.json", "labels.yaml", "labels.yml")
RECORDS_FILE = "records.jsonl"
_WIDEST = 10_000


@click.command()
@click.argument(
    "case_dirs", metavar="CASE_DIR...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--json", "as_json", is_flag=True, help="One line of JSON per folder.")
@thresholds_option
def score(case_dirs: tuple[Path, ...], as_json: bool, thresholds_file: Path | None) -> None:
    """Score records against labels (METHOD 5 and 6).

    Each CASE_DIR holds labels.json (or .yaml) and records.jsonl. The folders come out sorted by
    name. With --json a line has the key case (the folder's name; its path as given where several
    folders share a name), the keys of METHOD 6.14, and thresholds_sha256. If any file of any
    folder is wrong, nothing is scored.
    """
    thresholds = load_thresholds(thresholds_file)
    cases = _cases(case_dirs)
    files = [_files(folder) for _, folder in cases]
    columns = load_columns(console.tracked(files, "reading cases", len(files)))
    counts = np.diff(columns.record_start).tolist()
    cells = score_columns(columns, thresholds).cells()
    scored = [ScoredCase(name, *one) for (name, _), *one in zip(cases, counts, cells, strict=True)]
    for case in scored:
        if not case.records:
            note = f"{RECORDS_FILE} holds no record; every output is missing"
            console.note(f"note: {case.name}: {note}")
    if changed := changes(thresholds):
        console.note(f"note: {OTHER_THRESHOLDS}: {changed}")
    if as_json:
        for case in scored:
            click.echo(json.dumps(_line(case, thresholds), allow_nan=False))
        return
    table = score_table(scored)
    # A narrow terminal or a pipe gets long lines rather than cut numbers.
    unbounded = console.out.options.update(max_width=_WIDEST)
    table.width = console.out.measure(table, options=unbounded).maximum
    console.out.print(table)
    for note in score_notes(scored):
        console.out.print(note, markup=False)


def _cases(folders: tuple[Path, ...]) -> list[tuple[str, Path]]:
    """Name and folder of each case, sorted by the folders' names."""
    cases = sorted((Path(os.path.abspath(folder)).name, str(folder), folder) for folder in folders)
    count = Counter(name for name, _, _ in cases)
    return [(path_text if count[name] > 1 else name, folder) for name, path_text, folder in cases]


def _files(folder: Path) -> tuple[Path, Path]:
    """Return labels file and records file of a folder.

    Raises:
        InputError: there is no such folder, or it has several labels files.
    """
    check_folder(folder, "give folders with labels and records")
    present = [folder / name for name in LABELS_FILES if (folder / name).exists()]
    if len(present) > 1:
        names = ", ".join(path.name for path in present)
        raise InputError(f"holds several labels files: {names}", file=folder, remedy="leave one")
    return present[0] if present else folder / LABELS_FILES[0], folder / RECORDS_FILE


def _line(case: ScoredCase, thresholds: Thresholds) -> dict[str, object]:
    return {"case": case.name, **case.metrics.to_json(), "thresholds_sha256": thresholds.sha256}
