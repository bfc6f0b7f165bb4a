"""The parts of a bag that enter a request: frames and history up to a time, and nothing later."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.bag.types import serialize, typestore
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from ssp_core.vocabulary import Verdict
from ssp_eval.labels.truth import truth_from_bag
from ssp_eval.recordings import clip as question
from ssp_eval.recordings.clip import Clip, NoQuestion, Question
from ssp_vla_bridge.messages import request_problems
from ssp_vla_bridge.window import Preprocessing

BagMaker = Callable[..., Path]
START_NS = 500_000_000
DEFAULT_RULES = Preprocessing()


@pytest.fixture
def clip(make_bag: BagMaker) -> Clip:
    return Clip(make_bag())


def question_at(clip: Clip, t_s: float, rules: Preprocessing = DEFAULT_RULES) -> Question:
    question = clip.question(t_s, rules)
    assert isinstance(question, Question), question
    return question


def test_facts_of_a_session(clip: Clip) -> None:
    facts = clip.provenance
    assert (facts.scenario, facts.domain, facts.verdict) == ("cut_in", "simulation", "valid")
    assert facts.ego == facts.camera == "measured"
    assert facts.refusal is None
    # The session runs from the 25th step of 20 ms on.
    assert clip.start_ns == START_NS
    assert clip.first_s == pytest.approx(-0.5)
    assert clip.last_s == pytest.approx(8.9)


def test_a_request_holds_the_last_second_and_the_ego_history(clip: Clip) -> None:
    question = question_at(clip, 4.03)
    request = question.request
    assert question.t_s == pytest.approx(4.0)
    assert request.stamp_ns == START_NS + 4_000_000_000
    stamps = [(frame.stamp_ns - START_NS) / 1e9 for frame in request.frames]
    assert stamps == pytest.approx([3.1 + 0.1 * k for k in range(10)])
    history = request.history
    assert [s.t_s for s in history] == pytest.approx([-2.0 + 0.1 * k for k in range(21)])
    # 10 m/s straight on: the past lies behind the origin.
    assert [s.x_m for s in history] == pytest.approx([-20.0 + k for k in range(21)])
    assert all(abs(s.y_m) < 1e-9 and s.speed_mps == 10.0 for s in history)
    assert request.ego_provenance == "measured"
    assert request_problems(request) == ()


def test_camera_geometry_and_mount(clip: Clip) -> None:
    request = question_at(clip, 4.0).request
    assert request.camera is not None
    assert clip.mount is not None
    assert request.camera.width_px == 96
    assert request.camera.fx_px == pytest.approx(48.0 / math.tan(math.radians(37.5)))
    assert request.camera.height_m == pytest.approx(1.45)
    assert request.camera.pitch_down_rad == pytest.approx(0.03)
    assert clip.mount.forward_m == pytest.approx(1.8)


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(t_s=st.floats(-1.0, 12.0, allow_nan=False))
def test_nothing_later_than_the_label_enters_a_request(clip: Clip, t_s: float) -> None:
    question = clip.question(t_s)
    limit_ns = START_NS + t_s * 1e9 + 0.5
    if isinstance(question, NoQuestion):
        assert t_s < -0.5 or t_s > 8.9 + 0.11
        return
    request = question.request
    assert request.stamp_ns <= limit_ns
    assert question.t_s <= t_s + 1e-9
    assert all(frame.stamp_ns <= request.stamp_ns for frame in request.frames)
    assert request.frames[-1].stamp_ns == request.stamp_ns
    assert all(sample.t_s <= 0.0 for sample in request.history)
    assert request_problems(request) == ()


def test_the_start_of_a_clip_has_less_to_show(clip: Clip) -> None:
    request = question_at(clip, -0.5).request
    assert len(request.frames) == 1
    assert [sample.t_s for sample in request.history] == [0.0]


def test_preprocessing_is_a_choice(make_bag: BagMaker) -> None:
    rules = Preprocessing(frames=3, frame_spacing_s=0.2, history_s=0.5)
    with Clip(make_bag()) as clip:
        request = question_at(clip, 4.0, rules).request
        # The same clip serves models of other interfaces.
        assert len(question_at(clip, 4.0).request.frames) == 10
        stamps = [(frame.stamp_ns - START_NS) / 1e9 for frame in request.frames]
        assert stamps == pytest.approx([3.6, 3.8, 4.0])
        assert len(request.history) == 6
    assert rules.sha256 != Preprocessing().sha256


def test_too_old_a_frame_asks_nothing(clip: Clip) -> None:
    question = clip.question(9.5)
    assert isinstance(question, NoQuestion)
    assert "0.600 s old" in question.reason


def test_verdicts_other_than_valid_refuse(make_bag: BagMaker) -> None:
    bag = make_bag(verdict=Verdict.FAILED_SAFETY, reasons=("separation 0.3 m under 0.5 m",))
    with Clip(bag) as clip:
        refusal = clip.provenance.refusal
    assert refusal is not None
    assert "failed_safety" in refusal
    assert "separation" in refusal
    with Clip(make_bag("cut", verdict=Verdict.NONE)) as clip:
        assert "before the run got a verdict" in (clip.provenance.refusal or "")


def test_what_the_runner_says_afterwards_refuses_too(make_bag: BagMaker) -> None:
    bag = make_bag()
    verdict = {"schema": "ssp.verdict/1", "verdict": "valid", "reasons": []}
    (bag / "verdict.json").write_text(json.dumps(verdict))
    with Clip(bag) as clip:
        assert clip.provenance.refusal is None
    verdict |= {"verdict": "invalid_harness", "reasons": ["monitor did not stop"]}
    (bag / "verdict.json").write_text(json.dumps(verdict))
    with Clip(bag) as clip:
        refusal = clip.provenance.refusal
    assert refusal is not None
    assert "invalid_harness" in refusal
    assert "monitor did not stop" in refusal
    (bag / "verdict.json").write_text('{"schema": "ssp.verdict/1", "verdict": "fine"}')
    with pytest.raises(InputError, match="no verdict of a run"):
        Clip(bag)


def test_no_frames_no_bag_and_no_attachment_are_said(make_bag: BagMaker, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no camera frames"):
        Clip(make_bag("blind", frames=False))
    (tmp_path / "text.txt").write_text("no bag")
    with pytest.raises(InputError):
        Clip(tmp_path / "text.txt")
    with pytest.raises(InputError, match="is not there"):
        Clip(tmp_path / "nowhere")
    with BagWriter(tmp_path / "bare") as writer:
        writer.add_topic("/chatter", "std_msgs/msg/String")
    with pytest.raises(InputError, match=r"run\.yaml"):
        Clip(tmp_path / "bare")


def test_ground_truth_of_a_session(make_bag: BagMaker) -> None:
    truth = truth_from_bag(make_bag())
    assert truth.series[0][0] == pytest.approx(0.0)
    assert truth.target_ids == ("ot1",)
    assert truth.start_s == 0.0
    assert truth.end_s == pytest.approx(8.9)
    assert truth.hfov_rad == pytest.approx(math.radians(75.0))


def imported(path: Path, ego: str, frames: int = 30) -> Path:
    """A bag as `ssp import-video` writes it, with or without declared motion."""
    types = typestore().types
    facts = {
        "schema": "ssp.import/1",
        "source": {"name": "a.mp4", "sha256": "sha256:0", "width_px": 8, "height_px": 8},
        "crop": {"start_s": 0.0, "end_s": 3.0},
        "generator": "made up",
        "domain": "synthetic",
        "scenario": None,
        "event_version": None,
        "ego": {"provenance": ego, "speed_mps": 10.0 if ego == "declared" else None},
        "camera": {
            "provenance": "unknown",
            "hfov_deg": None,
            "height_m": None,
            "pitch_down_rad": None,
        },
    }
    with BagWriter(path) as writer:
        writer.attach("import.json", json.dumps(facts).encode(), "application/json")
        topic = "/ssp/vut/front_camera/image/compressed"
        writer.add_topic(topic, "sensor_msgs/msg/CompressedImage")
        jpeg = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
        for k in range(frames):
            stamp_ns = 10**9 + k * 10**8
            time = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
            header = types["std_msgs/msg/Header"](stamp=time, frame_id="camera")
            image = types["sensor_msgs/msg/CompressedImage"](
                header=header, format="jpeg", data=np.frombuffer(jpeg, np.uint8)
            )
            writer.write(topic, serialize(image), stamp_ns, stamp_ns)
    return path


def test_an_imported_video_starts_at_its_first_frame(tmp_path: Path) -> None:
    with Clip(imported(tmp_path / "video", "unknown")) as clip:
        facts = clip.provenance
        assert (facts.verdict, facts.refusal, facts.scenario) == (None, None, None)
        assert (clip.first_s, clip.start_ns) == (0.0, 10**9)
        request = question_at(clip, 1.0).request
    # Nothing is known about the motion or the camera, and nothing is made up.
    assert request.history == ()
    assert request.ego_provenance == "unknown"
    assert request.camera is None
    with pytest.raises(InputError, match="holds no states"):
        truth_from_bag(tmp_path / "video")


def test_a_question_is_made_once_for_models_of_the_same_rules(clip: Clip) -> None:
    rules, others = Preprocessing(frames=2), Preprocessing(frames=3)
    first = clip.question(3.0, rules)
    assert clip.question(3.0, rules) is first
    other = clip.question(3.0, others)
    assert isinstance(first, Question)
    assert isinstance(other, Question)
    assert [len(one.request.frames) for one in (first, other)] == [2, 3]
    again = clip.question(3.0, rules)
    assert again is not first
    assert again == first
    clip.forget_questions()
    assert clip.question(3.0, rules) is not again


def test_no_more_questions_are_kept_than_there_is_room_for(
    clip: Clip, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = clip.question(3.0)
    assert isinstance(first, Question)
    size = sum(len(frame.jpeg) for frame in first.request.frames)
    monkeypatch.setattr(question, "_MOST_BYTES", size)
    clip.forget_questions()
    kept, beyond = clip.question(3.0), clip.question(4.0)
    assert clip.question(3.0) is kept
    assert clip.question(4.0) is not beyond
    assert clip.question(4.0) == beyond
