"""A recorded session in one process: its bag, its messages, and its command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import serialize, typestore
from ssp_core.motion.event import PhaseBegan
from ssp_core.run_file.model import Camera, Fault, RunSpec
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.vocabulary import Phase, SessionPhase, Verdict
from ssp_core.world.camera import Intrinsics
from ssp_core.world.camera_messages import encode_camera_info, encode_frame
from ssp_core.world.event_messages import encode_fault, encode_limit, encode_phase
from ssp_core.world.plant import FaultFact, LimitFact
from ssp_scenario_manager.cli.run import run as run_command
from ssp_scenario_manager.run.sweep import for_one_process, run_one
from ssp_scenario_manager.session.messages import encode_session_state, encode_trigger
from ssp_scenario_manager.session.outbox import StateChanged, TriggerDecision
from ssp_scenario_manager.triggers.conditions import Sample

S = 10**9
PASSED = LimitFact(SafetyCode.SEPARATION, "sil_world", "ot1", 0.4, 0.5, 7 * S + 3, "näher")
CHANGE = StateChanged(
    5,
    SessionPhase.FINISHED,
    SessionPhase.STOPPING,
    "finish",
    "ends",
    Verdict.OFF_SPEC,
    ("first", "second, longer"),
)
FIRED = TriggerDecision(
    9 * S,
    "t1",
    "gap < 18 m",
    18.0,
    (Sample(8 * S, 18.1), Sample(9 * S, 17.9)),
    8 * S + 5,
    9 * S,
    ("ot1", "ot22"),
    ("ref",),
)


@pytest.fixture
def spec(run: RunSpec) -> RunSpec:
    """A run that a few seconds are enough for, with a small camera."""
    fault = Fault(kind="operator_abort", at_s=0.6)
    small = Camera(width_px=160, height_px=96)
    limits = run.limits.model_copy(update={"jump_m": 1.0, "frozen_s": 0.3})
    changed = {"faults": [fault], "camera": small, "limits": limits}
    filmed = run.model_copy(update=changed)
    return for_one_process(filmed, camera=True)


@pytest.mark.parametrize(
    ("msgtype", "data", "fields"),
    [
        (
            "ssp_msgs/msg/PhaseEvent",
            encode_phase(PhaseBegan(77, Phase.RESOLUTION, "TTC 3 s")),
            {"phase": 4, "evidence": "TTC 3 s", "provisional": True},
        ),
        (
            "ssp_msgs/msg/SafetyEvent",
            encode_limit(PASSED, "local_stop"),
            {
                "code": SafetyCode.SEPARATION,
                "measured": 0.4,
                "limit": 0.5,
                "reaction": "local_stop",
                "limit_name": MEANINGS[SafetyCode.SEPARATION].limit_name,
                "words": "näher",
                "unit": "m",
                "source": "sil_world",
                "object_id": "ot1",
            },
        ),
        (
            "ssp_msgs/msg/SafetyEvent",
            encode_limit(PASSED, name="disk_left", unit="s"),
            {"limit_name": "disk_left", "unit": "s", "reaction": "abort"},
        ),
        (
            "ssp_msgs/msg/FaultEvent",
            encode_fault(FaultFact("w", "0 link_delay", "ot1", True, 0.06, "s", 3)),
            {
                "source": "w",
                "fault": "0 link_delay",
                "target": "ot1",
                "active": True,
                "value": 0.06,
                "unit": "s",
            },
        ),
        (
            "ssp_msgs/msg/SessionState",
            encode_session_state(CHANGE, None),
            {
                "state": 7,
                "previous": 6,
                "event": "finish",
                "reason": "ends",
                "run_id": "",
                "verdict": 5,
                "reasons": ["first", "second, longer"],
            },
        ),
        (
            "ssp_msgs/msg/TriggerEvent",
            encode_trigger(FIRED, 0.25),
            {
                "trigger_id": "t1",
                "condition": "gap < 18 m",
                "threshold": 18.0,
                "processing": 0.25,
                "object_ids": ["ot1", "ot22"],
                "reference_ids": ["ref"],
            },
        ),
        ("sensor_msgs/msg/CompressedImage", encode_frame(3, b"\xff\xd8abc"), {"format": "jpeg"}),
        (
            "sensor_msgs/msg/CameraInfo",
            encode_camera_info(3, Intrinsics(640, 360, 500.0, 501.0, 320.0, 180.0)),
            {"width": 640, "height": 360, "distortion_model": "plumb_bob", "binning_x": 0},
        ),
    ],
)
def test_a_message_is_the_one_that_another_encoder_writes(
    msgtype: str, data: bytes, fields: dict[str, Any]
) -> None:
    message = typestore().deserialize_cdr(data, msgtype)
    assert {name: getattr(message, name) for name in fields} == fields
    assert serialize(message) == data
    frame = message.header.frame_id  # type: ignore[attr-defined]  # made at run time
    assert frame == ("vut/front_camera_optical" if msgtype.startswith("sensor") else "map")


def test_equal_runs_leave_equal_bags_that_say_how_they_ended(spec: RunSpec, tmp_path: Path) -> None:
    told = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        told.append(run_one(spec, tmp_path / name, False, recorded=True))
    assert told[0] == told[1]
    assert told[0]["verdict"] == "aborted"
    files = sorted(path.name for path in (tmp_path / "a" / "bag").iterdir())
    assert files == ["bag_0.mcap", "metadata.yaml", "verdict.json"]
    for file in files:
        assert (tmp_path / "a/bag" / file).read_bytes() == (tmp_path / "b/bag" / file).read_bytes()
    with BagReader(tmp_path / "a" / "bag") as bag:
        counts = {name: topic.count for name, topic in bag.topics.items()}
        report = json.loads(bag.attachment("recording.json") or b"")
        verdict = json.loads(bag.attachment("verdict.json") or b"")
    assert (report["received"], report["lost"]) == (sum(counts.values()), 0)
    assert verdict["verdict"] == "aborted"
    assert verdict["reasons"] == told[0]["reasons"]
    assert counts["/ssp/vut/front_camera/image/compressed"] >= 6
    assert counts["/ssp/world/tick"] == counts["/clock"] > 30
    assert counts["/ssp/session_state"] >= 6
    # Only the wall clock has something to say of these.
    assert {t for t, n in counts.items() if n == 0} >= {
        "/ssp/manager/heartbeat_reply",
        "/ssp/manager/link_status",
        "/ssp/recorder_status",
    }


def test_without_a_camera_nothing_is_drawn(spec: RunSpec, tmp_path: Path) -> None:
    run_one(for_one_process(spec), tmp_path, False, recorded=True)
    with BagReader(tmp_path / "bag") as bag:
        assert not [name for name in bag.topics if "camera" in name]


@pytest.mark.parametrize(
    "arguments",
    [["--record"], ["--record", "--in-process", "--runs", "2"]],
    ids=["processes", "sweep"],
)
def test_only_one_run_of_one_process_is_recorded_so(arguments: list[str]) -> None:
    result = CliRunner().invoke(run_command, ["cut_in", *arguments])
    assert result.exit_code == 2
    assert "--record goes with --in-process, and with one run" in result.output
