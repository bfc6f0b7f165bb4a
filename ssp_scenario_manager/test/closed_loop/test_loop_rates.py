"""Rates of a campaign: headline, interval, spread, and what refuses it (METHOD 8.7)."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from ssp_core.run_file.latency import Latency
from ssp_scenario_manager.closed_loop.campaigns.plan_file import (
    ZERO,
)
from ssp_scenario_manager.closed_loop.outcomes.outcome import OUTCOMES
from ssp_scenario_manager.closed_loop.outcomes.rates import (
    RunRow,
    rates_of,
    refusal_reasons,
    rising,
)

NUMBERS = itertools.count()


def row(outcome: str = "avoided", needless: str = "", **changes: Any) -> RunRow:
    values: dict[str, Any] = {
        "event": "cut_in",
        "start": f"start {next(NUMBERS)}",
        "driver": "a",
        "latency": Latency(0.0),
        "kind": "critical",
        "starved": False,
    }
    return RunRow(outcome=outcome, needless=needless, **{**values, **changes})


def test_the_headline_is_avoided_without_needless_braking_and_has_wilsons_interval() -> None:
    (one,) = rates_of([row(), row(), row(needless="brakes"), row("collision")])
    assert (one.headline, one.worst, one.needless) == (0.5, 0.5, 1)
    # Wilson's score interval of 2 of 4 with z = 1.96.
    assert (one.low, one.high) == (pytest.approx(0.1500, abs=1e-3), pytest.approx(0.85, abs=1e-3))
    assert dict(zip(OUTCOMES, one.outcomes, strict=True))["avoided"] == 3


def test_repeats_of_one_start_are_one_unit_of_the_interval() -> None:
    repeated = [row(start="s1")] * 20 + [row("collision", start="s2")] * 20
    (one,) = rates_of(repeated)
    (single,) = rates_of([row(start="s1"), row("collision", start="s2")])
    assert (one.headline, one.low, one.high) == (single.headline, single.low, single.high)
    assert (one.planned, one.headline) == (40, 0.5)


def test_repeats_have_a_spread_within_and_between_starts() -> None:
    (one,) = rates_of([row(start="s1"), row("died", start="s1"), *[row(start="s2")] * 2])
    # Pooled variance within: (1/2 + 0) / 2; between: of 0.5 and 1.
    assert (one.within_sd, one.between_sd) == (0.5, pytest.approx(0.125**0.5))
    (one,) = rates_of([row(start="s1")])
    assert (one.within_sd, one.between_sd) == (None, None)


def test_too_many_runs_that_our_side_failed_leave_no_rate() -> None:
    (one,) = rates_of([row(), *[row("harness")] * 2])
    assert (one.headline, one.low, one.driven, one.worst) == (None, None, 1, pytest.approx(1 / 3))
    (one,) = rates_of([row()] * 49 + [row("harness")])
    assert (one.headline, one.worst) == (1.0, 0.98)
    # The share is the driver's, over all of its starts, events and latencies.
    harmless = [row("harness", kind="harmless")] * 5
    (one,) = rates_of([*[row() for _ in range(10)], *harmless])
    assert (one.planned, one.headline) == (10, None)
    half = Latency(0.5)
    rates = rates_of([row()] * 99 + [row("harness", latency=half), row(latency=half)])
    assert [each.headline for each in rates] == [1.0, 1.0]
    rates = rates_of([row()] * 9 + [row("harness", latency=half)])
    assert [each.headline for each in rates] == [None, None]


def test_harmless_and_unavoidable_starts_have_no_part_in_the_headline() -> None:
    (one,) = rates_of([row(), row("collision", kind="unavoidable"), row(kind="harmless")])
    assert (one.planned, one.headline) == (1, 1.0)


def test_a_campaign_is_refused_where_braking_for_nothing_pays() -> None:
    rates = rates_of([row(driver="stop_at_once"), row(driver="oracle")])
    assert refusal_reasons(rates, ZERO) == [
        "stop_at_once has a headline of 1.00 on cut_in at L = 0 s, and must have 0"
    ]


def test_a_headline_that_rises_with_latency_is_told() -> None:
    rates = rates_of(
        [
            row("collision", driver="aeb", latency=Latency(0.1)),
            row(driver="aeb", latency=Latency(0.5)),
            # A measured latency has no place in the order.
            row("collision", driver="aeb", latency=Latency(0.0, measured=True)),
        ]
    )
    assert rising(rates, ("aeb",)) == ["aeb on cut_in: 0.00 at L = 0.1 s, 1.00 at 0.5 s"]
    assert rising(rates, ("oracle",)) == []
