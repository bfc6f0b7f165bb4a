"""Runs and sweeps in one process, without ROS: how they end, and what they leave."""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.run_file.model import Fault, LinkDisturbance, RunSpec
from ssp_core.vocabulary import Phase, Verdict
from ssp_scenario_manager.run import sweep as sweep_module
from ssp_scenario_manager.run.in_process import result_json, run_in_process, save_states
from ssp_scenario_manager.run.sweep import Row, Sweep, Variation, for_one_process, run_sweep
from ssp_scenario_manager.session.supervision import ABORT_STANDSTILL_S

MakeRun = Callable[..., RunSpec]


@pytest.fixture
def make_run(run: RunSpec) -> MakeRun:
    """A run that a few seconds are enough for."""

    def make(*faults: Fault, **changes: Any) -> RunSpec:
        limits = run.limits.model_copy(update={"jump_m": 1.0, "frozen_s": 0.3})
        return run.model_copy(update={"faults": list(faults), "limits": limits, **changes})

    return make


def test_a_run_comes_to_its_end_and_says_what_happened(make_run: MakeRun, tmp_path: Path) -> None:
    spec = make_run()
    result, record = run_in_process(spec)
    assert (result.verdict, result.reasons) == (Verdict.VALID, ())
    assert [p.phase for p in result.phases] == [
        Phase.APPROACH,
        Phase.TRIGGER,
        Phase.CONFLICT,
        Phase.RESOLUTION,
    ]
    (fired,) = result.triggers
    assert fired.samples[0].stamp_ns < fired.crossing_ns <= fired.samples[1].stamp_ns
    assert result.passing.other_first is True
    assert result.passing.time_gap_s is not None
    assert 0.0 < result.min_distance_m < 40.0
    assert 0.0 < result.error_rms_m[1] < 0.05
    written = json.loads(json.dumps(result_json(spec, result), allow_nan=False))
    assert (written["verdict"], written["in_process"]) == ("valid", True)
    save_states(tmp_path / "states.npz", spec, record)
    with np.load(tmp_path / "states.npz") as saved:
        steps = len(record.reports)
        assert saved["vut_true"].shape == saved["ot1_arrived"].shape == (steps, 7)
        assert list(saved["columns"][:2]) == ["stamp_ns", "x_m"]
        assert (np.diff(saved["ot1_true"][:, 0]) == 20_000_000).all()


def test_the_same_run_twice_is_the_same(make_run: MakeRun) -> None:
    noisy = make_run(disturbance=LinkDisturbance(position_noise_m=0.03, state_loss=0.05))
    first, second = (run_in_process(noisy) for _ in range(2))
    assert first[0] == second[0]
    assert repr(first[1].reports) == repr(second[1].reports)


@pytest.mark.parametrize(
    ("fault", "verdict", "reason"),
    [
        (Fault(kind="link_cut", target="ot1", at_s=3.0), Verdict.ABORTED, "object_silent"),
        (Fault(kind="state_nan", target="ot1", at_s=3.0), Verdict.FAILED_SAFETY, "not_finite"),
        (Fault(kind="operator_abort", at_s=3.0), Verdict.ABORTED, "abort by operator"),
    ],
)
def test_a_fault_ends_a_run_at_its_time(
    make_run: MakeRun, fault: Fault, verdict: Verdict, reason: str
) -> None:
    result, record = run_in_process(make_run(fault))
    assert result.verdict is verdict
    assert reason in result.reasons[0]
    last = record.reports[-1]
    assert max(s.speed_mps for s in last.truths) < 0.05
    # Without places nobody knows that the object stands: that is waited for.
    wait_s = ABORT_STANDSTILL_S if fault.kind == "state_nan" else 0.0
    assert 3.0 + wait_s < result.session_s < 12.0 + wait_s
    told = [(f.fault, f.active) for f in result.faults]
    assert told == ([] if fault.kind == "operator_abort" else [(f"0 {fault.kind}", True)])


@pytest.mark.parametrize(
    ("fault", "missing"),
    [
        (Fault(kind="link_cut", target="ot1"), "ot1"),
        (Fault(kind="state_nan", target="ot1"), "ot1"),
        (Fault(kind="clock_step", target="ot1", value=0.5), "ot1"),
    ],
)
def test_a_fault_of_the_armed_session_keeps_it_from_starting(
    make_run: MakeRun, fault: Fault, missing: str
) -> None:
    result, record = run_in_process(make_run(fault))
    assert not result.ok
    assert missing in " ".join(result.reasons)
    assert not record.reports


def test_a_trigger_that_is_never_met_ends_the_run_by_its_time(make_run: MakeRun) -> None:
    spec = for_one_process(make_run(Fault(kind="trigger_never")))
    result, _ = run_in_process(spec)
    assert "event_missing" in result.reasons[0]
    assert not result.triggers


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"mode": "realtime"}, "mode"),
        ({"faults": [Fault(kind="kill", target="monitor", at_s=1.0)]}, "faults[0].kind"),
    ],
)
def test_what_needs_processes_is_refused(
    make_run: MakeRun, changes: dict[str, Any], field: str
) -> None:
    spec = make_run().model_copy(update=changes)
    with pytest.raises(InputError) as caught:
        run_in_process(for_one_process(spec))
    assert caught.value.field == field


def test_a_machine_without_ros_can_run_it(make_run: MakeRun, tmp_path: Path) -> None:
    """Nothing on the way imports rclpy or a generated message, nor SUMO without traffic."""
    (tmp_path / "run.json").write_text(make_run().model_dump_json(by_alias=True))
    code = f"""
import sys
for name in ("rclpy", "ssp_msgs", "libsumo"):
    sys.modules[name] = None
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.run.in_process import (run_in_process)
print(run_in_process(load_run({str(tmp_path / "run.json")!r}))[0].verdict.name)
import ssp_scenario_manager.cli.faults
import ssp_scenario_manager.cli.run
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600)
    assert (done.stdout.strip(), done.returncode) == ("VALID", 0), done.stderr


# -- sweeps ------------------------------------------------------------------------------------


def test_a_sweep_has_a_row_per_run_and_the_same_bytes_for_any_number_of_jobs(
    make_run: MakeRun, tmp_path: Path
) -> None:
    spec = make_run(disturbance=LinkDisturbance(position_noise_m=0.02))
    cruise = Variation("driver.cruise_mps", (9.5, 10.5), is_drawn=True)
    sweep = Sweep(spec, (cruise, Variation("limits.jump_m", (1.0, 2.0))), 4)
    seen: list[Row] = []
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    rows = run_sweep(sweep, tmp_path / "one", 1, seen.append)
    run_sweep(sweep, tmp_path / "two", 2, lambda _: None)
    text = (tmp_path / "one" / "runs.csv").read_bytes()
    assert text == (tmp_path / "two" / "runs.csv").read_bytes()
    table = list(csv.DictReader(text.decode().splitlines()))
    assert seen == rows
    assert [(r["run"], r["seed"]) for r in table] == [(str(k), str(k + 1)) for k in range(4)]
    assert [float(r["limits.jump_m"]) for r in table] == [1.0, 2.0, 1.0, 2.0]
    assert {r["verdict"] for r in table} == {"valid"}
    assert len({r["time_gap_s"] for r in table}) == 4
    assert all(math.isfinite(float(r["min_distance_m"])) for r in table)


def short_sweep(make_run: MakeRun, runs: int, seed: int = 1, low: float = 9.5) -> Sweep:
    end = make_run().end.model_copy(update={"at_latest_s": 0.5})
    cruise = Variation("driver.cruise_mps", (low, 10.5), is_drawn=True)
    variations = (cruise, Variation("limits.jump_m", (1.0, 2.0)))
    return Sweep(make_run(end=end, seed=seed), variations, runs)


@pytest.mark.parametrize("cut_bytes", [0, 1, 30])
def test_a_sweep_that_was_interrupted_goes_on_where_it_was(
    make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cut_bytes: int
) -> None:
    for name in ("whole", "part"):
        (tmp_path / name).mkdir()
    whole = short_sweep(make_run, 4)
    rows = run_sweep(whole, tmp_path / "whole", 1, lambda _: None)
    expected = (tmp_path / "whole" / "runs.csv").read_bytes()
    run_sweep(short_sweep(make_run, 2), tmp_path / "part", 1, lambda _: None)
    path = tmp_path / "part" / "runs.csv"
    kept = path.read_bytes()
    assert expected.startswith(kept)
    path.write_bytes(kept[: len(kept) - cut_bytes])
    run_seeds: list[int] = []

    def run_and_count(spec: RunSpec, *given: Any) -> Any:
        run_seeds.append(spec.seed)
        return run_in_process(spec, *given)

    monkeypatch.setattr(sweep_module, "run_in_process", run_and_count)
    seen: list[Row] = []
    run_sweep(whole, tmp_path / "part", 1, seen.append)
    assert path.read_bytes() == expected
    assert seen == rows
    assert run_seeds == ([2, 3, 4] if cut_bytes else [3, 4])
    # Fewer take nothing out.
    assert run_sweep(short_sweep(make_run, 1), tmp_path / "part", 2, lambda _: None) == rows[:1]
    assert path.read_bytes() == expected


def test_the_sweep_of_the_quickstart_is_valid_at_both_ends(tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "quickstart.md"
    ends = re.search(r"--vary (driver\.cruise_mps=[\d.]+):([\d.]+)", page.read_text())
    assert ends is not None
    varied = ["--vary", ",".join(ends.groups()), "--runs", "2"]
    assert main(["run", "cut_in", "--in-process", *varied, "--out", str(tmp_path / "sweep")]) == 0


def test_the_folder_of_another_sweep_is_refused(make_run: MakeRun, tmp_path: Path) -> None:
    run_sweep(short_sweep(make_run, 1), tmp_path, 1, lambda _: None)
    before = (tmp_path / "runs.csv").read_bytes()
    same = short_sweep(make_run, 1)
    for other, file in (
        (short_sweep(make_run, 1, seed=9), "run.yaml"),
        (Sweep(make_run(), same.variations, 1), "run.yaml"),
        (Sweep(same.spec, same.variations[:1], 1), "runs.csv"),
        (short_sweep(make_run, 1, low=9.0), "runs.csv"),
    ):
        with pytest.raises(InputError, match="holds another sweep") as caught:
            run_sweep(other, tmp_path, 1, lambda _: None)
        assert Path(str(caught.value.file)).name == file
    assert (tmp_path / "runs.csv").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--runs", "3"], "need --in-process"),
        (["--vary", "a=1"], "need --in-process"),
        (["--in-process", "--jobs", "2"], "needs --runs or --vary"),
        (["--in-process", "--mode", "realtime"], "always lockstep"),
        (["--in-process", "--runs", "9" * 23], "is not in the range"),
        (["--in-process", "--runs", "2", "--jobs", "9" * 23], "is not in the range"),
    ],
)
def test_options_that_mean_nothing_are_wrong_usage(arguments: list[str], says: str) -> None:
    from ssp_scenario_manager.cli.run import run as command

    done = CliRunner().invoke(command, ["cut_in", *arguments])
    assert done.exit_code == 2
    assert says in done.output


def test_the_world_steps_until_the_session_is_over(make_run: MakeRun) -> None:
    _, record = run_in_process(make_run())
    assert [r.running for r in record.reports[-2:]] == [True, False]
    assert [r.step for r in record.reports] == list(range(1, len(record.reports) + 1))
