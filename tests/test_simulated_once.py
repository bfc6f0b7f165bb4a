"""The compiler's simulation is replaced by nothing but its own earlier answer."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run import feasibility
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
    for ask in (one, another):
        assert [ask(run), ask(other)] == [[f"seed {run.seed}"], [f"seed {other.seed}"]]
    assert asked == [run.seed, other.seed]
    monkeypatch.setattr(feasibility, "run_in_process", lambda _: None)
    assert one(run) == [f"seed {run.seed}"]
    assert asked == [run.seed, other.seed, run.seed]
