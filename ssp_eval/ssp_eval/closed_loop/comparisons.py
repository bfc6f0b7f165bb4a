"""Pairs of drivers on the same starts, and headlines over events (METHOD 8.7)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop.folder import Run
from ssp_eval.statistics.bootstrap import RESAMPLES, SEED
from ssp_eval.statistics.paired import Test, mcnemar
from ssp_eval.statistics.resampling import (
    NO_INTERVAL,
    Interval,
    Numbers,
    draws,
    generator,
    percentile_interval,
    reach,
    weighted_sums,
)
from ssp_scenario_manager.closed_loop.outcomes.outcome import HARNESS
from ssp_scenario_manager.closed_loop.outcomes.rates import CRITICAL, drivers_without_rates

# METHOD 8.7: fewer events carry no interval.
LEAST_EVENTS = 8
Place = tuple[str, str]


@dataclass(frozen=True)
class Pair:
    """Two drivers at one latency, on the starts that both drove.

    Args:
        starts: that both drove, of all events.
        test: its ``more`` are starts on which the first succeeds more often than the second.
    """

    latency: Latency
    first: str
    second: str
    starts: int
    test: Test


@dataclass(frozen=True)
class OverEvents:
    """The headline of a driver at a latency over all events, each event counted once.

    Args:
        headline: mean of the events' headlines; None where an event has none.
        interval: of a bootstrap over events, then starts; none below LEAST_EVENTS.
    """

    driver: str
    latency: Latency
    events: int
    headline: float | None
    interval: Interval


def shares_of(runs: Iterable[Run]) -> dict[tuple[str, Latency], dict[Place, float]]:
    """Return by driver and latency the share of successful runs of each critical (event, start).

    A run that stayed ``harness`` is no run; a driver without rates has no shares, nor has one at a
    latency at which it is starved, since it isn't ranked there (METHOD 8.4).
    """
    there = list(runs)
    without = drivers_without_rates([run.row for run in there])
    starved = {(run.row.driver, run.row.latency) for run in there if run.row.starved}
    successes: dict[tuple[str, Latency], dict[Place, list[bool]]] = {}
    for run in there:
        row = run.row
        counts = row.kind == CRITICAL and row.outcome != HARNESS
        cell_of = (row.driver, row.latency)
        if counts and row.driver not in without and cell_of not in starved:
            cell = successes.setdefault(cell_of, {})
            cell.setdefault((row.event, row.start), []).append(row.succeeds)
    return {
        cell: {place: sum(each) / len(each) for place, each in of_cell.items()}
        for cell, of_cell in successes.items()
    }


def pairs_of(
    runs: Sequence[Run], drivers: Sequence[str], others: Sequence[str] | None = None
) -> list[Pair]:
    """Compare each two drivers by McNemar's exact test.

    The unit is the start. With repeats the two shares of successes are compared, which is the same
    test without them.

    Args:
        runs: of all starts.
        drivers: to compare, in their order.
        others: with whom each of them is compared; None: with each other.
    """
    each = [*combinations(drivers, 2)] if others is None else [*product(drivers, others)]
    shares = shares_of(runs)
    latencies = sorted({latency for _, latency in shares})
    pairs = []
    for latency in latencies:
        for first, second in each:
            one = shares.get((first, latency), {})
            other = shares.get((second, latency), {})
            both = sorted(one.keys() & other.keys())
            if both:
                more = sum(one[place] > other[place] for place in both)
                fewer = sum(one[place] < other[place] for place in both)
                pairs.append(Pair(latency, first, second, len(both), mcnemar(more, fewer)))
    return pairs


def over_events(
    runs: Sequence[Run],
    headlines: Mapping[tuple[str, str, Latency], float | None],
    resamples: int = RESAMPLES,
    seed: int = SEED,
) -> list[OverEvents]:
    """Return the headline of each driver and latency over the events.

    Args:
        runs: of all starts.
        headlines: by event, driver and latency.
        resamples: of the bootstrap.
        seed: of it.
    """
    shares = shares_of(runs)
    summaries = []
    for driver, latency in dict.fromkeys((key[1], key[2]) for key in headlines):
        own = {k[0]: v for k, v in headlines.items() if k[1:] == (driver, latency)}
        values = [v for v in own.values() if v is not None]
        whole = len(values) == len(own)
        headline = math.fsum(values) / len(values) if values and whole else None
        interval = NO_INTERVAL
        if headline is not None and len(own) >= LEAST_EVENTS:
            by_event = [
                [v for (event, _), v in shares[driver, latency].items() if event == name]
                for name in own
            ]
            samples = _resampled(by_event, resamples, seed, driver, str(latency))
            interval = percentile_interval(samples, reach(len(own)))
            interval = Interval(max(interval.low or 0.0, 0.0), min(interval.high or 0.0, 1.0))
        summaries.append(OverEvents(driver, latency, len(own), headline, interval))
    return summaries


def _resampled(
    by_event: Sequence[Sequence[float]], resamples: int, seed: int, *names: str
) -> Numbers:
    """Return means over events of as many resamples: events are drawn, then the starts of each.

    An event that is drawn twice has its starts drawn twice.

    Returns:
        (resamples,).
    """
    rng = generator(seed, "over events", *names)
    count = len(by_event)
    picked = rng.integers(0, count, size=(resamples, count))
    total = np.zeros(resamples)
    for place in range(count):
        for event, shares in enumerate(by_event):
            rows = np.flatnonzero(picked[:, place] == event)
            values = np.array(shares, dtype=np.float64)[:, None]
            weights = draws(len(shares), len(rows), rng)
            total[rows] += weighted_sums(weights, values)[0] / len(shares)
    return total / count
