"""Whole sessions: valid, told as JSON, and with a bag that others can read."""

from __future__ import annotations

import json
import subprocess
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader

from ssp_core.run_file.model import load_run
from ssp_core.safety.object_rules import rules_of
from tests.support.bags import messages
from tests.support.event_bags import check_event
from tests.system.conftest import END_DEADLINE_S, ssp_command
from tests.system.recordings import SAID_FILE, Recordings

pytestmark = [pytest.mark.ros, pytest.mark.system]


@pytest.mark.parametrize(
    ("event", "domain"), [("cut_in", "simulation"), ("vru_crossing", "physical")]
)
def test_a_recording_holds_the_event(event: str, domain: str, recordings: Recordings) -> None:
    folder = recordings.session(event, domain)
    result = json.loads((folder / "result.json").read_text())
    assert json.loads((folder / SAID_FILE).read_text()) == result
    check_event(folder, result)
    run = load_run(folder / "run.yaml")
    rules = messages(folder / "bag", "/ssp/ot1/rules")
    assert [m.digest for m in rules] == [rules_of(run, "ot1").digest]


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


def test_a_folder_that_holds_something_is_refused(start_session: Any, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "mine.txt").write_text("keep")
    session = start_session("cut_in")
    _, err = session.process.communicate(timeout=120)
    assert session.process.returncode == 1
    assert "is not empty" in err
    assert (tmp_path / "run" / "mine.txt").read_text() == "keep"


def test_of_two_runs_into_one_new_folder_one_is_refused_and_the_other_whole(
    start_session: Any, tmp_path: Path
) -> None:
    both = [start_session("cut_in", "--no-camera") for _ in range(2)]
    said = [session.process.communicate(timeout=END_DEADLINE_S)[1] for session in both]
    done, refused = sorted(range(2), key=lambda k: both[k].process.returncode)
    statuses = [both[k].process.returncode for k in (done, refused)]
    assert statuses == [0, 1], said
    assert f"{tmp_path / 'run'}: is what another command writes into" in said[refused]
    assert "Traceback" not in said[refused], said[refused]
    result = json.loads((tmp_path / "run" / "result.json").read_text())
    check_event(tmp_path / "run", result)
    checked = subprocess.run(ssp_command("bag", "check", str(tmp_path / "run" / "bag")))
    assert checked.returncode == 0
