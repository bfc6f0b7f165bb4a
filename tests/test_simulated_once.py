"""The compiler's simulation is replaced by nothing but its own earlier answer."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run import feasibility
from tests.support import simulated_once
from tests.support.runs import cut_in_run
from tests.support.simulated_once import remembered


def test_only_the_same_run_is_not_simulated_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def why_not(run: RunSpec) -> list[str]:
        asked.append(run.seed)
        return [f"seed {run.seed}"]

    run = RunSpec.model_validate(cut_in_run())
    other = run.model_copy(update={"seed": run.seed + 1})
    one, another = remembered(why_not, tmp_path), remembered(why_not, tmp_path)
    renamed = run.model_copy(update={"run_id": "another", "event_version": "sha256:another"})
    for ask in (one, another):
        assert ask(renamed) == [f"seed {run.seed}"]
        assert [ask(run), ask(other)] == [[f"seed {run.seed}"], [f"seed {other.seed}"]]
    assert asked == [run.seed, other.seed]
    monkeypatch.setattr(feasibility, "run_in_process", lambda _: None)
    assert one(run) == [f"seed {run.seed}"]
    assert asked == [run.seed, other.seed, run.seed]


def test_a_session_is_run_once_unless_plans_lead_it(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[str] = []

    def run_in_process(run: RunSpec, **_: object) -> str:
        ran.append("" if run.driven is None else run.driven.driver)
        return str(len(ran))

    monkeypatch.setattr(simulated_once, "run_in_process", run_in_process)
    monkeypatch.setattr(simulated_once, "_RUN", {})
    whole = RunSpec.model_validate(cut_in_run())

    def led_by(driver: str) -> RunSpec:
        driven = Driven(driver=driver, first_request_s=0.0, hand_over_s=1.0, end_s=9.0)
        return whole.model_copy(update={"driven": driven})

    for run in (whole, led_by("no_response"), led_by("oracle"), led_by("built_in")):
        for _ in range(2):
            simulated_once.run_once(run)
    assert ran == ["", "no_response", "oracle", "oracle", "built_in"]
    simulated_once.run_once(led_by("built_in"), answers=["one"])
    simulated_once.run_once(led_by("built_in").model_copy(update={"seed": 99}))
    assert ran[5:] == ["built_in", "built_in"]
