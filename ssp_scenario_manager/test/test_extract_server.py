"""ssp spec extract against a server that answers well, badly, slowly and not at all."""

from __future__ import annotations

import base64
import copy
import io
import json
import socket
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from email.message import Message
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.chat import OpenAIChat
from ssp_core.cli import main
from ssp_core.hashing import sha256_bytes, sha256_file, sha256_json
from ssp_scenario_manager.cli import spec_extract as extract_cli
from ssp_scenario_manager.event_spec.checks.check import check_event
from ssp_scenario_manager.event_spec.extract.questions import DEFINITION_SHA256
from ssp_scenario_manager.event_spec.load import load_event, uncovered
from ssp_scenario_manager.event_spec.log import Record, append_record, read_log
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event, Interval
from ssp_scenario_manager.event_spec.review.session import to_decide

FPS, FRAMES = 10.0, 60
SHOWN = 8


def make_video(path: Path, frames: int = FRAMES, codec: str = "MJPG") -> Path:
    """Six seconds in which a block moves over a grey road; 160×120 px, 10 frames a second."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), FPS, (160, 120))
    assert writer.isOpened()
    for k in range(frames):
        image = np.full((120, 160, 3), 110, np.uint8)
        cv2.rectangle(image, (2 * k, 60), (2 * k + 20, 80), (0, 0, 200), -1)
        writer.write(image)
    writer.release()
    return path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return make_video(tmp_path / "merge clip.avi")


def field(value: Any, *frames: int, confidence: float = 0.8) -> dict[str, Any]:
    return {"value": value, "confidence": confidence, "evidence": list(frames) or [1]}


def cells(**changes: str) -> dict[str, Any]:
    """One answered cell per phase; words are given as ``position="front_left front_left …"``."""
    phases = ("approach", "trigger", "conflict", "resolution")
    words = {key: text.split() for key, text in changes.items()}
    return {
        phase: {
            **{key: given[min(i, len(given) - 1)] for key, given in words.items()},
            "confidence": 0.7,
            "evidence": [1 + i],
        }
        for i, phase in enumerate(phases)
    }


GOOD: dict[str, Any] = {
    "road": {
        "road_type": field("urban"),
        "segment": field("straight"),
        "lanes_same_direction": field({"min": 2, "max": 2}),
        "lanes_opposite": field({"min": 0, "max": 2}),
        "left_boundary": field("unresolved", confidence=0.1),
        "right_boundary": field("kerb"),
        "permitted_manoeuvres": field(["keep_lane", "lane_change_right"]),
    },
    "vut": {
        "intent": field("keep_lane"),
        "class": field("unresolved"),
        "vut_lane": field("rightmost"),
    },
    "targets": {
        "items": [
            {
                "class": "car",
                "description": "red car {id} in the\nleft lane\u001b[31m",
                "confidence": 0.95,
                "evidence": [1, 2, 3],
            }
        ]
    },
    "target_ot1": {"place": field("left_lane", 1), "along": field("ahead", 1)},
    "interaction": {
        "type": field("cut_in", 4, 5),
        "initiator": field("ot1", 4),
        "occluder": field("none"),
        "dominant_motion": field("cutting_in_from_left", 5, 4, 4),
        "first": field("ot1", 6),
        "longitudinal_responses": field(["decelerate", "stop"], 5),
        "lateral_responses": field(["straight"], 5),
    },
    "phases": {
        "trigger": field(4, 4, confidence=0.9),
        "conflict": field(5, 5),
        "resolution": field("unresolved", 8, confidence=0.2),
    },
    "motion_vut": cells(speed_trend="constant constant decreasing unresolved", lateral="none"),
    "motion_ot1": cells(
        position="front_left front_left front",
        motion="same_direction cutting_in_from_left cutting_in_from_left same_direction",
        heading="same",
        speed_trend="constant unresolved",
        longitudinal="closing closing closing unresolved",
        lateral="none right right none",
    ),
    "gate": {
        "deformation": field("no"),
        "identity": field("yes", 6, 7, confidence=0.4),
        "discontinuity": field("no"),
        "road": field("unresolved"),
        "no_conflict": field("no"),
    },
}

Reply = Callable[["Handler", dict[str, Any]], None]


class Server(ThreadingHTTPServer):
    """Speaks as much of the chat interface as a client needs.

    ``answers`` by question; ``replies``: what to do instead with the next requests.
    """

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.answers = copy.deepcopy(GOOD)
        self.replies: list[Reply | None] = []
        self.asked: list[dict[str, Any]] = []
        self.headers: list[Message] = []

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/v1"

    def names(self) -> list[str]:
        return [question_of(request) for request in self.asked]


def question_of(request: dict[str, Any]) -> str:
    given = request.get("response_format")
    if given:
        name = given["json_schema"]["name"]
        assert isinstance(name, str)
        return name
    text = request["messages"][1]["content"][-1]["text"]
    found = [name for name, key in KEYS.items() if key in text]
    assert len(found) == 1
    return found[0]


KEYS = {
    "road": "Describe the road",
    "vut": "Describe the VUT, which",
    "targets": "List the OTs",
    "target_ot1": "Describe where ot1",
    "interaction": "Describe the interaction",
    "phases": "Find where the phases",
    "motion_vut": "Describe how the VUT itself",
    "motion_ot1": "Describe how ot1",
    "gate": "Judge whether the clip",
}


class Handler(BaseHTTPRequestHandler):
    server: Server

    def do_POST(self) -> None:
        assert self.path == "/v1/chat/completions"
        request = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.asked.append(request)
        self.server.headers.append(self.headers)
        reply = self.server.replies.pop(0) if self.server.replies else None
        if reply is not None:
            reply(self, request)
        else:
            self.answer(json.dumps(self.server.answers[question_of(request)]))

    def answer(self, content: Any, **message: Any) -> None:
        finish = message.pop("finish_reason", "stop")
        said = {"role": "assistant", "content": content, **message}
        self.body({"choices": [{"index": 0, "message": said, "finish_reason": finish}]})

    def body(self, value: Any, status: int = 200, **headers: str) -> None:
        data = value if isinstance(value, bytes) else json.dumps(value).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(data)))
        for key, text in headers.items():
            self.send_header(key.replace("_", "-"), text)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv("OPENAI_API_KEY", "not for this server")
    with Server() as found:
        threading.Thread(target=found.serve_forever, args=(0.01,), daemon=True).start()
        yield found
        found.shutdown()


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Waits between tries are noted and not waited for."""
    found: list[float] = []
    monkeypatch.setattr(extract_cli, "OpenAIChat", partial(OpenAIChat, sleep=found.append))
    return found


@dataclass
class Extraction:
    """The command on one video, with one server, into one folder."""

    server: Server
    video: Path
    out: Path
    _capsys: pytest.CaptureFixture[str]

    def run(self, *more: object, out: Path | None = None, url: str | None = None) -> int:
        given = ["spec", "extract", self.video, "--base-url", url or self.server.url]
        given += ["--model", "seer-7b", "--out", out or self.out, "--frames", SHOWN]
        return main([*map(str, given), *map(str, more)])

    def told(self) -> str:
        return self._capsys.readouterr().out

    def error(self) -> str:
        captured = self._capsys.readouterr()
        assert "Traceback" not in captured.err
        return " ".join(captured.err.split())

    @property
    def candidate(self) -> Path:
        return self.out / "merge_clip.candidate.yaml"

    @property
    def store(self) -> Path:
        return self.out / "merge_clip.extraction"

    def event(self) -> Event:
        return load_event(str(self.candidate))[0]

    def log(self) -> list[Record]:
        return read_log(self.out / "merge_clip.log.jsonl")


@pytest.fixture
def extraction(
    server: Server, video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Extraction:
    return Extraction(server, video, tmp_path, capsys)


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


# The server answers badly.


def say(text: str | None, **message: Any) -> Reply:
    return lambda handler, _: handler.answer(text, **message)


def changed(question: str, change: Callable[[Any], Any]) -> str:
    value = copy.deepcopy(GOOD[question])
    return json.dumps(change(value) or value)


def put(*path: Any) -> Callable[[Any], None]:
    """Sets a value; the last of the path is the value."""

    def change(value: Any) -> None:
        for key in path[:-2]:
            value = value[key]
        value[path[-2]] = path[-1]

    return change


BAD_ROADS = {
    "no JSON": ("I see a road.", "no JSON"),
    "cut off": (json.dumps(GOOD["road"])[:-20], "no JSON"),
    "a list": ("[]", "must be a JSON object"),
    "word outside": (changed("road", put("segment", "value", "wiggly")), "segment.value"),
    "wrong case": (changed("road", put("segment", "value", "Straight")), "segment.value"),
    "number as text": (changed("road", put("segment", "confidence", "0.9")), "segment.confidence"),
    "confidence 1.5": (changed("road", put("segment", "confidence", 1.5)), "segment.confidence"),
    "no evidence": (changed("road", put("segment", "evidence", [])), "segment.evidence"),
    "frame 0": (changed("road", put("segment", "evidence", [0])), "segment.evidence[0]"),
    "frame 9": (changed("road", put("segment", "evidence", [9])), "segment.evidence[0]"),
    "true as frame": (changed("road", put("segment", "evidence", [True])), "segment.evidence[0]"),
    "extra key": (changed("road", put("speed_kmh", field(50))), "speed_kmh"),
    "key missing": (changed("road", lambda v: v.pop("segment") and v), "segment"),
    "words empty": (changed("road", put("permitted_manoeuvres", "value", [])), "manoeuvres.value"),
    "count as word": (changed("road", put("lanes_opposite", "value", "two")), "lanes_opposite"),
    "key twice": ('{"segment": 1, "segment": 1}', "stands twice"),
    "NaN": ('{"segment": NaN}', "NaN is no number"),
    "deep": ("[" * 50_000, "nested too deeply"),
    "huge number": ('{"segment": ' + "9" * 5000 + "}", "no JSON"),
    "empty": ("", "empty"),
    "null": (None, "empty"),
}


@pytest.mark.parametrize("case", BAD_ROADS)
def test_a_bad_answer_is_asked_for_again_with_what_was_wrong(
    extraction: Extraction, case: str
) -> None:
    text, what = BAD_ROADS[case]
    extraction.server.replies = [say(text)]
    assert extraction.run() == 0
    assert extraction.server.names()[:3] == ["road", "road", "vut"]
    again = extraction.server.asked[1]["messages"]
    assert [message["role"] for message in again] == ["system", "user", "assistant", "user"]
    assert what in again[3]["content"]
    index = json.loads((extraction.store / "index.json").read_text())
    road = next(v for k, v in index["questions"].items() if k.startswith("road"))
    assert [bool(answer["problems"]) for answer in road["answers"]] == [True, False]


def test_three_bad_answers_end_it_and_are_kept(extraction: Extraction) -> None:
    text, what = BAD_ROADS["word outside"]
    extraction.server.replies = [say(text)] * 3
    assert extraction.run() == 1
    error = extraction.error()
    assert "question road: seer-7b gave no usable answer in 3 tries" in error
    assert what in error
    kept = sorted((extraction.store / "answers").iterdir())
    assert len(kept) == 3
    said = json.loads(kept[0].read_bytes())["choices"][0]["message"]["content"]
    assert said == text
    assert not extraction.candidate.exists()
    assert not (extraction.out / "merge_clip.log.jsonl").exists()


def test_fences_and_thoughts_around_an_answer_are_taken_off(extraction: Extraction) -> None:
    road = json.dumps(GOOD["road"])
    extraction.server.replies = [say(f"<think>Hm, {{road}}?</think>\n```json\n{road}\n```\n")]
    assert extraction.run() == 0
    assert extraction.server.names() == list(KEYS)


def test_a_server_that_ignores_the_schema_is_held_to_it_all_the_same(
    extraction: Extraction,
) -> None:
    extraction.server.replies = [say('{"segment": "straight"}')]
    assert extraction.run("--no-schema") == 0
    assert all("response_format" not in request for request in extraction.server.asked)
    assert extraction.server.names()[:2] == ["road", "road"]


def test_contradictions_are_left_to_the_person(extraction: Extraction) -> None:
    """A conflict before its trigger, who comes from the left from the right: C1 and C3 say so."""
    extraction.server.answers["phases"]["conflict"] = field(2)
    extraction.server.answers["target_ot1"]["place"] = field("right_lane")
    assert extraction.run("--json") == 0
    failures = json.loads(extraction.told())["failures"]
    fields = {(failure["check"], failure["field"]) for failure in failures}
    assert ("C3", "events.conflict.start") in fields
    assert ("C1", "participants.ot1.region.place") in fields


def test_an_object_that_nobody_listed_cannot_be_the_initiator(extraction: Extraction) -> None:
    extraction.server.answers["interaction"]["initiator"] = field("ot2")
    assert extraction.run() == 1
    assert "initiator.value" in extraction.error()


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"refusal": "I can't look at people."}, "I can't look at people."),
        ({"finish_reason": "content_filter"}, "filtered by the server"),
    ],
)
def test_a_refusal_ends_it_at_once(
    extraction: Extraction, message: dict[str, str], said: str
) -> None:
    extraction.server.replies = [say(None, **message)]
    assert extraction.run() == 1
    error = extraction.error()
    assert "question road" in error
    assert f"declines to answer: {said}" in error
    assert len(extraction.server.asked) == 1


def test_an_answer_cut_off_by_its_length_is_said_so(extraction: Extraction) -> None:
    extraction.server.replies = [say('{"road', finish_reason="length")] * 3
    assert extraction.run() == 1
    assert "cut off at the limit of its length" in extraction.error()


@pytest.mark.parametrize(
    "body", [b"<html>It works!</html>", b"{}", b"[]", b'{"choices": []}', b"\xff\xfe", b""]
)
def test_another_service_is_recognised(extraction: Extraction, body: bytes) -> None:
    extraction.server.replies = [lambda handler, _: handler.body(body)]
    assert extraction.run() == 1
    assert "no chat completion" in extraction.error()
    (kept,) = (extraction.store / "answers").iterdir()
    assert kept.read_bytes() == body


@pytest.mark.parametrize(
    ("answers", "what"),
    [
        ({"targets": {"items": []}}, "shows nobody who conflicts"),
        ({"interaction": {**GOOD["interaction"], "type": field("none")}}, "no identifiable"),
    ],
)
def test_a_clip_without_event_gives_no_candidate_but_a_record(
    extraction: Extraction, answers: dict[str, Any], what: str
) -> None:
    extraction.server.answers.update(answers)
    assert extraction.run() == 1
    assert what in extraction.error()
    assert not extraction.candidate.exists()
    record = extraction.log()[1]
    assert what in record.reason
    assert record.details["version"] is None
    assert record.details["gate"]


def test_a_person_may_state_the_kind(extraction: Extraction) -> None:
    extraction.server.answers["interaction"]["type"] = field("none")
    assert extraction.run("--type", "lead_braking") == 0
    event = extraction.event()
    assert event.interaction.type == "lead_braking"
    assert event.uncertainty["interaction.type"].provenance == "person"


# The server has trouble; how the client meets it is tested with the client.


def status(code: int, **headers: str) -> Reply:
    value = {"error": {"message": f"trouble {code}", "type": "t", "code": code}}
    return lambda handler, _: handler.body(value, code, **headers)


@pytest.mark.parametrize(
    ("reply", "asked", "what"),
    [
        (status(500), 3, "the server says 500: "),
        (status(429, Retry_After="3600"), 1, "429"),
        (status(400), 1, "--no-schema"),
        (status(401), 1, "--api-key-env"),
        (status(404), 1, "--model must be a name that the server serves"),
    ],
)
def test_trouble_that_stays_is_reported(
    extraction: Extraction, waits: list[float], reply: Reply, asked: int, what: str
) -> None:
    extraction.server.replies = [reply] * 3
    assert extraction.run() == 1
    error = extraction.error()
    assert what in error
    assert extraction.server.url in error
    assert len(extraction.server.asked) == asked
    assert not extraction.candidate.exists()


def test_no_server_at_all(extraction: Extraction, waits: list[float]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound and not listening: connections are refused
        url = f"http://127.0.0.1:{taken.getsockname()[1]}/v1"
        assert extraction.run(url=url) == 1
    error = extraction.error()
    assert f"{url}: the server can't be reached" in error
    assert "(3 tries)" in error
    assert "start it" in error


@pytest.mark.parametrize("url", ["localhost:8000", "ftp://x/v1", "http://", "http://[::1", "nope"])
def test_an_address_that_is_none_is_wrong_usage(extraction: Extraction, url: str) -> None:
    assert extraction.run(url=url) == 2


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
