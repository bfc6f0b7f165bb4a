"""Runs of a campaign of drivers, made without a simulation."""

from __future__ import annotations

from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop.folder import Run
from ssp_scenario_manager.closed_loop.outcomes.rates import RunRow
from ssp_scenario_manager.closed_loop.outcomes.tables import RUN_COLUMNS

LATENCIES = (Latency(0.0), Latency(0.5))
MINE = "mine"


def made_run(
    number: int = 1,
    *,
    event: str = "cut_in",
    start: str = "s1",
    driver: str = MINE,
    latency: Latency = LATENCIES[0],
    kind: str = "critical",
    outcome: str = "avoided",
    needless: str = "",
    starved: bool = False,
    **cells: str,
) -> Run:
    row = RunRow(event, start, driver, latency, kind, outcome, needless, starved)
    values = dict.fromkeys(RUN_COLUMNS, "")
    values |= {
        "event": event,
        "seed": "1",
        "start": start,
        "kind": kind,
        "driver": driver,
        "latency": str(latency),
        "repeat": "0",
        "outcome": outcome,
        "needless": needless,
        "starved": str(starved).lower(),
    }
    return Run(number, row, {**values, **cells})
