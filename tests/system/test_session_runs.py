"""Whole sessions: valid, told as JSON, and with a bag that others can read."""

from __future__ import annotations

import json
import subprocess
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.highlevel import AnyReader

from ssp_core.run_file.model import load_run
from ssp_core.safety.object_rules import rules_of
from tests.support.bags import messages
from tests.system.conftest import END_DEADLINE_S, ssp_command
from tests.system.recordings import SAID_FILE, Recordings

pytestmark = [pytest.mark.ros, pytest.mark.system]


# The others are held for the audit too, with a camera.
SHARED = {"boulevard": "simulation", "north_track": "physical"}
NO_OTHER_USE = [
    ("cut_in", "south_loop"),
    ("lead_braking", "boulevard"),
    ("lead_braking", "south_loop"),
    ("occluded_crossing", "boulevard"),
    ("occluded_crossing", "north_track"),
]


@pytest.mark.parametrize(("event", "site"), list(product(("cut_in", "vru_crossing"), SHARED)))
def test_a_recording_holds_the_event(event: str, site: str, recordings: Recordings) -> None:
    folder = recordings.get(event, SHARED[site])
    result = json.loads((folder / "result.json").read_text())
    assert json.loads((folder / SAID_FILE).read_text()) == result
    holds_the_event(folder, result)


@pytest.mark.parametrize(("scenario", "site"), NO_OTHER_USE)
def test_events_compiled_for_sites_are_valid(scenario: str, site: str, start_session: Any) -> None:
    session = start_session(scenario, "--site", site, "--no-camera")
    result = session.finish()
    assert session.process.returncode == 0
    holds_the_event(session.folder, result)


def holds_the_event(folder: Path, result: dict[str, Any]) -> None:
    assert (result["verdict"], result["reasons"]) == ("valid", [])
    bag = folder / "bag"
    phases = [m.phase for m in messages(bag, "/ssp/phase_event")]
    assert phases == [1, 2, 3, 4]
    (trigger,) = messages(bag, "/ssp/trigger_event")
    stamp_ns = trigger.crossing_time.sec * 10**9 + trigger.crossing_time.nanosec
    low, high = (t.sec * 10**9 + t.nanosec for t in trigger.sample_stamps)
    assert low <= stamp_ns <= high
    acks = messages(bag, "/ssp/ot1/reference_ack")
    assert acks
    assert all(a.accepted for a in acks)
    assert {a.reference_id for a in acks} >= set(trigger.reference_ids)
    tracked = [m for m in messages(bag, "/ssp/ot1/state") if m.reference_id]
    assert max(abs(m.error_lateral) for m in tracked) < 0.3
    assert not messages(bag, "/ssp/safety_event")

    measured = result["measured"]
    (fired,) = measured["triggers"]
    (sent,) = fired["references"]
    way = [fired["crossing_s"], fired["judged_s"], fired["dispatched_s"]]
    way += [sent["acknowledged_s"], sent["execute_at_s"], sent["onset"]["at_s"]]
    assert way == sorted(way)
    assert way[-1] - way[-2] < 0.2
    assert measured["tracking"]["ot1"]["lateral_rms_m"] <= 0.05
    assert measured["tracking"]["ot1"]["longitudinal_rms_m"] <= 0.10
    run = load_run(folder / "run.yaml")
    assert [m.digest for m in messages(bag, "/ssp/ot1/rules")] == [rules_of(run, "ot1").digest]
    states = measured["states"]
    assert states.keys() == {"vut", *(target.id for target in run.targets)}
    for name in states:
        # Nothing is lost but what the site's links lose.
        most = 3.0 * run.disturbance_of(name).state_loss * states[name]["received"]
        assert states[name]["lost"] <= most


def test_the_bag_reads_with_types_from_the_file_and_agrees_with_its_metadata(
    recordings: Recordings,
) -> None:
    bag = recordings.get("cut_in", "simulation") / "bag"
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
    holds_the_event(tmp_path / "run", result)
    checked = subprocess.run(ssp_command("bag", "check", str(tmp_path / "run" / "bag")))
    assert checked.returncode == 0
