"""A repeated run compared with the original: it is identical, or no valid result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.reading import read_json
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.closed_loop.outcomes.outcome import CHAIN, HARNESS
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS, Row, cell

_REMEDY = "remove it, and the run is held against nothing"
_ABORTED = Verdict.ABORTED.name.lower()
# Columns of runs.csv that result.json says, too, in the order in which people are told of them.
_COMPARED = (
    *("outcome", "outcome_s", "why", "needless", "v_i_mps", "severity"),
    *CHAIN,
    *("unled_s", "starved", "states_sha256"),
)


@dataclass(frozen=True, slots=True)
class Before:
    """The run that is driven again, as it was.

    Args:
        place: file, and row, for people.
        cells: by column of ``runs.csv``.
    """

    place: str
    cells: Mapping[str, str]

    def difference(self, summary: Mapping[str, Any]) -> str:
        """Say what of a run isn't as it was before; empty: it is the same run.

        Args:
            summary: what ``result.json`` says of who drove it.
        """
        now = _cells_of(summary)
        parts = [
            f"{name} is {now[name] or 'none'} and was {self.cells[name] or 'none'}"
            for name in _COMPARED
            if now[name] != self.cells[name]
        ]
        return f"it isn't the run of {self.place}: {'; '.join(parts)}" if parts else ""

    def judge(self, summary: Mapping[str, Any]) -> tuple[dict[str, Any], str]:
        """Return what ``result.json`` says of a run that must be the same, and why it isn't.

        Args:
            summary: of who drove it.
        """
        why = self.difference(summary)
        return dict(summary) | (failed_for(why) if why else {}), why


def failed_for(why: str) -> dict[str, Any]:
    """Return the entries of ``result.json`` for a harness failure."""
    return {"outcome": HARNESS, "why": why, "severity": None}


def before_of_row(path: Path, number: int, row: Row) -> Before | None:
    """Return what a row of a campaign says of its run; None after a harness failure.

    Args:
        path: of ``runs.csv``.
        number: of the row, from 1.
        row: its cells.
    """
    cells = dict(zip(RUN_COLUMNS, row, strict=True))
    return None if cells["outcome"] == HARNESS else Before(f"row {number} of {path}", cells)


def before_of_folder(folder: Path) -> Before | None:
    """Return what a run's folder says of it; None without an end, or after a harness failure.

    None, too, for a session of several processes that an operator aborted: no run repeats that.

    Raises:
        InputError: its ``result.json`` is damaged, or is that of no driven run of this version.
    """
    path = folder / RESULT_FILE
    if not path.exists():
        return None
    result = read_json(path, _REMEDY)
    try:
        cells = _cells_of(result["driven"])
        is_aborted = result["verdict"] == _ABORTED and not result["in_process"]
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        why = f"it lacks {error}" if isinstance(error, KeyError) else error
        raise InputError(
            f"doesn't say what the run was: {why}", file=path, remedy=_REMEDY
        ) from error
    return None if is_aborted or cells["outcome"] == HARNESS else Before(str(path), cells)


def _cells_of(summary: Mapping[str, Any]) -> dict[str, str]:
    fields = {**summary, **summary["chain"]}
    return {name: cell(fields[name]) for name in _COMPARED}
