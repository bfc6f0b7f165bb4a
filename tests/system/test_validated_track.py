"""METHOD 2's order: simulation first, then the track task with the anchors it validated."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_scenario_manager.compile.compiler import LOGGED_AS
from ssp_scenario_manager.compile.task import TASK_FOLDER, load_task
from ssp_scenario_manager.event_spec.log import parse_log, read_log
from tests.system.recordings import Recordings


def compile_to(folder: Path, event: str, target: str, site: str, *more: str) -> int:
    arguments = ["--target", target, "--site", site, "--out", str(folder), *more]
    return main(["compile", event, *arguments])


def change(file: Path, *path: str | int, value: object) -> None:
    content = json.loads(file.read_text())
    node: Any = content
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    file.write_text(json.dumps(content))


def test_a_simulation_run_validates_the_anchors_of_a_track_task(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    event, run = str(recordings.k_star("vru_crossing")), tmp_path / "simrun"
    shutil.copytree(recordings.get("vru_crossing", "simulation"), run)

    # The bag carries its task, as it was compiled and as it was run.
    task = load_task(run / TASK_FOLDER)
    with BagReader(run / "bag") as bag:
        for name in ("task.json", "event.yaml", "site.yaml", "log.jsonl"):
            assert bag.attachment(name) == (run / TASK_FOLDER / name).read_bytes()
        executed = json.loads(bag.attachment("run.yaml") or b"")
    assert executed["task_version"] == task.version

    validated = ("--validated-by", str(run))
    assert compile_to(tmp_path / "track", event, "track", "north_track", *validated) == 0
    track = load_task(tmp_path / "track")
    assert track.validated_by is not None
    assert (track.validated_by.run_id, track.validated_by.task_version) == (
        executed["run_id"],
        task.version,
    )
    chosen = {tuning.field: tuning.value for tuning in task.tunings}
    for tuning in track.tunings:
        if tuning.field.startswith("constraints."):
            assert tuning.value == chosen[tuning.field]
            assert tuning.reason == "validated in simulation"
    (record,) = [r for r in read_log(tmp_path / "track" / "log.jsonl") if r.kind == "validation"]
    assert (record.who, record.new) == (LOGGED_AS, executed["run_id"])
    assert "not validated" not in (tmp_path / "track" / "task.html").read_text()

    # What validates nothing.
    capsys.readouterr()
    assert compile_to(tmp_path / "no", "cut_in", "track", "north_track", *validated) == 1
    assert "is of another K* version" in capsys.readouterr().err
    change(run / "result.json", "verdict", value="aborted")
    assert compile_to(tmp_path / "no", event, "track", "north_track", *validated) == 1
    assert "can't validate anything" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_a_run_that_was_changed_on_site_validates_nothing(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    event, run = str(recordings.k_star("cut_in")), recordings.changed
    with BagReader(run / "bag") as bag:
        assert parse_log((bag.attachment("log.jsonl") or b"").decode(), "log.jsonl")
    validated = ("--validated-by", str(run))
    assert compile_to(tmp_path / "no", event, "track", "north_track", *validated) == 1
    assert "was run otherwise than compiled" in capsys.readouterr().err
