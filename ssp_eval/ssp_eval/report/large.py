"""The page of a large campaign: rows in the page, the details of each cell in a file beside it.

A browser that opens it from disk may load scripts and pictures, and nothing else: so each cell's
details are a script that hands its HTML to the page when somebody opens the cell.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import jinja2

from ssp_core.files import make_folder, write_text
from ssp_eval.report.load import CellData, KeptAudits, load_cell
from ssp_eval.report.view import record_views, tolerated
from ssp_eval.score import STAGES

FOLDER = Path("report") / "cells"
# In a row's word of stages: 0 to 6 for the stage that fails first, this where none does.
CLEAN = "-"
SCORES = ("ivcs", "jovr", "sem_acc_eff", "cia_eff", "tqsr", "act_acc_eff", "stfr", "atc_eff")


def load_lightly(
    files: Sequence[Path], on_cell: Callable[[CellData], None] = lambda _: None
) -> list[CellData]:
    """Reads cells one by one and keeps of each what the page itself needs.

    Args:
        files: cell.json of each.
        on_cell: given each cell whole, before its records, questions and judgements are dropped.

    Raises:
        InputError: a file is damaged.
    """
    cells = []
    audits = KeptAudits(files[0].parents[2])
    for file in files:
        cell = load_cell(file, audits)
        on_cell(cell)
        cells.append(replace(cell, records=(), asked=()))
    return cells


class DetailFiles:
    """The files with the details of cells, written one by one.

    Args:
        out: campaign folder.
        environment: of the templates.
        audits: path of an audit's page by the audit's hash.
    """

    def __init__(
        self, out: Path, environment: jinja2.Environment, audits: Mapping[str, str]
    ) -> None:
        self._folder = make_folder(out / FOLDER)
        self._template = environment.get_template("details.html.j2")
        self._audits = audits
        self._written: set[str] = set()

    def write(self, cell: CellData) -> None:
        """Writes the details of a cell."""
        html = self._template.render(
            cell=cell, views=record_views(cell), tolerated=tolerated(cell), audits=self._audits
        )
        name = f"{cell.id}.js"
        self._written.add(name)
        write_text(self._folder / name, f"sspCell({json.dumps(cell.id)}, {json.dumps(html)});\n")

    def remove_others(self) -> None:
        """Removes the details of cells that are in the campaign no more."""
        for file in self._folder.glob("*.js"):
            if file.name not in self._written:
                file.unlink()


def rows(cells: Sequence[CellData]) -> dict[str, Any]:
    """What the page's script makes rows of: one list per cell, names by their number."""
    names: dict[str, list[str]] = {
        key: list(dict.fromkeys(getattr(cell, key) for cell in cells))
        for key in ("scenario", "domain", "model")
    }
    number = {key: {name: k for k, name in enumerate(found)} for key, found in names.items()}
    return {
        **names,
        "scores": SCORES,
        "rows": [
            [
                cell.id,
                *(number[key][getattr(cell, key)] for key in names),
                cell.facts.status,
                cell.admission,
                int(cell.is_control),
                _stages(cell),
                None if cell.score is None else [_short(getattr(cell.score, s)) for s in SCORES],
                None if cell.score is None else _short(cell.score.rl_s),
                "; ".join(cell.facts.reasons),
            ]
            for cell in cells
        ],
    }


def _stages(cell: CellData) -> str:
    """Per label, in order, the first stage that fails (METHOD 6.12)."""
    if cell.score is None:
        return ""
    found = (judgement.first_failure for judgement in cell.score.details.judgements)
    return "".join(CLEAN if stage is None else str(STAGES.index(stage)) for stage in found)


def _short(value: float | None) -> float | None:
    """Enough digits to sort by and to show."""
    return None if value is None else round(value, 6)
