"""Whole sessions: valid, reported as JSON, and with a bag that others can read."""

from __future__ import annotations

import importlib
import json
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader

from ssp_core.files.folders import TAKEN_FILE, taken_folder
from ssp_core.run_file.model import RunSpec, load_run
from ssp_core.safety.object_rules import rules_of
from tests.support.bags.messages import messages
from tests.support.bags.of_events import check_event
from tests.system.recordings import SAID_FILE, Recordings, ssp


@pytest.mark.ros
@pytest.mark.system
def test_a_recording_holds_the_event(recordings: Recordings) -> None:
    folder = recordings.session("cut_in", "simulation")
    result = json.loads((folder / "result.json").read_text())
    assert json.loads((folder / SAID_FILE).read_text()) == result
    check_event(folder, result)
    rules = messages(folder / "bag", "/ssp/ot1/rules")
    assert [m.digest for m in rules] == [rules_of(load_run(folder / "run.yaml"), "ot1").digest]


def test_a_recording_of_one_process_holds_the_event(recordings: Recordings) -> None:
    """The session is that of a track, over whose links states are lost."""
    folder = recordings.get("vru_crossing", "physical")
    check_event(folder, json.loads((folder / "result.json").read_text()))


@pytest.mark.ros
@pytest.mark.system
def test_the_bag_reads_with_types_from_the_file_and_agrees_with_its_metadata(
    recordings: Recordings,
) -> None:
    bag = recordings.session("cut_in", "simulation") / "bag"
    listed = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    with AnyReader([bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        decoded = dict.fromkeys(counts, 0)
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
            decoded[connection.topic] += 1
    in_metadata = {
        t["topic_metadata"]["name"]: t["message_count"] for t in listed["topics_with_message_count"]
    }
    assert decoded == counts == in_metadata
    assert listed["message_count"] == sum(decoded.values())
    assert decoded["/ssp/vut/front_camera/image/compressed"] > 100
    frames = messages(bag, "/ssp/vut/front_camera/image/compressed")
    stamps = [f.header.stamp.sec * 10**9 + f.header.stamp.nanosec for f in frames]
    moving = [s for s in stamps if s > 0]
    assert {b - a for a, b in pairwise(moving)} == {100_000_000}


def test_a_folder_that_holds_something_is_refused(
    recordings: Recordings, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    assert ssp("run", recordings.task("cut_in"), "--out", tmp_path) == 1
    assert "is not empty" in capsys.readouterr().err
    assert (tmp_path / "mine.txt").read_text() == "keep"
    assert len(list(tmp_path.iterdir())) == 1


def test_of_two_runs_into_one_new_folder_the_later_is_refused(
    recordings: Recordings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """They would destroy each other's recording. Both find it empty; one gets it."""
    folder, task = tmp_path / "run", recordings.task("cut_in")
    module = importlib.import_module("ssp_scenario_manager.cli.run")
    prepare = module.prepare_run
    with ExitStack() as other:

        def prepare_while_another_begins(*given: Any, **options: Any) -> RunSpec:
            other.enter_context(taken_folder(folder, empty=True))
            return prepare(*given, **options)

        monkeypatch.setattr(module, "prepare_run", prepare_while_another_begins)
        assert ssp("run", task, "--no-camera", "--out", folder) == 1
        assert f"{folder}: is in use: another command is writing into it" in capsys.readouterr().err
        assert [entry.name for entry in folder.iterdir()] == [TAKEN_FILE]
