"""Rates of a campaign: the headline of METHOD 8.7 with its interval, and the outcomes beside it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import stdev

from ssp_core.proportion import wilson_interval
from ssp_core.run_file.latency import Latency
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS, OUTCOMES
from ssp_scenario_manager.closed_loop.values import LIMITS

CRITICAL = "critical"
# Of starts.
KINDS = (CRITICAL, "harmless", "unavoidable")


@dataclass(frozen=True, slots=True)
class RunRow:
    """The part of one run's row that rates are made of.

    Args:
        start: its hash.
        kind: of its start: critical, harmless or unavoidable.
        needless: why it is in the event-free twin; empty: it isn't.
    """

    event: str
    start: str
    driver: str
    latency: Latency
    kind: str
    outcome: str
    needless: str
    starved: bool

    @property
    def succeeds(self) -> bool:
        """Tell whether the run counts for the headline."""
        return self.outcome == "avoided" and not self.needless


@dataclass(frozen=True, slots=True)
class Rates:
    """One row of the table: a driver at a latency, on the critical starts of an event.

    Args:
        planned: all runs.
        driven: without those that stayed ``harness``.
        headline: mean over the starts of the share of their ``driven`` runs that succeed; None
            where too many are ``harness``.
        low: end of Wilson's interval of 95 % over the starts; None where there is none.
        high: the other end.
        worst: share with each ``harness`` a failure.
        within_sd: standard deviation of a run within its start, from 0 to 1; None without repeats.
        between_sd: standard deviation of the starts' shares; None of fewer than two starts.
        outcomes: how many of each kind, in the order of OUTCOMES.
        needless: how many are needless in the event-free twin.
        starved: how many.
    """

    event: str
    driver: str
    latency: Latency
    planned: int
    driven: int
    headline: float | None
    low: float | None
    high: float | None
    worst: float
    within_sd: float | None
    between_sd: float | None
    outcomes: tuple[int, ...]
    needless: int
    starved: int


def rates_of(rows: Sequence[RunRow]) -> list[Rates]:
    """Return the rates of each driver, latency and event, in the order of the rows."""
    critical = [row for row in rows if row.kind == CRITICAL]
    lost = drivers_without_rates(rows)
    cells: dict[tuple[str, str, Latency], list[RunRow]] = {}
    for row in critical:
        cells.setdefault((row.event, row.driver, row.latency), []).append(row)
    return [
        _rates(*cell, cell_rows, has_rates=cell[1] not in lost) for cell, cell_rows in cells.items()
    ]


def drivers_without_rates(rows: Sequence[RunRow]) -> set[str]:
    """Return the drivers of whose runs too many are ``harness`` (METHOD 8.7).

    Args:
        rows: of all starts, also of those that rates aren't of.
    """
    planned = Counter(row.driver for row in rows)
    lost = Counter(row.driver for row in rows if row.outcome == HARNESS)
    return {name for name in lost if lost[name] > LIMITS.harness_share * planned[name]}


def _rates(
    event: str, driver: str, latency: Latency, rows: Sequence[RunRow], *, has_rates: bool
) -> Rates:
    driven = [row for row in rows if row.outcome != HARNESS]
    successes = sum(row.succeeds for row in driven)
    # Repeats of one start aren't independent: the unit of the interval is the start.
    by_start: dict[str, list[bool]] = {}
    for row in driven:
        by_start.setdefault(row.start, []).append(row.succeeds)
    counts = Counter(row.outcome for row in rows)
    headline = low = high = None
    if driven and has_rates:
        count = sum(sum(repeats) / len(repeats) for repeats in by_start.values())
        headline = count / len(by_start)
        low, high = wilson_interval(headline, len(by_start))
    return Rates(
        event,
        driver,
        latency,
        len(rows),
        len(driven),
        headline,
        low,
        high,
        successes / len(rows),
        *_spread(list(by_start.values())),
        tuple(counts[kind] for kind in OUTCOMES),
        sum(bool(row.needless) for row in rows),
        sum(row.starved for row in rows),
    )


def _spread(starts: Sequence[Sequence[bool]]) -> tuple[float | None, float | None]:
    """Return the standard deviations of runs within their starts, and of the starts' shares."""
    shares = [sum(repeats) / len(repeats) for repeats in starts]
    repeated = [
        (p, len(repeats)) for p, repeats in zip(shares, starts, strict=True) if len(repeats) > 1
    ]
    within = between = None
    if repeated:
        # Pooled over the starts: each gives its n - 1 degrees of freedom.
        squares = math.fsum(n * p * (1.0 - p) for p, n in repeated)
        within = math.sqrt(squares / sum(n - 1 for _, n in repeated))
    if len(shares) > 1:
        between = stdev(shares)
    return within, between


def refusal_reasons(rates: Sequence[Rates], zero: Sequence[str]) -> list[str]:
    """List why a campaign is refused: drivers whose headline must be 0, and isn't (METHOD 8.10)."""
    return [
        f"{one.driver} has a headline of {one.headline:.2f} on {one.event} at "
        f"{one.latency.words}, and must have 0"
        for one in rates
        if one.driver in zero and one.headline
    ]


def rising(rates: Sequence[Rates], drivers: Sequence[str]) -> list[str]:
    """List where a driver's headline is higher at a larger latency; a measured one has no place.

    Args:
        rates: of a campaign.
        drivers: that are looked at.
    """
    rises = []
    for event, driver in dict.fromkeys((one.event, one.driver) for one in rates):
        if driver not in drivers:
            continue
        own = [one for one in rates if (one.event, one.driver) == (event, driver)]
        cells = [one for one in own if not one.latency.measured]
        cells.sort(key=lambda one: one.latency)
        for faster, slower in pairwise(cells):
            if faster.headline is None or slower.headline is None:
                continue
            if slower.headline > faster.headline:
                rises.append(
                    f"{driver} on {event}: {faster.headline:.2f} at {faster.latency.words}, "
                    f"{slower.headline:.2f} at {slower.latency.cell_text} s"
                )
    return rises
