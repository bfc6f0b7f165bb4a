"""Writes the page of a campaign: one file with its pictures, or a large one with files beside."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import count
from pathlib import Path

import jinja2

from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_text
from ssp_core.hashing import sha256_file
from ssp_eval.causes.answers import CellAnswers, answers_of_cell, comparable_cells
from ssp_eval.causes.findings import answers_in, compared
from ssp_eval.data.audit import PAGE_FILE as AUDIT_PAGE
from ssp_eval.evaluate.store.admission import audit_files
from ssp_eval.evaluate.store.cell_file import frame_path
from ssp_eval.evaluate.store.results import (
    CellData,
    CellFacts,
    cell_files,
    in_order,
    load_cells,
    load_facts,
)
from ssp_eval.pages import data_uri
from ssp_eval.report.cell_view import record_views, tolerated
from ssp_eval.report.render import Details, environment, load_lightly, render
from ssp_eval.statistics.table import Table
from ssp_eval.statistics.tables.responses import named_audits

PAGE = "index.html"
# Up to here a page holds all details and pictures, some 150 kB a cell; beyond, a browser would
# choke on them. Controls count too: two models on six recordings have sixty cells with them.
MOST_IN_ONE_FILE = 60
# Of the files with the details of cells.
FOLDER = Path("report") / "cells"


class DetailFiles:
    """The files with the details of cells, written one by one."""

    def __init__(
        self, out: Path, environment: jinja2.Environment, audits: Mapping[str, str]
    ) -> None:
        self._folder = make_folder(out / FOLDER)
        self._template = environment.get_template("details.html.j2")
        self._audits = audits
        self._written: set[str] = set()

    def write(self, cell: CellData) -> None:
        """Write the details of a cell."""
        html = self._template.render(
            cell=cell, views=record_views(cell), tolerated=tolerated(cell), audits=self._audits
        )
        name = f"{cell.id}.js"
        self._written.add(name)
        write_text(self._folder / name, f"sspCell({json.dumps(cell.id)}, {json.dumps(html)});\n")

    def remove_others(self) -> None:
        """Remove the details of cells that are in the campaign no more."""
        for file in self._folder.glob("*.js"):
            if file.name not in self._written:
                file.unlink()


def write_report(
    out: Path,
    on_step: Callable[[int, int], None] = lambda _done, _of: None,
    most: int | None = None,
    analysis: Sequence[Table] = (),
    on_cell: Callable[[CellData], None] = lambda _cell: None,
    repeated: Sequence[CellAnswers] = (),
    expected: Sequence[str] = (),
    carried: str = "",
) -> Path:
    """Write ``index.html`` into a campaign folder, and for a large one files beside it.

    Args:
        out: campaign folder.
        on_step: called with how many pictures or cells are done, and of how many.
        most: cells up to which everything goes into the one file; None: MOST_IN_ONE_FILE.
        analysis: tables of the statistics.
        on_cell: given each cell once, whole.
        repeated: answers of other campaigns, which count for what moved those of this one.
        expected: scenarios that the campaign was planned with; one without a cell is named.
        carried: options that the page was made with, as JSON; empty: it carries none.

    Returns:
        The page.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    files = cell_files(out)
    if len(files) <= (MOST_IN_ONE_FILE if most is None else most):
        cells = load_cells(out)
        for cell in cells:
            on_cell(cell)
        return _write_one(out, cells, on_step, analysis, repeated, expected, carried)
    return _write_large(out, files, on_step, analysis, on_cell, repeated, expected, carried)


def _write_one(
    out: Path,
    cells: list[CellData],
    on_step: Callable[[int, int], None],
    analysis: Sequence[Table],
    repeated: Sequence[CellAnswers],
    expected: Sequence[str],
    carried: str,
) -> Path:
    views = {cell.id: record_views(cell) for cell in cells}
    used = sorted({v.frame for of_cell in views.values() for v in of_cell if v.frame is not None})
    pictures: dict[str, str] = {}
    for number, frame in enumerate(used, start=1):
        path = frame_path(out, frame)
        if path.exists() and sha256_file(path) == frame:
            pictures[frame] = data_uri(path)
        on_step(number, len(used))
    target = make_folder(out) / PAGE
    audits = audit_pages(out, (cell.facts for cell in cells))
    cell_audits = named_audits([out], (cell.facts for cell in cells))
    moved = compared([*answers_in(cells), *repeated])
    details = Details(views, pictures)
    write_text(
        target, render(cells, details, audits, analysis, cell_audits, moved, expected, carried)
    )
    return target


def _write_large(
    out: Path,
    files: list[Path],
    on_step: Callable[[int, int], None],
    analysis: Sequence[Table],
    on_cell: Callable[[CellData], None],
    repeated: Sequence[CellAnswers],
    expected: Sequence[str],
    carried: str,
) -> Path:
    """Write the details cell by cell, so that memory holds one cell's pictures of words."""
    audits = audit_pages(out, (load_facts(file) for file in files))
    cell_audits = named_audits([out], (load_facts(file) for file in files))
    details = DetailFiles(out, environment(), audits)
    counter = count(1)
    cell_ids = comparable_cells(file.parent.name for file in files)
    changed: list[CellAnswers] = []

    def write(cell: CellData) -> None:
        details.write(cell)
        on_cell(cell)
        if cell.id in cell_ids and (one := answers_of_cell(cell)) is not None:
            changed.append(one)
        on_step(next(counter), len(files))

    cells = in_order(load_lightly(files, write))
    target = make_folder(out) / PAGE
    moved = compared([*changed, *repeated])
    write_text(target, render(cells, None, audits, analysis, cell_audits, moved, expected, carried))
    details.remove_others()
    return target


def audit_pages(out: Path, cells: Iterable[CellFacts]) -> dict[str, str]:
    """Return pages of the audits that the cells go by, where they lie in the campaign folder.

    Returns:
        Path from the report by hash of the audit, those of the first scenario first.
    """
    pages = {}
    digests = dict.fromkeys(cell.admission.audit_sha256 for cell in cells)
    there = {digest: file.with_name(AUDIT_PAGE) for digest, file in audit_files(out).items()}
    for digest in digests:
        if digest is not None and digest in there and there[digest].is_file():
            pages[digest] = there[digest].relative_to(out).as_posix()
    return pages
