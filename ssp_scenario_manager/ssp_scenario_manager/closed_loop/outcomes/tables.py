"""The tables of a campaign: a row per run, and one per event, driver and latency."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.run_file.latency import parse_latency
from ssp_core.run_file.quantities import NUMBER
from ssp_scenario_manager.closed_loop.outcomes.outcome import CHAIN, HARNESS, OUTCOMES
from ssp_scenario_manager.closed_loop.outcomes.rates import KINDS, Rates, RunRow
from ssp_scenario_manager.closed_loop.outcomes.severity import Severity
from ssp_scenario_manager.closed_loop.values import LIMITS
from ssp_scenario_manager.run.result import rounded

RUNS_FILE, TABLE_FILE = "runs.csv", "table.csv"
_MOST_WHY = 300  # characters of a row's reason
Row = list[str]

RUN_COLUMNS = [
    *("event", "seed", "start", "kind", "driver", "latency", "repeat"),
    *("outcome", "outcome_s", "why", "v_i_mps", "v_r_mps", "severity"),
    *CHAIN,
    *("unled_s", "starved", "needless", "latency_p50_s", "latency_p99_s"),
    "states_sha256",
    *(field.name for field in fields(Severity)),
]
_WORDS = {"kind": KINDS, "outcome": OUTCOMES, "starved": ("true", "false")}
_WHOLE = ("seed", "repeat")
_NUMBERS = frozenset(
    {
        *("outcome_s", "v_i_mps", "v_r_mps", "severity", *CHAIN),
        *("unled_s", "latency_p50_s", "latency_p99_s", *(field.name for field in fields(Severity))),
    }
)
RATE_COLUMNS = [
    *("event", "group", "driver", "privileged", "latency", "planned", "driven"),
    *("headline", "low", "high", "worst", "within_sd", "between_sd"),
    *OUTCOMES,
    *("needless", "starved"),
]


def rows_there(path: Path) -> list[Row]:
    """Return the rows that an earlier call left, without one that was cut off."""
    if not path.is_file():
        return []
    text = path.read_bytes().decode(errors="replace")
    return list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))[1:]


def one_line(text: str) -> str:
    """Return a text as one line of bounded length: a driver's error may be anything."""
    return " ".join(text.split())[:_MOST_WHY]


def lines_of(rows: Sequence[Row]) -> str:
    """Return rows as CSV."""
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()


def number_cell(value: float | None) -> str:
    """Return a number as a cell, empty where there is none."""
    number = rounded(value)
    return "" if number is None else str(number)


def cell(value: str | float | bool | None) -> str:
    """Return a value of ``result.json`` as a cell."""
    if isinstance(value, bool):
        return str(value).lower()
    return one_line(value) if isinstance(value, str) else number_cell(value)


def read_row(row: Row) -> RunRow:
    """Return the part of a run's row that rates are made of.

    Raises:
        InputError: a cell is no word or number of its column.
        ValueError: it has other columns.
    """
    one = dict(zip(RUN_COLUMNS, row, strict=True))
    for column, text in one.items():
        _check_cell(column, text)
    return RunRow(
        one["event"],
        one["start"],
        one["driver"],
        parse_latency(one["latency"]),
        one["kind"],
        one["outcome"],
        one["needless"],
        one["starved"] == "true",
    )


def _check_cell(column: str, text: str) -> None:
    """Refuse a word that a column doesn't have, and what is no number in one of numbers."""
    if column in _WORDS and text not in _WORDS[column]:
        remedy = f"known: {', '.join(_WORDS[column])}"
        raise InputError("is not a known word", field=column, value=text, remedy=remedy)
    try:
        if column in _WHOLE and not 0 <= int(text) < 2**63:
            raise ValueError
        if column in _NUMBERS and text:
            NUMBER.within(float(text))
    except ValueError as error:
        raise InputError(
            "is no number of a run", field=column, value=text, remedy="drive the run again"
        ) from error


def off_the_twin(runs: Iterable[Mapping[str, str]]) -> list[str]:
    """List the events in which `constant_velocity` isn't what `no_response` is (METHOD 8.10).

    Args:
        runs: columns of ``runs.csv`` by name.
    """
    own = [
        one
        for one in runs
        if (one["driver"], one["kind"]) == ("constant_velocity", "critical")
        and one["v_r_mps"]
        and one["outcome"] != HARNESS
    ]
    deviations = []
    for event in dict.fromkeys(one["event"] for one in own):
        there = [one for one in own if one["event"] == event]
        # Without a contact it is off by all of v_r.
        off = [abs(float(one["v_i_mps"] or 0.0) - float(one["v_r_mps"])) for one in there]
        over = [value for value in off if value > LIMITS.contact_mps]
        if over:
            deviations.append(
                f"constant_velocity on {event}: v_i differs from v_r by up to {max(over):.2f} m/s, "
                f"by more than {LIMITS.contact_mps:g} m/s in {len(over)} of {len(there)} runs"
            )
    return deviations


def rates_row(one: Rates, is_privileged: bool, group: int) -> Row:
    """Return one row of the table of rates.

    Args:
        one: the rates.
        is_privileged: the driver knows the truth.
        group: number of the drivers with cards like the driver's.
    """
    return [
        one.event,
        str(group),
        one.driver,
        str(is_privileged).lower(),
        str(one.latency),
        str(one.planned),
        str(one.driven),
        *map(number_cell, (one.headline, one.low, one.high, one.worst)),
        *map(number_cell, (one.within_sd, one.between_sd)),
        *map(str, (*one.outcomes, one.needless, one.starved)),
    ]
