"""What ``ssp report --figures`` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from ssp_core import console
from ssp_eval.analysis.row import CellRow
from ssp_eval.figures.write import GROUPS, Written, write_figures
from ssp_eval.report.load import CellData

OVERLAYS = "overlays"
CHOICES = (*GROUPS, OVERLAYS)
# Overlays of more cells take minutes, and are drawn when they are asked for by name.
MOST_OVERLAID = 24


@dataclass(frozen=True)
class WantedFigures:
    """What was asked for.

    Args:
        folder: to write to.
        reference: model that others are compared to, None: the best by IVCS.
        only: some of CHOICES; empty: all.
    """

    folder: Path
    reference: str | None
    only: Sequence[str]


def draw_figures(
    wanted: WantedFigures,
    rows: Sequence[CellRow],
    campaign: Path | None = None,
    cells: Sequence[CellData] = (),
) -> None:
    """Writes figures and overlays and says what was left out, and why.

    Args:
        wanted: what was asked for.
        rows: all cells.
        campaign: whose frames the overlays are drawn on; None: there are none.
        cells: of the campaign.

    Raises:
        InputError: the reference is no model, or a file can't be read or written.
    """
    groups = [name for name in wanted.only if name in GROUPS]
    left_out: list[tuple[str, str]] = []
    files = 0
    with console.progress("figures", None) as bar:

        def advance(name: str) -> None:
            bar.update(bar.task_ids[0], advance=1, description=name)

        for written in _steps(wanted, groups, rows, campaign, cells, advance):
            files += len(written.files)
            left_out += written.left_out
    for name, reason in left_out:
        console.note(f"{name}: not drawn: {reason}")
    click.echo(f"{wanted.folder} ({files} files)")


def _steps(
    wanted: WantedFigures,
    groups: Sequence[str],
    rows: Sequence[CellRow],
    campaign: Path | None,
    cells: Sequence[CellData],
    advance: Callable[[str], None],
) -> list[Written]:
    done = []
    if groups or not wanted.only:
        done.append(write_figures(rows, wanted.folder, wanted.reference, groups, advance))
    if campaign is None or (wanted.only and OVERLAYS not in wanted.only):
        return done
    scored = sum(cell.score is not None and not cell.is_control for cell in cells)
    if not wanted.only and scored > MOST_OVERLAID:
        why = f"{scored} cells take minutes; ask for them with --only {OVERLAYS}"
        return [*done, Written((), ((OVERLAYS, why),))]
    # Pictures need OpenCV and PyAV, which figures of a CSV file do without.
    from ssp_eval.figures.overlays import write_overlays

    return [*done, write_overlays(campaign, wanted.folder, advance, cells)]
