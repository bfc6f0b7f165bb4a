"""The same seed gives the same states, whatever the camera, the load and the order of starting;
another seed gives others."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from ssp_core.run_spec import RunSpec, load_run
from ssp_scenario_manager.runner import session as runner

pytestmark = [pytest.mark.ros, pytest.mark.system]

TOPICS = ("/ssp/vut/state", "/ssp/ot1/state", "/ssp/ot1/reference", "/ssp/ot1/reference_ack")


TF = "/tf"


def run_bytes(bag: Path, topic: str) -> list[bytes]:
    """Serialised messages of the run; before it the world holds, and nobody counts how often."""
    with AnyReader([bag]) as reader:
        chosen = [c for c in reader.connections if c.topic == topic]
        kept = []
        for connection, _, raw in reader.messages(connections=chosen):
            message = reader.deserialize(raw, connection.msgtype)
            stamp = (message.transforms[0] if topic == TF else message).header.stamp
            if stamp.sec or stamp.nanosec:
                kept.append(bytes(raw))
        return kept


def matrix(transform: Any) -> np.ndarray:
    """What tf2 makes of a transform: from the child's coordinates to the parent's."""
    v, q = transform.translation, transform.rotation
    whole = np.eye(4)
    whole[:3, :3] = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
    whole[:3, 3] = (v.x, v.y, v.z)
    return whole


def check_frames(bag: Path, spec: RunSpec) -> None:
    """Poses in /tf are those of the states, and the camera looks at the map from where it sits."""
    with AnyReader([bag]) as reader:

        def read(topic: str) -> list[Any]:
            chosen = [c for c in reader.connections if c.topic == topic]
            return [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(chosen)]

        (fixed,) = read("/tf_static")
        pictures, moving = read("/ssp/vut/front_camera/image/compressed"), read(TF)
        poses = {
            (one.child_frame_id, one.header.stamp.sec, one.header.stamp.nanosec): one
            for message in moving
            for one in message.transforms
        }
        assert len(poses) == sum(len(message.transforms) for message in moving), "told once"
        states = {
            object_id: {(s.header.stamp.sec, s.header.stamp.nanosec): s for s in found}
            for object_id in ("vut", "ot1")
            for found in [read(f"/ssp/{object_id}/state")]
        }
    # One message for each step of the world, in which everybody is whose state wasn't lost.
    steps = [message.transforms[0].header.stamp for message in moving]
    assert len({(stamp.sec, stamp.nanosec) for stamp in steps}) == len(steps)
    assert len(poses) > 1.9 * len(steps)
    camera = np.eye(4)
    for one in fixed.transforms:
        camera = camera @ matrix(one.transform)
    assert fixed.transforms[0].header.frame_id == "vut/base_link"
    assert fixed.transforms[-1].child_frame_id == pictures[-1].header.frame_id
    assert spec.camera is not None
    for (child, *at), one in poses.items():
        object_id = child.removesuffix("/base_link")
        state, pose = states[object_id][(at[0], at[1])], matrix(one.transform)
        assert pose[:2, 3] == pytest.approx((state.x, state.y))
        if object_id == "vut":
            seen, ahead = pose @ camera, spec.camera.forward_m
            x, y = math.cos(state.yaw), math.sin(state.yaw)
            assert seen[:3, 3] == pytest.approx(
                (state.x + ahead * x, state.y + ahead * y, spec.camera.height_m)
            )
            level = math.cos(spec.camera.pitch_down_rad)
            down = math.sin(spec.camera.pitch_down_rad)
            assert seen[:3, 2] == pytest.approx((level * x, level * y, -down))


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
    for topic in (*TOPICS, TF):
        ours, theirs = run_bytes(plain.folder / "bag", topic), run_bytes(result.bag, topic)
        # The last messages depend on when the processes were ended.
        common = min(len(ours), len(theirs))
        assert common > (0 if topic.endswith(("reference", "ack")) else 600)
        assert ours[: common - 2] == theirs[: common - 2]
    check_frames(result.bag, filmed)
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
