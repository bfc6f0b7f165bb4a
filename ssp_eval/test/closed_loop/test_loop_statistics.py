"""Statistics over the runs of a campaign: pairs, events, and what the open loop predicts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssp_core.run_file.latency import Latency
from ssp_eval.closed_loop.comparisons import over_events, pairs_of
from ssp_eval.closed_loop.prediction import (
    Point,
    inversions_of,
    rho_of,
)
from ssp_scenario_manager.closed_loop.outcomes.rates import rates_of
from tests.support.loop_runs import LATENCIES, MINE, made_run


def test_mcnemar_counts_the_starts_on_which_one_driver_alone_succeeds() -> None:
    runs = []
    # 6 starts that the first alone avoids, 1 that the second alone avoids, 3 that both do.
    for k, (one, other) in enumerate([(True, False)] * 6 + [(False, True)] + [(True, True)] * 3):
        for driver, succeeds in (("a", one), ("b", other)):
            outcome = "avoided" if succeeds else "collision"
            runs.append(made_run(start=f"s{k}", driver=driver, outcome=outcome))
    (pair,) = pairs_of(runs, ["a", "b"])
    assert (pair.starts, pair.test.more, pair.test.fewer) == (10, 6, 1)
    # Two-sided binomial of 1 of 7: 2 * (1 + 7) / 2**7.
    assert pair.test.p == pytest.approx(2 * 8 / 128)
    assert pair.test.p_least == pytest.approx(2 / 128)


def test_pairs_are_of_the_same_event_start_and_latency() -> None:
    runs = [
        made_run(driver="a", latency=LATENCIES[0]),
        made_run(driver="b", latency=LATENCIES[1], outcome="collision"),
        made_run(driver="b", event="other", outcome="collision"),
        made_run(driver="b", start="s2", outcome="collision"),
        made_run(driver="b", outcome="harness"),
    ]
    assert pairs_of(runs, ["a", "b"]) == []


def test_a_driver_is_in_no_pair_at_a_latency_at_which_it_is_starved() -> None:
    """It is shown and not ranked there (METHOD 8.4)."""
    runs = [
        made_run(driver=driver, latency=latency, starved=driver == "b" and latency == LATENCIES[1])
        for driver in ("a", "b")
        for latency in LATENCIES[:2]
    ]
    assert [pair.latency for pair in pairs_of(runs, ["a", "b"])] == [LATENCIES[0]]


def test_repeats_of_a_start_are_one_pair() -> None:
    runs = [made_run(driver="a") for _ in range(4)]
    runs += [made_run(driver="b", outcome=o) for o in ("avoided", "collision") * 2]
    (pair,) = pairs_of(runs, ["a", "b"])
    assert (pair.starts, pair.test.more, pair.test.fewer) == (1, 1, 0)


def over(shares: dict[str, list[float]], **options: Any) -> Any:
    """The headline of one driver over events, from the shares of successes of its starts."""
    runs = [
        made_run(event=event, start=f"{event} {k}", outcome="avoided" if share else "collision")
        for event, values in shares.items()
        for k, share in enumerate(values)
    ]
    headlines = {
        (one.event, one.driver, one.latency): one.headline
        for one in rates_of([run.row for run in runs])
    }
    (found,) = over_events(runs, headlines, **options)
    return found


def test_fewer_than_eight_events_have_no_interval_over_events() -> None:
    found = over({f"e{k}": [1.0, 0.0] for k in range(7)})
    assert (found.headline, found.interval.low, found.interval.high) == (0.5, None, None)


def test_each_event_counts_once_whatever_its_number_of_starts() -> None:
    found = over({"e1": [1.0] * 9, "e2": [0.0]})
    assert found.headline == 0.5


def test_the_bootstrap_draws_events_and_then_their_starts() -> None:
    """Its spread is that of both stages; either alone would miss one of these."""
    apart = {f"e{k}": [float(k % 2)] * 20 for k in range(8)}
    within = {f"e{k}": [1.0, 0.0] * 10 for k in range(8)}
    wide, narrow = over(apart), over(within)
    assert wide.headline == narrow.headline == 0.5
    # Between events alone: sd 0.5 / sqrt(8); within alone: 0.5 / sqrt(160). The ends are those of
    # the expanded percentile interval: t(7) = 2.365, times sqrt(8 / 7).
    reach = 2.365 * math.sqrt(8 / 7)
    assert wide.interval.high - wide.interval.low == pytest.approx(
        2 * reach * 0.5 / math.sqrt(8), abs=0.15
    )
    assert narrow.interval.high - narrow.interval.low == pytest.approx(
        2 * reach * 0.5 / math.sqrt(160), abs=0.03
    )


def test_the_same_seed_gives_the_same_interval_and_another_one_another() -> None:
    rng = np.random.default_rng(3)
    shares = {f"e{k}": (rng.random(12) < rng.random()).astype(float).tolist() for k in range(9)}
    assert over(shares) == over(shares)
    assert over(shares, resamples=500) != over(shares, resamples=500, seed=2)


def test_an_event_without_a_headline_leaves_none_over_events() -> None:
    runs = [made_run(event=f"e{k}") for k in range(8)]
    headlines: dict[tuple[str, str, Latency], float | None] = {
        (f"e{k}", MINE, LATENCIES[0]): 1.0 if k else None for k in range(8)
    }
    (found,) = over_events(runs, headlines)
    assert (found.headline, found.interval.low) == (None, None)


def point(name: str, score: float, headline: float, half: float = 0.05) -> Point:
    return Point(name, score, headline, headline - half, headline + half)


def test_rho_needs_ten_drivers_and_is_spearmans() -> None:
    points = [point(f"d{k}", k / 10, (k * k) / 100) for k in range(10)]
    assert rho_of(points) == pytest.approx(1.0)
    assert rho_of(points[:9]) is None
    assert rho_of([replace(one, headline=0.5) for one in points]) is None
    swapped = [*points[2:], replace(points[0], score=0.1), replace(points[1], score=0.0)]
    # 1 - 6 * (1 + 1) / (10 * 99), one pair of neighbours the other way round.
    assert rho_of(swapped) == pytest.approx(1 - 12 / 990)


def test_inversions_are_named_where_the_intervals_of_the_headlines_are_apart() -> None:
    points = [point("talker", 0.9, 0.2), point("driver", 0.4, 0.8), point("near", 0.3, 0.25)]
    assert inversions_of(points) == (("talker", "driver"),)
    assert inversions_of([replace(points[0], score=0.4), points[1]]) == ()
