"""``ssp score``: records against labels, folder by folder."""

from __future__ import annotations

import json
import os
from collections import Counter
from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_eval.labels.model import Labels, load_labels
from ssp_eval.records import BehaviourRecord, load_records
from ssp_eval.score.cell import CellScore, score_cell
from ssp_eval.score.show import score_notes, score_table

LABELS_FILES = ("labels.json", "labels.yaml", "labels.yml")
RECORDS_FILE = "records.jsonl"
_WIDEST = 10_000


@click.command()
@click.argument(
    "case_dirs", metavar="CASE_DIR...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--json", "as_json", is_flag=True, help="One line of JSON per folder.")
def score(case_dirs: tuple[Path, ...], as_json: bool) -> None:
    """Score records against labels (METHOD 5 and 6).

    Each CASE_DIR holds labels.json (or .yaml) and records.jsonl. The folders come out sorted by
    name. With --json a line has the key case (the folder's name; its path as given where several
    folders share a name), the keys of METHOD 6.14, and thresholds_sha256. If any file of any
    folder is wrong, nothing is scored.
    """
    loaded = [(case, *_load(folder)) for case, folder in _cases(case_dirs)]
    for case, _, records in loaded:
        if not records:
            console.note(f"note: {case}: {RECORDS_FILE} holds no record; every output is missing")
    scored = [(case, score_cell(labels, records)) for case, labels, records in loaded]
    if as_json:
        for case, cell in scored:
            click.echo(json.dumps(_line(case, cell), allow_nan=False))
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
    named = sorted((Path(os.path.abspath(folder)).name, str(folder), folder) for folder in folders)
    count = Counter(name for name, _, _ in named)
    return [(given if count[name] > 1 else name, folder) for name, given, folder in named]


def _load(folder: Path) -> tuple[Labels, tuple[BehaviourRecord, ...]]:
    """Labels and records of a folder.

    Raises:
        InputError: the folder or a file is missing or wrong.
    """
    if not folder.is_dir():
        raise InputError("is no folder", file=folder, remedy="give folders with labels and records")
    present = [folder / name for name in LABELS_FILES if (folder / name).exists()]
    if len(present) > 1:
        names = ", ".join(path.name for path in present)
        raise InputError(f"holds several labels files: {names}", file=folder, remedy="leave one")
    labels = load_labels(present[0] if present else folder / LABELS_FILES[0])
    return labels, load_records(folder / RECORDS_FILE)


def _line(case: str, cell: CellScore) -> dict[str, object]:
    return {
        "case": case,
        **cell.to_json(),
        "thresholds_sha256": cell.details.thresholds_sha256,
    }
