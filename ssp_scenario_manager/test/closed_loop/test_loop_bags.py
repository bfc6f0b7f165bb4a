"""The bags of a campaign: written as its runs are driven, the same where they are made later."""

from __future__ import annotations

import json
import shutil
import sys
from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from ssp_core.bag.operations.check import check_bag
from ssp_core.errors import HostError
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.cli.loop import loop
from ssp_scenario_manager.closed_loop.campaigns import disk_room, row_bags
from ssp_scenario_manager.closed_loop.campaigns.bags import bag_rows, write_bags
from ssp_scenario_manager.closed_loop.campaigns.campaign import run_campaign
from ssp_scenario_manager.closed_loop.campaigns.plan_file import LoopPlan
from ssp_scenario_manager.closed_loop.campaigns.row_bags import Bags, bag_folder
from ssp_scenario_manager.closed_loop.campaigns.runs import jobs_of, rows_of
from ssp_scenario_manager.closed_loop.campaigns.seal import sealed_plan, sealed_starts
from ssp_scenario_manager.closed_loop.outcomes.tables import read_row, rows_there
from ssp_scenario_manager.run.report import measured

PLAN = {
    "schema": "ssp.loop/1",
    "events": ["cut_in"],
    "latencies": ["zero", "fixed:1"],
    "starts": 1,
    "others": 0,
}
# Rows of no_response, which drives once for both latencies, and of two drivers by plans.
SOME = (1, 2, 4, 9)
Usage = namedtuple("Usage", "total used free")


def run(folder: Path, bags: Bags) -> list[str]:
    """Run the campaign; gives what it said."""
    said: list[str] = []
    folder.mkdir(parents=True, exist_ok=True)
    plan = LoopPlan.model_validate(PLAN)
    run_campaign(plan, folder, 1, lambda *_: None, said.append, bags=bags)
    return said


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a campaign that recorded each run as it was driven."""
    folder = tmp_path_factory.mktemp("loop") / "campaign"
    said = run(folder, "all")
    assert any(one.startswith("bags of 14 runs take about 0.01 GB; ") for one in said), said
    return folder


@pytest.fixture
def bare(recorded: Path, tmp_path: Path) -> Path:
    """The same campaign without its bags."""
    return shutil.copytree(recorded, tmp_path / "bare", ignore=shutil.ignore_patterns("bags"))


def files(folder: Path) -> dict[str, bytes]:
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def numbers(folder: Path, which: Bags) -> list[int]:
    return list(bag_rows(sealed_plan(folder)[0], rows_there(folder / "runs.csv"), which))


def test_each_run_leaves_its_bag_as_it_is_driven(recorded: Path) -> None:
    there = [int(path.name) for path in sorted((recorded / "bags").iterdir())]
    assert there == numbers(recorded, "all")
    for number in there:
        place = bag_folder(recorded, number)
        report = check_bag(place / "bag")
        assert report.ok, report
        assert set(files(place)) == {
            *("bag/bag_0.mcap", "bag/metadata.yaml", "bag/verdict.json"),
            *("result.json", "run.yaml", "top_view.svg"),
            *(f"task/{name}" for name in ("event.yaml", "log.jsonl", "site.yaml", "task.json")),
        }


def test_a_bag_that_is_made_later_has_the_same_bytes(recorded: Path, bare: Path) -> None:
    assert write_bags(bare, SOME, 1, lambda *_: None) == []
    for number in SOME:
        first, later = (files(bag_folder(folder, number)) for folder in (recorded, bare))
        assert [name for name in first if first[name] != later.get(name)] == []
        assert first.keys() == later.keys()


def test_what_is_measured_of_a_run_is_what_its_bag_holds(recorded: Path) -> None:
    for number in SOME:
        place = bag_folder(recorded, number)
        told = json.loads((place / "result.json").read_text())["measured"]
        read = measured(place / "bag", load_run(place / "run.yaml"), lambda _: None)
        assert told == json.loads(json.dumps(read))
        assert told["states"]["vut"]["received"] > 900
        assert [one["no_onset"] for one in told["triggers"][0]["references"]] == [None]


@pytest.mark.parametrize("which", ["failed", "none"])
def test_runs_that_need_no_bag_leave_none(recorded: Path, tmp_path: Path, which: Bags) -> None:
    """A later start has the bags of runs that fail, without drivers that must."""
    plan, starts = sealed_plan(recorded)[0], sealed_starts(recorded)
    second = [starts[0] | {"hash": "another"}, *starts]
    shutil.copytree(recorded / "tasks", tmp_path / "tasks")
    jobs = [job for job in jobs_of(plan, second, tmp_path, which) if "another" not in job.start]
    made = {job.driver.driver: rows_of(job).rows for job in jobs if job.driver.driver != "careful"}
    left = [int(path.name) for path in tmp_path.glob("bags/*")]
    failed = [
        job.first_row + k
        for job in jobs
        for k, row in enumerate(made.get(job.driver.driver, ()))
        if job.driver.driver in ("constant_velocity", "aeb", "oracle", "built_in")
        and not read_row(row).succeeds
    ]
    assert sorted(left) == (failed if which == "failed" else [])
    assert failed


def test_a_bag_that_the_disk_does_not_take_costs_no_row(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, starts = sealed_plan(recorded)[0], sealed_starts(recorded)
    shutil.copytree(recorded / "tasks", tmp_path / "tasks")

    def full(*_: Any) -> None:
        raise HostError("no space left")

    monkeypatch.setattr(row_bags, "leave_view", full)
    (job,) = (
        job
        for job in jobs_of(plan, starts, tmp_path, "all")
        if job.driver.driver == "constant_velocity"
    )
    there = rows_there(recorded / "runs.csv")
    assert rows_of(job).rows == there[job.first_row - 1 : job.first_row - 1 + job.count]
    assert list(tmp_path.glob("bags/*")) == []


def test_bags_of_all_runs_are_refused_before_a_driver_runs_where_the_disk_has_no_room(
    recorded: Path, bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk_room.shutil, "disk_usage", lambda _: Usage(1, 1, 1_002_000_000))
    (bare / "runs.csv").unlink()
    file = tmp_path / "plan.yaml"
    file.write_text(yaml.safe_dump(PLAN))
    command = [str(file), "--out", str(bare)]
    refused = CliRunner().invoke(loop, command, standalone_mode=False)
    assert isinstance(refused.exception, HostError)
    assert "bags of 14 runs take about 0.01 GB; 1.00 GB are free" in str(refused.exception)
    assert "--bags failed or none" in str(refused.exception)
    assert not (bare / "runs.csv").exists()
    # Runs that fail are some of all, and those whose bags are there need no more room.
    jobs = list(jobs_of(LoopPlan.model_validate(PLAN), sealed_starts(bare), bare))
    said: list[str] = []
    disk_room.check_room(jobs, bare, "failed", said.append)
    disk_room.check_room(jobs, bare, "none", said.append)
    disk_room.check_room(jobs, recorded, "all", said.append)
    assert [one.partition(";")[0] for one in said] == ["bags of at most 14 runs take about 0.01 GB"]


def test_the_command_records_each_run_unless_told_otherwise(
    recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []
    command = sys.modules["ssp_scenario_manager.cli.loop"]
    monkeypatch.setattr(command, "write_bags", lambda *given: asked.append(given[1]) or [])
    file = tmp_path / "plan.yaml"
    file.write_text(yaml.safe_dump(PLAN))
    for more, which in (((), "all"), (("--bags", "failed"), "failed")):
        said = CliRunner().invoke(
            loop, [str(file), "--out", str(recorded), *more], standalone_mode=False
        )
        assert (said.exception, said.return_value) == (None, 0)
        assert asked.pop() == numbers(recorded, which)
