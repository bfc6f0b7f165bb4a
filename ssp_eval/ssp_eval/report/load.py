"""Reads a campaign's cells for the report and scores them again, for the details behind."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import read_text
from ssp_core.vocab import DOMAINS
from ssp_eval.evaluate.cell import (
    CELL_FILE,
    CELL_SCHEMA,
    CELLS,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    losses_text,
)
from ssp_eval.evaluate.controls import CONTROLS
from ssp_eval.evaluate.store import REQUESTS_FILE
from ssp_eval.labels.model import Labels, load_labels
from ssp_eval.records import BehaviourRecord, load_records
from ssp_eval.score import CellScore, score_cell


@dataclass(frozen=True)
class CellData:
    """One cell as it lies in its folder.

    Args:
        folder: of the cell.
        facts: content of cell.json.
        labels: of the clip.
        records: empty unless the cell has answers.
        requests: what was asked, one per label time.
        score: scored again from records and labels, None unless the cell is ok.
        notes: what a reader must know, one sentence each.
    """

    folder: Path
    facts: dict[str, Any]
    labels: Labels
    records: tuple[BehaviourRecord, ...]
    requests: tuple[dict[str, Any], ...]
    score: CellScore | None
    notes: tuple[str, ...]

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return str(self.facts["scenario"])

    @property
    def domain(self) -> str:
        """Name of the domain."""
        return str(self.facts["domain"])

    @property
    def model(self) -> str:
        """Name of the model."""
        return str(self.facts["model"])

    @property
    def is_control(self) -> bool:
        """True for a bridge that checks the harness."""
        return self.model in CONTROLS

    @property
    def id(self) -> str:
        """Anchor in the page."""
        return self.folder.name


def load_cells(out: Path) -> list[CellData]:
    """All cells of a campaign, by scenario, domain and model.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    files = sorted((out / CELLS).glob(f"*/{CELL_FILE}"))
    if not files:
        raise InputError(
            f"holds no evaluated cells ({CELLS}/*/{CELL_FILE})",
            file=out,
            remedy="give the --out folder of `ssp evaluate`",
        )
    cells = [_load(file) for file in files]
    return sorted(cells, key=lambda c: (c.scenario, _domain_order(c.domain), c.is_control, c.model))


def _domain_order(domain: str) -> int:
    return DOMAINS.index(domain) if domain in DOMAINS else len(DOMAINS)


def _load(file: Path) -> CellData:
    facts = _json(read_text(file), file)
    if facts.get("schema") != CELL_SCHEMA:
        raise InputError(
            f"must have schema {CELL_SCHEMA}", file=file, field="schema", value=facts.get("schema")
        )
    folder = file.parent
    labels = load_labels(folder / LABELS_FILE)
    if facts["status"] != "ok":
        return CellData(folder, facts, labels, (), (), None, ())
    records = load_records(folder / RECORDS_FILE)
    score = score_cell(labels, records)
    notes = []
    stored = _json(read_text(folder / SCORE_FILE), folder / SCORE_FILE)
    if stored != score.to_json():
        notes.append(
            "The stored score differs from what its records and labels give now; this page shows "
            "the latter."
        )
    if facts["hashes"]["thresholds"] != score.details.thresholds_sha256:
        notes.append("It was evaluated with other thresholds than this page uses.")
    # Cells of an earlier version don't tell the kinds apart.
    if losses := losses_text(facts["answers"].get("missing_by_kind", {})):
        notes.append(f"{losses}. They count as missing outputs.")
    requests_file = folder / REQUESTS_FILE
    lines = read_text(requests_file).splitlines()
    requests = tuple(_json(line, requests_file, n) for n, line in enumerate(lines, start=1))
    return CellData(folder, facts, labels, records, requests, score, tuple(notes))


def _json(text: str, file: Path, line: int | None = None) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except ValueError as error:
        raise InputError(f"is no JSON: {error}", file=file, line=line) from error
    if not isinstance(value, dict):
        raise InputError("must be a JSON object", file=file, line=line, value=value)
    return value
