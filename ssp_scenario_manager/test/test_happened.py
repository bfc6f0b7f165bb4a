"""What happened in a run, as result.json has it: what is stated, and what isn't known."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.in_process import FaultFact
from ssp_core.run_spec import RunSpec
from ssp_core.vocab import Phase
from ssp_scenario_manager.in_process.outcome import run_in_process
from ssp_scenario_manager.runner.happened import (
    Happened,
    happened_by,
    result_keys,
    shown_gap,
)

S = 1_000_000_000


def fault(name: str, at_ns: int, value: float = math.nan) -> FaultFact:
    return FaultFact("sil_world", name, "ot1", True, value, "", at_ns)


@pytest.fixture
def empty(run: RunSpec) -> Callable[..., Happened]:
    """A run of which no world told anything."""

    def make(began_ns: int | None, *faults: FaultFact) -> Happened:
        truths: dict[str, Any] = {run.vut.id: [], **{t.id: [] for t in run.targets}}
        return Happened.seen(run, began_ns, (), (), faults, truths)

    return make


def test_no_gap_is_stated_of_a_run_that_never_reached_its_conflict(run: RunSpec) -> None:
    limits = run.limits.model_copy(update={"jump_m": 1.0, "frozen_s": 0.3})
    run = run.model_copy(update={"limits": limits})
    result, record = run_in_process(run)
    whole = result.happened
    truths = {i: record.truths(i) for i in (run.vut.id, *(t.id for t in run.targets))}

    def keys(*phases: Phase) -> dict[str, Any]:
        began = [p for p in whole.phases if p.phase in phases]
        return result_keys(run, Happened.seen(run, 0, began, whole.triggers, (), truths))

    met, unmet = keys(*Phase), keys(Phase.APPROACH, Phase.TRIGGER)
    assert (met["initiator_first"], met["time_gap_s"] > 0.0) == (True, True)
    assert (unmet["initiator_first"], unmet["time_gap_s"]) == (None, None)
    assert unmet["triggers"] == met["triggers"] != []
    assert unmet["min_distance_m"] == met["min_distance_m"] > 0.0
    assert shown_gap(unmet["time_gap_s"]) == "no time gap"


def test_faults_are_told_by_number_and_kind_in_the_same_order(
    run: RunSpec, empty: Callable[..., Happened]
) -> None:
    late, early = fault("10 link_delay", 3 * S, 0.2), fault("2 state_nan", 2 * S)
    one, other = (
        result_keys(run, empty(0, *order))["faults"] for order in ((late, early), (early, late))
    )
    assert one == other
    assert [(f["number"], f["kind"], f["value"], f["at_s"]) for f in one] == [
        (2, "state_nan", None, 2.0),
        (10, "link_delay", 0.2, 3.0),
    ]


def test_times_count_from_the_start_and_are_unknown_without_one(
    run: RunSpec, empty: Callable[..., Happened]
) -> None:
    began_ns = 1_700_000_000 * S
    for start_ns, at_s in ((began_ns, 2.5), (None, None)):
        happened = empty(start_ns, fault("0 link_cut", began_ns + 5 * S // 2))
        assert result_keys(run, happened)["faults"][0]["at_s"] == at_s
        json.dumps(result_keys(run, happened), allow_nan=False)


def test_what_nothing_tells_is_null_and_not_empty(
    run: RunSpec, empty: Callable[..., Happened], tmp_path: Path
) -> None:
    assert happened_by(tmp_path / "no-bag", run) is None
    nothing, unseen = result_keys(run, None), result_keys(run, empty(0))
    assert list(nothing) == list(unseen)
    assert (nothing["phases"], nothing["faults"]) == (None, None)
    assert (unseen["phases"], unseen["faults"], unseen["min_distance_m"]) == ([], [], None)
    assert (nothing["seed"], nothing["mode"]) == (run.seed, run.mode)
    live = result_keys(replace_mode(run), replace(empty(0), began_ns=None))
    assert (live["mode"], live["time_gap_s"], live["min_distance_m"]) == ("live", None, None)


def replace_mode(run: RunSpec) -> RunSpec:
    return run.model_copy(update={"mode": "live"})
