"""``ssp package log-change``: what is entered is checked against what was compiled and executed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_core.run_file.model import RunSpec, load_run
from ssp_scenario_manager.compile.changes import differences, explained
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.event_spec.log import read_log

Maker = Callable[..., Path]
FIELD = "limits.speed_mps"


def log(folder: Path, *more: str, field: str = FIELD, old: str = "20", new: str = "12") -> int:
    given = {"--field": field, "--old": old, "--new": new, "--who": "A. Engineer"}
    options = [word for pair in given.items() for word in pair]
    return main(["package", "log-change", str(folder), *options, "--reason", "wet road", *more])


def content(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def set_run(folder: Path, **limits: float) -> None:
    run = json.loads((folder / "run.yaml").read_text())
    run["limits"].update(limits)
    (folder / "run.yaml").write_text(json.dumps(run))


def unexplained(folder: Path, executed: RunSpec) -> list[str]:
    run = explained(load_task(folder).run, read_log(folder / "log.jsonl"))
    return [difference.field for difference in differences(run, executed)]


def test_an_applied_change_is_in_the_run_and_explained(
    make_task: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_task()
    assert log(folder, "--apply", "--when", "2025-03-01T10:00:00Z", "--json") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["applied"] is True
    assert said["later"] is False
    record = said["record"]
    assert (record["old"], record["new"], record["field"]) == (20.0, 12.0, FIELD)
    assert record["version"] == load_task(folder).version
    run = load_run(folder / "run.yaml")
    assert run.limits.speed_mps == 12.0
    assert unexplained(folder, run) == []
    assert [r.kind for r in read_log(folder / "log.jsonl")] == ["tuning", "site_change"]


def test_changes_follow_each_other(make_task: Maker, capsys: pytest.CaptureFixture[str]) -> None:
    folder = make_task()
    assert log(folder, "--apply") == 0
    assert log(folder, "--apply", old="20", new="10") == 1
    assert "was 12.0 by task.json and log.jsonl" in capsys.readouterr().err
    assert log(folder, "--apply", old="12.0", new="10") == 0
    assert log(folder, "--apply", field="triggers[0].condition.below_m", old="15", new="16") == 0
    run = load_run(folder / "run.yaml")
    assert (run.limits.speed_mps, run.triggers[0].condition.model_dump()["below_m"]) == (10.0, 16.0)
    assert unexplained(folder, run) == []


def test_a_change_made_by_hand_is_only_entered(
    make_task: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_task()
    set_run(folder, speed_mps=12.0)
    before = (folder / "run.yaml").read_bytes()
    assert unexplained(folder, load_run(folder / "run.yaml")) == [FIELD]
    assert log(folder) == 0
    assert "still says" not in capsys.readouterr().err
    assert (folder / "run.yaml").read_bytes() == before
    assert unexplained(folder, load_run(folder / "run.yaml")) == []


def test_a_change_yet_to_be_made_is_pointed_out(
    make_task: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    assert log(make_task()) == 0
    assert "still says 20.0; edit it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"old": "19"}, "was 20.0 by task.json"),
        ({"new": "20.0"}, "changes nothing"),
        ({"new": "-3"}, "greater than or equal to 0.1"),
        ({"new": "fast"}, "valid number"),
        ({"field": "limits.speed"}, "did you mean limits.speed_mps"),
        ({"field": "seed", "old": "1", "new": "2"}, "a run's own"),
        ({"field": "site_version", "old": "x", "new": "y"}, "compile the event again"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(
    changes: dict[str, str],
    message: str,
    make_task: Maker,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = make_task()
    before = content(folder)
    assert log(folder, "--apply", **changes) == 1
    error = capsys.readouterr().err
    assert message in error
    assert "Traceback" not in error
    assert content(folder) == before


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--when", "this morning"), "ISO 8601"),
        (("--when", "2099-01-01"), "ISO 8601"),
        (("--when", "2999-01-01T10:00:00Z"), "lies in the future"),
        (("--when", "2999-01-01T10:00:00+00:00"), "by this clock it is 2"),
        (("--who", " "), "is empty"),
        (("--reason", "  "), "is empty"),
    ],
)
def test_when_who_and_why_must_be_given(
    more: tuple[str, ...], message: str, make_task: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_task()
    before = content(folder)
    assert log(folder, *more) == 1
    assert message in capsys.readouterr().err
    assert content(folder) == before


def test_a_third_value_in_the_run_is_refused(
    make_task: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_task()
    set_run(folder, speed_mps=17.0)
    before = content(folder)
    assert log(folder, "--apply") == 1
    assert "is 17.0, which is neither" in capsys.readouterr().err
    assert content(folder) == before


def test_a_broken_seal_or_log_is_refused(
    make_task: Maker, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = make_task()
    task = (folder / "task.json").read_text()
    (folder / "task.json").write_text(task.replace('"seed": 1', '"seed": 2', 1))
    assert log(folder) == 1
    assert "was changed after it was compiled" in capsys.readouterr().err
    (folder / "task.json").write_text(task)
    with (folder / "log.jsonl").open("a") as stream:
        stream.write("{\n")
    assert log(folder) == 1
    assert "log.jsonl:2" in capsys.readouterr().err


@pytest.mark.parametrize("folder", ["run", "run/task"])
def test_a_forgotten_change_is_entered_beside_the_recording(
    folder: str,
    make_task: Maker,
    make_bag: Maker,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    task = make_task("run/task")
    set_run(task, speed_mps=12.0)
    bag = make_bag("run/bag", task=task, duration_s=0.1)
    before = content(bag)
    assert log(tmp_path / folder, "--apply") == 1
    assert "can be entered now, but not made" in capsys.readouterr().err
    assert log(tmp_path / folder, new="13") == 1
    assert "was 12.0 in the run that was recorded" in capsys.readouterr().err
    assert log(tmp_path / folder) == 0
    assert "entered after the run" in capsys.readouterr().err
    record = read_log(task / "log.jsonl")[-1]
    assert record.details["entered"] == "after the run"
    assert content(bag) == before


def test_a_folder_that_was_not_compiled_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    for folder, why in (
        (tmp_path, "holds no task.json"),
        (tmp_path / "nothing", "is not there"),
        (tmp_path / "file", "is no folder"),
    ):
        assert log(folder) == 1
        assert f"{folder}: {why}; give a folder of `ssp compile`" in capsys.readouterr().err


def test_a_missing_option_is_wrong_usage(make_task: Maker) -> None:
    assert main(["package", "log-change", str(make_task()), "--field", FIELD]) == 2
