"""A campaign of driven runs, as ``ssp loop`` wrote it, read for its report."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_scenario_manager.closed_loop.campaigns.cards import CARDS_FILE, load_cards
from ssp_scenario_manager.closed_loop.campaigns.groups import groups_of
from ssp_scenario_manager.closed_loop.campaigns.plan_file import LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.seal import (
    Draw,
    sealed_draws,
    sealed_plan,
    sealed_starts,
)
from ssp_scenario_manager.closed_loop.outcomes.rates import CRITICAL, Rates, RunRow, rates_of
from ssp_scenario_manager.closed_loop.outcomes.tables import (
    RUN_COLUMNS,
    RUNS_FILE,
    read_row,
    rows_there,
)


@dataclass(frozen=True)
class Run:
    """One row of ``runs.csv``.

    Args:
        number: of the row, from 1.
        row: the part that rates are made of.
        cells: all columns as they stand in the file.
    """

    number: int
    row: RunRow
    cells: dict[str, str]

    def value(self, column: str) -> float | None:
        """Return a number of the row; None where there is none."""
        text = self.cells[column]
        return float(text) if text else None


@dataclass(frozen=True)
class LoopCampaign:
    """A campaign of driven runs.

    Args:
        starts: sealed ones.
        draws: of the events, in the order of the plan.
        cards: of the drivers, in the order of the table.
        runs: in the order of the file.
    """

    folder: Path
    plan: LoopPlan
    version: str
    starts: tuple[dict[str, Any], ...]
    draws: tuple[Draw, ...]
    cards: tuple[dict[str, Any], ...]
    runs: tuple[Run, ...]

    @property
    def critical(self) -> list[Run]:
        """Runs of critical starts, which rates are of."""
        return [one for one in self.runs if one.row.kind == CRITICAL]

    @property
    def rates(self) -> list[Rates]:
        """Rates by event, driver and latency."""
        return rates_of([one.row for one in self.runs])

    @property
    def drivers(self) -> list[str]:
        """Drivers with runs, in the order of the plan."""
        there = {one.row.driver for one in self.runs}
        return [one.display_name for one in self.plan.everybody if one.display_name in there]

    @property
    def groups(self) -> dict[int, list[str]]:
        """Drivers with runs, by the number of their group of like cards."""
        there = self.drivers
        drivers_by_group = {
            k: [one for one in group if one in there]
            for k, group in enumerate(groups_of(self.cards), 1)
        }
        return {k: group for k, group in drivers_by_group.items() if group}

    def card(self, driver: str) -> dict[str, Any]:
        """Return a driver's card."""
        return next(one for one in self.cards if one["driver"] == driver)


def load_loop(folder: Path) -> LoopCampaign:
    """Read a campaign, whole or as far as it got.

    Raises:
        InputError: a file is missing, damaged, or was changed after it was sealed.
    """
    plan, version = sealed_plan(folder)
    return LoopCampaign(
        folder=folder,
        plan=plan,
        version=version,
        starts=tuple(sealed_starts(folder)),
        draws=tuple(sealed_draws(folder)),
        cards=tuple(load_cards(folder / CARDS_FILE)),
        runs=tuple(_runs(folder / RUNS_FILE)),
    )


def _runs(path: Path) -> list[Run]:
    """Return the rows that are whole: one that is being written, or was cut off, is none yet."""
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            header = next(csv.reader(stream), [])
        rows = rows_there(path)
    except (OSError, UnicodeError) as error:
        raise InputError(
            f"can't be read: {error}", file=path, remedy="name a folder that `ssp loop` wrote"
        ) from error
    if header != RUN_COLUMNS:
        raise InputError(
            "has other columns than those of a campaign",
            file=path,
            line=1,
            remedy="use the software that wrote it, or begin the campaign in a new folder",
        )
    return [_run(path, k, row) for k, row in enumerate(rows, 1)]


def _run(path: Path, number: int, row: Sequence[str]) -> Run:
    try:
        return Run(number, read_row(list(row)), dict(zip(RUN_COLUMNS, row, strict=True)))
    except (ValueError, InputError) as error:
        raise InputError(
            f"is no row of a campaign: {error}",
            file=path,
            line=number + 1,
            field=error.field if isinstance(error, InputError) else None,
            remedy="let `ssp loop` go on: it drives what was cut off again",
        ) from error
