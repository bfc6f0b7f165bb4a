"""The same seed gives the same states, whatever the camera, the load and the order of starting;
another seed gives others."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader

from ssp_core.run_spec import load_run
from ssp_scenario_manager.runner import session as runner

pytestmark = [pytest.mark.ros, pytest.mark.system]

TOPICS = ("/ssp/vut/state", "/ssp/ot1/state", "/ssp/ot1/reference", "/ssp/ot1/reference_ack")


def run_bytes(bag: Path, topic: str) -> list[bytes]:
    """Serialised messages of the run; before it the world holds, and nobody counts how often."""
    with AnyReader([bag]) as reader:
        chosen = [c for c in reader.connections if c.topic == topic]
        kept = []
        for connection, _, raw in reader.messages(connections=chosen):
            stamp = reader.deserialize(raw, connection.msgtype).header.stamp
            if stamp.sec or stamp.nanosec:
                kept.append(bytes(raw))
        return kept


def test_states_depend_on_the_seed_alone(
    start_session: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a camera, on a busy machine and started the other way round, against neither."""
    plain = start_session("cut_in", "--site", "north_track", "--no-camera", "--seed", "5")
    assert plain.finish()["verdict"] == "valid"
    spec = load_run(plain.folder / "run.yaml")
    assert spec.disturbance.position_noise_m > 0.0
    small = {"width_px": 160, "height_px": 96}
    camera = {**type(spec).model_fields["camera"].get_default().model_dump(), **small}
    filmed = type(spec).model_validate(
        {**spec.model_dump(by_alias=True), "run_id": "filmed", "camera": camera}
    )
    monkeypatch.setattr(runner, "_NODES", dict(reversed(runner._NODES.items())))
    busy: list[subprocess.Popen[bytes]] = []

    def make_busy(line: str) -> None:
        """From the start of the run on: before it, the camera's code may still be compiled."""
        if line == "session RUNNING":
            code = "while True: pass"
            busy.extend(subprocess.Popen([sys.executable, "-c", code]) for _ in range(2))

    folder = tmp_path / "filmed"
    folder.mkdir()
    try:
        result = runner.run_session(filmed, folder, make_busy)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    assert len(busy) == 2
    assert (result.outcome.verdict.name, result.outcome.reasons) == ("VALID", ())
    assert len(run_bytes(result.bag, "/ssp/vut/front_camera/image/compressed")) > 100
    for topic in TOPICS:
        ours, theirs = run_bytes(plain.folder / "bag", topic), run_bytes(result.bag, topic)
        # The last messages depend on when the processes were ended.
        common = min(len(ours), len(theirs))
        assert common > (0 if topic.endswith(("reference", "ack")) else 600)
        assert ours[: common - 2] == theirs[: common - 2]
    other = start_session(
        "cut_in", "--site", "north_track", "--no-camera", "--seed", "6", name="other"
    )
    assert other.finish()["verdict"] == "valid"
    ours, theirs = (run_bytes(s.folder / "bag", TOPICS[0])[:600] for s in (plain, other))
    assert ours != theirs


def test_a_recorder_that_stands_still_for_a_while_loses_nothing_in_lockstep(
    start_session: Any,
) -> None:
    """The world waits for it. What is tested is a stall of a certain length."""
    session = start_session("cut_in", "--no-camera")
    session.wait_for("session RUNNING")
    for _ in range(2):
        session.kill("monitor", signal.SIGSTOP)
        time.sleep(0.5)
        session.kill("monitor", signal.SIGCONT)
    result = session.finish()
    assert (result["verdict"], result["reasons"]) == ("valid", [])
    assert len(run_bytes(session.folder / "bag", "/ssp/vut/state")) > 600
