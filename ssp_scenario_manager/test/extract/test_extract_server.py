"""ssp spec extract with a server that answers well, its annotations, and what is no video."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from ssp_core.hashing import sha256_bytes, sha256_file, sha256_json
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.event_spec.load import load_event, uncovered
from ssp_scenario_manager.event_spec.log import Record, append_record, read_log
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Interval
from ssp_scenario_manager.extract.questions import DEFINITION_SHA256
from ssp_scenario_manager.review.session import to_decide
from tests.support.models.extraction import (
    FPS,
    KEYS,
    SHOWN,
    Extraction,
    cells,
    field,
    question_of,
    status,
)

# The server answers well.


def test_a_candidate_says_what_the_model_said(extraction: Extraction) -> None:
    assert extraction.run() == 0
    event, version = load_event(str(extraction.candidate))
    assert event.name == "merge_clip"
    assert event.source.sha256 == sha256_file(extraction.video)
    assert event.source.rate == Interval(min=FPS, max=FPS, unit="Hz")
    road = event.topology
    assert road.road_type.value == "urban"
    # The model gave a range: how many the source shows, a person must say.
    assert (road.lanes_same_direction.value, road.lanes_opposite.value) == (2, UNRESOLVED)
    assert road.identity_fields == (
        "segment",
        "lanes_same_direction",
        "lanes_opposite",
        "vut_lane",
    )
    assert road.left_boundary.value == UNRESOLVED
    assert event.participants["vut"].intent == "keep_lane"
    assert event.interaction.type == "cut_in"
    assert event.interaction.occluder is None
    assert event.interaction.passing_order == ["ot1", "vut"]
    assert event.interaction.relation == "merge"
    cell = event.motion["ot1"]["trigger"]
    assert (cell.motion, cell.lateral) == ("cutting_in_from_left", "right")
    own = event.motion["vut"]["conflict"]
    assert (own.heading, own.speed_trend, own.position) == ("same", "decreasing", None)
    assert uncovered(event) == []
    doubt = event.uncertainty["interaction.dominant_motion"]
    numbers = (0, 8, 17, 25, 34, 42, 51, 59)
    assert (doubt.provenance, doubt.confidence) == ("model", 0.8)
    assert doubt.source == f"seer-7b; frames {numbers[3]}, {numbers[4]}"
    assert {d.review for d in event.uncertainty.values()} == {"unreviewed"}
    assert version == load_event(str(extraction.candidate))[1]


def test_what_the_model_cannot_know_is_no_number(extraction: Extraction) -> None:
    assert extraction.run() == 0
    event = extraction.event()
    speeds = [
        speed for by_phase in event.constraints.speeds.values() for speed in by_phase.values()
    ]
    assert speeds == [UNRESOLVED] * 8
    assert event.constraints.trigger.below == UNRESOLVED
    assert set(event.constraints.manoeuvre.values()) == {UNRESOLVED}
    assert event.constraints.time_gap == UNRESOLVED
    assert event.participants["ot1"].region.gap == UNRESOLVED
    assert event.topology.lane_width.value == UNRESOLVED
    # The fourth and fifth of eight frames over six seconds; the frame before is the other end.
    assert event.events.trigger.start == Interval(min=1.7, max=2.5, unit="s")
    assert event.events.conflict.start == Interval(min=2.5, max=3.4, unit="s")
    assert event.events.resolution.start == UNRESOLVED
    assert event.events.clip.end == Interval(min=6.0, max=6.0, unit="s")
    assert event.events.trigger.evidence[0].frames == (25, 25)
    assert event.uncertainty["constraints.camera"].provenance == "standard"
    assert event.participants["vut"].class_ == "car"
    assert event.uncertainty["participants.vut.class"].provenance == "standard"
    assert event.uncertainty["participants.vut.class"].confidence == 0.0


def test_questions_go_from_the_whole_to_the_parts(extraction: Extraction) -> None:
    assert extraction.run() == 0
    assert extraction.server.names() == list(KEYS)
    first, last = extraction.server.asked[0], extraction.server.asked[-1]
    parts = first["messages"][1]["content"]
    pictures = [part["image_url"]["url"] for part in parts if part["type"] == "image_url"]
    texts = [part["text"] for part in parts if part["type"] == "text"]
    assert len(pictures) == SHOWN
    assert texts[:2] == ["Frame 1, t = 0.000 s", "Frame 2, t = 0.800 s"]
    assert "urban" in texts[-1]
    head, data = pictures[1].split(",", 1)
    assert head == "data:image/jpeg;base64"
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    assert shown.shape == (120, 160, 3)
    assert shown[70, 2 * 8 + 10, 2] > 150  # the block where it is in frame 8
    assert first["temperature"] == 0
    assert first["model"] == "seer-7b"
    said = last["messages"][1]["content"][-1]["text"]
    assert '"road_type": "urban"' in said
    assert "red car {id} in the left lane [31m" in said
    phases = extraction.server.asked[list(KEYS).index("motion_ot1")]["messages"][1]["content"][-1][
        "text"
    ]
    assert "trigger (from frame 4), conflict (from frame 5), resolution (beginning unr" in phases


def test_the_schema_holds_the_closed_vocabularies(extraction: Extraction) -> None:
    assert extraction.run() == 0
    schemas = {
        question_of(request): request["response_format"]["json_schema"]["schema"]
        for request in extraction.server.asked
    }
    kinds = schemas["interaction"]["properties"]["type"]["properties"]["value"]["enum"]
    assert {"cut_in", "vru_crossing", "none"} <= set(kinds)
    assert schemas["interaction"]["properties"]["initiator"]["properties"]["value"] in (
        {"const": "ot1", "type": "string"},
        {"enum": ["ot1"], "type": "string"},
    )
    frames = schemas["phases"]["properties"]["trigger"]["properties"]["value"]["enum"]
    assert frames == [*range(1, SHOWN + 1), "unresolved"]
    for schema in schemas.values():
        assert schema["additionalProperties"] is False
        assert set(schema["required"]) == set(schema["properties"])


def test_nothing_is_sent_that_was_not_given(extraction: Extraction) -> None:
    assert extraction.run() == 0
    assert {headers["Authorization"] for headers in extraction.server.headers} == {"Bearer none"}


def test_a_key_comes_from_the_named_variable(
    extraction: Extraction, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TRACK_KEY", "s3cret")
    assert extraction.run("--api-key-env", "TRACK_KEY") == 0
    assert extraction.server.headers[0]["Authorization"] == "Bearer s3cret"
    written = [path for path in extraction.out.rglob("*") if path.is_file()]
    assert not any(b"s3cret" in path.read_bytes() for path in written)


def test_a_missing_key_is_named(extraction: Extraction) -> None:
    assert extraction.run("--api-key-env", "NO_SUCH_KEY") == 1
    assert "NO_SUCH_KEY" in extraction.error()
    assert extraction.server.asked == []


def test_the_log_links_source_questions_and_answers(extraction: Extraction) -> None:
    more = ("--start", "1", "--end", "5", "--generator", "GenVid 2", "--original", "clip 17")
    assert extraction.run(*more) == 0
    source, asked = extraction.log()
    assert (source.kind, asked.kind) == ("source", "extraction")
    assert source.details["sha256"] == sha256_file(extraction.video)
    assert source.details["generator"] == "GenVid 2"
    assert source.details["original"] == "clip 17"
    assert source.details["crop"] == {"start_s": 1.0, "end_s": 5.0, "first_frame": 10}
    assert asked.details["model"] == "seer-7b"
    assert asked.details["questions_sha256"] == DEFINITION_SHA256
    event, version = load_event(str(extraction.candidate))
    assert asked.details["version"] == version
    assert event.events.clip.end == Interval(min=4.0, max=4.0, unit="s")
    store = extraction.store
    assert len(asked.details["requests"]) == 9
    for key, hashes in asked.details["requests"].items():
        request = json.loads((store / "requests" / f"{key}.json").read_text())
        assert sha256_json(request) == hashes["request"]
        body = (store / "answers" / f"{key}-1.body").read_bytes()
        assert sha256_bytes(body) == hashes["answer"]
        for part in request["messages"][1]["content"]:
            if part["type"] == "image_url":
                picture = part["image_url"]
                assert sha256_file(store / picture["file"]) == picture["sha256"]


def test_a_person_sees_what_to_decide(extraction: Extraction) -> None:
    assert extraction.run() == 0
    text = " ".join(extraction.told().split())
    assert "constraints.trigger.below unresolved 0.00" in text
    assert "identity drift: yes (0.40, frames 42, 51)" in text
    assert "inconsistent road relations: unresolved" in text
    assert "material deformation" not in text
    assert "ssp spec review" in text


def test_json_says_the_same(extraction: Extraction) -> None:
    assert extraction.run("--json") == 0
    value = json.loads(extraction.told())
    kept = json.loads((extraction.store / "decisions.json").read_text())
    assert value == {"candidate": str(extraction.candidate), **kept}
    by_field = {item["field"]: item for item in value["undecided"]}
    assert by_field["constraints.trigger.below"]["why"] == "unresolved"
    assert by_field["interaction.type"]["critical"] is True
    assert by_field["interaction.type"]["frames"] == [25, 34]
    assert by_field["topology.road_type"]["critical"] is False
    assert [finding["answer"] for finding in value["gate"]].count("yes") == 1


def test_nothing_a_model_says_steers_a_terminal(extraction: Extraction) -> None:
    assert extraction.run() == 0
    assert "\x1b" not in extraction.told()
    assert "\x1b" not in extraction.candidate.read_text()


def test_a_standing_road_user_has_speed_0(extraction: Extraction) -> None:
    extraction.server.answers["motion_ot1"] = cells(
        position="front",
        motion="stationary",
        heading="same",
        speed_trend="standing",
        longitudinal="closing",
        lateral="none",
    )
    assert extraction.run() == 0
    event = extraction.event()
    assert event.constraints.speeds["ot1"]["trigger"] == Interval(min=0.0, max=0.0, unit="m/s")
    assert event.uncertainty["constraints.speeds.ot1.trigger"].provenance == "derived"


# Annotations.

ANNOTATION = {
    "video_id": "merge clip",
    "events": [{"description": "A red car merges.", "justification": "It was short of road."}],
}


@pytest.mark.parametrize("shown", [False, True])
def test_an_annotation_is_kept_and_shown_only_on_request(
    extraction: Extraction, shown: bool
) -> None:
    file = extraction.out / "a.json"
    file.write_text(json.dumps(ANNOTATION))
    more = ["--annotation", file, *(["--show-annotation"] if shown else [])]
    assert extraction.run(*more) == 0
    kept = extraction.log()[1].details["annotation"]
    assert kept["content"] == ANNOTATION
    assert kept["sha256"] == sha256_file(file)
    assert kept["shown_to_model"] is shown
    sent = json.dumps([request["messages"] for request in extraction.server.asked])
    assert ("A red car merges." in sent) is shown
    assert "It was short of road." not in sent


@pytest.mark.parametrize(
    ("value", "where"),
    [
        ({**ANNOTATION, "more": 1}, "more"),
        ({**ANNOTATION, "events": []}, "events"),
        ({"events": ANNOTATION["events"]}, "video_id"),
        ({**ANNOTATION, "events": [{"description": "x"}]}, "events[0].justification"),
    ],
)
def test_an_annotation_of_another_form_is_refused(
    extraction: Extraction, value: Any, where: str
) -> None:
    file = extraction.out / "a.json"
    file.write_text(json.dumps(value))
    assert extraction.run("--annotation", file) == 1
    assert f"a.json: {where}" in extraction.error()
    assert extraction.server.asked == []


def test_an_annotation_of_another_video_is_noted(extraction: Extraction) -> None:
    file = extraction.out / "a.json"
    file.write_text(json.dumps({**ANNOTATION, "video_id": "other"}))
    assert extraction.run("--annotation", file) == 0
    assert "about video 'other'" in extraction.error()


# Going on after an interruption.


def test_what_was_answered_is_not_asked_again(extraction: Extraction, waits: list[float]) -> None:
    extraction.server.replies = [None, None, None, None, status(500), status(500), status(500)]
    assert extraction.run() == 1
    assert not extraction.candidate.exists()
    extraction.server.asked.clear()
    assert extraction.run() == 0
    assert extraction.server.names() == list(KEYS)[4:]
    whole = extraction.out / "whole"
    assert extraction.run(out=whole) == 0
    assert (whole / extraction.candidate.name).read_bytes() == extraction.candidate.read_bytes()


def test_other_frames_are_another_question(extraction: Extraction) -> None:
    assert extraction.run() == 0
    extraction.server.asked.clear()
    assert extraction.run("--force", "--width", 80) == 0
    assert extraction.server.names() == list(KEYS)
    extraction.server.asked.clear()
    assert extraction.run("--force") == 0
    assert extraction.server.names() == []


def test_an_answer_that_was_changed_is_found_out(extraction: Extraction) -> None:
    assert extraction.run() == 0
    (kept,) = (extraction.store / "answers").glob("road-*")
    kept.write_bytes(kept.read_bytes().replace(b"urban", b"rural"))
    assert extraction.run("--force") == 1
    error = extraction.error()
    assert kept.name in error
    assert "was changed after it was stored" in error


def test_a_candidate_is_not_overwritten_unasked(extraction: Extraction) -> None:
    extraction.candidate.write_text("mine")
    assert extraction.run() == 1
    assert "exists already" in extraction.error()
    assert extraction.candidate.read_text() == "mine"
    assert extraction.server.asked == []


def test_a_refused_clip_stays_refused_until_it_is_another(extraction: Extraction) -> None:
    assert extraction.run() == 0
    refusal = Record(
        kind="gate",
        when="2025-01-01T00:00:00Z",
        who="A. Author",
        subject="merge_clip",
        reason="identity drift",
    )
    append_record(extraction.out / "merge_clip.log.jsonl", refusal)
    assert extraction.run("--force") == 1
    assert "refused by A. Author" in extraction.error()
    assert extraction.run("--force", "--start", 1) == 0


# What isn't a video.


def test_a_truncated_video_is_recognised(extraction: Extraction) -> None:
    data = extraction.video.read_bytes()
    cut = extraction.out / "cut.avi"
    cut.write_bytes(data[: len(data) * 2 // 3])
    assert replace(extraction, video=cut).run() == 1
    error = extraction.error()
    assert "cut.avi" in error
    assert extraction.server.asked == []


@pytest.mark.parametrize("content", [b"", b"not a video", b"\x00" * 5000])
def test_what_is_no_video_is_named(extraction: Extraction, content: bytes) -> None:
    file = extraction.out / "no.mp4"
    file.write_bytes(content)
    assert replace(extraction, video=file).run() == 1
    assert "no.mp4: is no video" in extraction.error()


@pytest.mark.parametrize(
    ("more", "what"),
    [
        (("--start", "9"), "lies beyond the video"),
        (("--end", "60"), "lies beyond the video"),
        (("--start", "5.95"), "fewer than two frames"),
    ],
)
def test_a_crop_that_is_none_is_refused(
    extraction: Extraction, more: tuple[str, ...], what: str
) -> None:
    assert extraction.run(*more) == 1
    assert what in extraction.error()
    assert extraction.server.asked == []


@pytest.mark.parametrize(
    "more",
    [
        ("--start", "4", "--end", "2"),
        ("--start", "nan"),
        ("--timeout", "inf"),
        ("--frames", "1"),
        ("--name", "Big Name"),
        ("--show-annotation",),
        ("--type", "collision"),
    ],
)
def test_wrong_usage_is_exit_2(extraction: Extraction, more: tuple[str, ...]) -> None:
    assert extraction.run(*more) == 2


def test_a_name_is_asked_for_where_the_file_has_none(extraction: Extraction) -> None:
    odd = extraction.video.rename(extraction.out / "0815.avi")
    assert replace(extraction, video=odd).run() == 2
    assert "--name" in extraction.error()


# From a video to a task.

KNOWN = {
    "topology.lanes_opposite": "{value: 2, identity: true}",
    "motion.ot1.trigger": "speed_trend=any",
    "motion.ot1.conflict": "speed_trend=any",
    "constraints.speeds.vut.approach": "12..14 m/s",
    "constraints.speeds.vut.trigger": "12..14 m/s",
    "constraints.speeds.vut.conflict": "0..14 m/s",
    "constraints.speeds.vut.resolution": "0..14 m/s",
    "constraints.speeds.ot1.approach": "8..9 m/s",
    "constraints.speeds.ot1.trigger": "5..9 m/s",
    "constraints.speeds.ot1.conflict": "5..9 m/s",
    "constraints.speeds.ot1.resolution": "5..9 m/s",
    "constraints.trigger.below": "16..20 m",
    "constraints.manoeuvre.duration": "2..3 s",
    "constraints.manoeuvre.end_speed": "5..6 m/s",
    "constraints.manoeuvre.deceleration": "1.5..2.5 m/s^2",
    "constraints.thresholds.ttc": "3 s",
}


def test_a_video_becomes_a_task(extraction: Extraction, monkeypatch: pytest.MonkeyPatch) -> None:
    """Extraction, a review that gives what no camera gives, the checks, the compiler."""
    extraction.server.answers["phases"]["resolution"] = field(7, 7)
    assert extraction.run() == 0
    event = extraction.event()
    lines = []
    for item in to_decide(event):
        known = KNOWN.get(item.field)
        lines += ["e", known, "measured on the track"] if known else ["a"]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join([*lines, ""])))
    options = ["--who", "A. Author", "--accept-all", "--reason", "usual for this road"]
    more = ["--video", str(extraction.video)]
    assert main(["spec", "review", str(extraction.candidate), *options, *more]) == 0
    k_star = extraction.out / "merge_clip.event.yaml"
    event, version = load_event(str(k_star))
    assert check_event(event) == []
    assert (extraction.out / "merge_clip.review").is_dir()
    folder = extraction.out / "task"
    given = ["--target", "sumo", "--site", "boulevard", "--out", str(folder)]
    assert main(["compile", str(k_star), *given]) == 0
    assert json.loads((folder / "task.json").read_text())["event"]["version"] == version
    kinds = {record.kind for record in read_log(folder / "log.jsonl")}
    assert {"source", "extraction", "accept", "edit"} <= kinds
