"""A server of a vision model that answers as a test wants, and ssp spec extract beside it."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from dataclasses import dataclass
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import Record, read_log
from ssp_scenario_manager.event_spec.model import Event

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


def status(code: int, **headers: str) -> Reply:
    value = {"error": {"message": f"trouble {code}", "type": "t", "code": code}}
    return lambda handler, _: handler.body(value, code, **headers)
