"""Making a campaign's page, and making it again with the options that it carries."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_mapping, parse_model
from ssp_core.run_file.values import Strict
from ssp_eval.evaluate.store.results import CellData, cell_files, load_cells
from ssp_eval.report.page import write_report
from ssp_eval.statistics.bootstrap import RESAMPLES, SEED
from ssp_eval.statistics.constants import (
    OfScenario,
    constant_rows,
    constants_in,
    constants_of_cells,
)
from ssp_eval.statistics.rows import (
    CellRow,
    apart_across_runs,
    one_scale,
    rows_from_cells,
    without_domains,
)
from ssp_eval.statistics.statistics import Options, compute
from ssp_eval.statistics.table import Table
from ssp_eval.statistics.tables.notices import everywhere, notices
from ssp_eval.statistics.tables.scores import with_notices
from ssp_eval.statistics.tables.statistics import statistics_tables

# Up to here a page has its statistics without being asked; of more cells they take minutes.
MOST_ANALYSED = 500
_CARRIED = re.compile(r'<meta name="ssp-report" content="([^"]*)">')
# The element stands in the head, which holds the style sheet besides.
_HEAD_CHARACTERS = 100_000


class Making(Strict):
    """The options of `ssp report` that a page follows from, and the program that made it.

    Args:
        expected: scenarios of ``--expect``.
        tables: its statistics carry the notices, as with ``--tables``.
        repeats: number of other campaigns whose answers count.
    """

    software: str = f"ssp {__version__}"
    expected: tuple[str, ...] = ()
    resamples: int = RESAMPLES
    seed: int = SEED
    block: int | None = None
    tables: bool = False
    repeats: int = 0

    @property
    def options(self) -> Options:
        """Settings of the random numbers."""
        return Options(self.resamples, self.seed, self.block)


def making_of(page: str, file: str) -> Making | None:
    """Read what a page carries; None where it carries nothing.

    Raises:
        InputError: it can't be read.
    """
    match = _CARRIED.search(page, 0, _HEAD_CHARACTERS)
    if match is None:
        return None
    return parse_model(Making, parse_mapping(html.unescape(match[1]).encode(), file), file)


def runs_of(
    folders: Iterable[Path], on_cells: Callable[[int], Callable[[], None]] = lambda _: lambda: None
) -> tuple[list[CellData], list[CellRow], list[OfScenario]]:
    """Read the cells of one or several campaigns, which are runs that differ by folder.

    A scenario whose labels can't be compared between domains over all runs stays out of domain
    means in each of them (METHOD 5.2b).

    Args:
        folders: of the campaigns.
        on_cells: is called with the number of cells of each campaign; what it returns is called
            after each of them.

    Returns:
        The cells, their rows in the same order, and the best blind constants of each run.
    """
    campaigns = list(folders)
    names = [folder.resolve().name for folder in campaigns]
    data: list[CellData] = []
    runs: list[tuple[list[CellRow], list[CellData]]] = []
    for folder, name in zip(campaigns, names, strict=True):
        if sum(other.resolve() == folder.resolve() for other in campaigns) > 1:
            raise InputError("is given twice", file=folder, remedy="give each campaign once")
        cells = load_cells(folder, on_cells(len(cell_files(folder))))
        data += cells
        run = name if names.count(name) == 1 else str(folder)
        runs.append((rows_from_cells(cells, run if len(campaigns) > 1 else ""), cells))
    apart = apart_across_runs(data) if len(runs) > 1 else ()
    rows: list[CellRow] = []
    constants: list[OfScenario] = []
    for scored, cells in runs:
        own = [without_domains(row) if row.scenario in apart else row for row in scored]
        constants += constants_of_cells(own, cells)
        rows += own
    return data, rows, constants


def statistics_of(
    rows: Sequence[CellRow],
    data: Sequence[CellData],
    options: Options,
    constants: Sequence[OfScenario],
    on_step: Callable[[], None] = lambda: None,
) -> list[Table]:
    """Compute the statistics of cells as tables."""
    blind = constants_in(one_scale([*rows, *constant_rows(constants)]))
    return statistics_tables(compute(rows, data, options, on_step, blind), options.resamples)


def make_again(folder: Path, making: Making) -> None:
    """Write the page of a campaign into its folder, as `ssp report` did with these options.

    Raises:
        InputError: a file of the campaign is damaged.
    """
    analysis: list[Table] = []
    if making.tables or len(cell_files(folder)) <= MOST_ANALYSED:
        data, rows, constants = runs_of((folder,))
        analysis = statistics_of(rows, data, making.options, constants)
        if making.tables:
            analysis = with_notices(analysis, everywhere(notices(rows, data, making.expected)))
    write_report(
        folder, analysis=analysis, expected=making.expected, carried=making.model_dump_json()
    )
