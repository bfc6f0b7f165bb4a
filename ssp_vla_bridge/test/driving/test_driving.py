"""A model behind HTTP as a driver: what becomes of each way in which its service fails."""

from __future__ import annotations

import json
import os
import threading
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import Camera
from ssp_core.world.driver import EgoSample, GivenAnswer, Question, SeenFrame
from ssp_vla_bridge.driving.driver import BridgeDriver, DriverModel, prompt_facts, request_of
from ssp_vla_bridge.driving.process import measured_answer
from ssp_vla_bridge.http_messages import HTTP_SCHEMA
from ssp_vla_bridge.messages import TASK, Answer, Request
from ssp_vla_bridge.window import find_interface
from tests.support.processes.children import is_alive
from tests.support.processes.waiting import until

WAY = [(5.0 * k, 0.0) for k in range(11)]


class Service(ThreadingHTTPServer):
    """A model's service that answers as its ``way`` says."""

    daemon_threads = True
    way = "well"
    last_request: dict[str, Any]

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.release = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class Handler(BaseHTTPRequestHandler):
    server: Service

    def log_message(self, *_: Any) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        self.say(json.dumps({"schema": HTTP_SCHEMA, "model_id": "m", "ready": True, "detail": ""}))

    def do_POST(self) -> None:
        asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        way, self.server.last_request = self.server.way, asked
        if way == "hangs":
            self.server.release.wait()
            return
        if way == "closes":
            return
        if way == "fails":
            self.say(json.dumps({"error": "out of memory"}), status=500)
            return
        if way == "1 GB":
            self.send_response(200)
            self.send_header("Content-Length", str(1 << 30))
            self.end_headers()
            return
        if way == "nonsense":
            self.say("I keep my speed.")
            return
        rows = [(float("nan"), 0.0)] * 11 if way == "nan" else WAY
        array = {
            "name": "trajectory",
            "shape": [len(rows), 2],
            "data": [value for row in rows for value in row],
            "frame": "ego_xy",
            "unit": "m",
            "step_s": 0.5,
            "first_time_s": 0.0,
        }
        answer = {"schema": HTTP_SCHEMA, "request_id": asked["request_id"], "model_id": "m"}
        self.say(json.dumps({**answer, "text": "", "arrays": [array], "decoding": {}}))

    def say(self, text: str, status: int = 200) -> None:
        body = text.encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)


@pytest.fixture
def service() -> Iterator[Service]:
    made = Service()
    thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield made
    made.release.set()
    made.shutdown()
    made.server_close()
    thread.join()


def question(number: int = 1) -> Question:
    _, jpeg = cv2.imencode(".jpg", np.zeros((64, 64, 3), np.uint8))
    frame = SeenFrame(number * 100_000_000, jpeg.tobytes())
    history = tuple(EgoSample(-0.1 * k, -1.0 * k, 0.0, 0.0, 10.0, 0.0) for k in range(20, -1, -1))
    camera = Camera(width_px=64, height_px=64)
    return Question(number, frame.stamp_ns, history, (), None, (frame,), camera)


def model(url: str, **options: Any) -> DriverModel:
    interface = find_interface("waypoints")
    given = {"url": url, "tries": 1, **options}
    return DriverModel("mine", "http", given, interface, "waypoints", interface.preprocessing)


def ask(service: Service, way: str, **options: Any) -> GivenAnswer:
    driver = BridgeDriver(model(service.url, **options))
    service.way = way
    try:
        return driver.give(question())
    finally:
        driver.close()


def test_an_answer_has_its_trajectory_and_the_parts_of_its_latency(service: Service) -> None:
    got = ask(service, "well")
    assert got.answer is not None
    assert got.answer.trajectory is not None
    assert got.answer.trajectory.x_m == tuple(x for x, _ in WAY)
    latency = got.latency
    parts = (latency.encoding_ns, latency.inference_ns, latency.parsing_ns)
    assert min(parts) > 0
    assert sum(parts) == latency.total_ns


@pytest.mark.parametrize(
    ("way", "ended", "refused"),
    [
        ("hangs", "gave no answer within its timeout_s of 0.5 s", ""),
        ("closes", "", "closed the connection without an answer"),
        ("fails", "", "/answer says 500: out of memory"),
        ("1 GB", "", "the answer is larger than 16 MiB"),
        ("nonsense", "", "the answer can't be read"),
        ("nan", "", "non_finite"),
    ],
)
def test_a_service_that_fails_ends_the_driver_or_costs_one_answer(
    service: Service, way: str, ended: str, refused: str
) -> None:
    got = ask(service, way, **({"timeout_s": 0.5} if way == "hangs" else {}))
    assert got.ended == ended
    assert got.latency.total_ns > 0
    if way == "hangs":
        # Known as late as that, and charged with it.
        assert (got.answer, got.latency.total_ns) == (None, 500_000_000)
    else:
        assert got.answer is not None
        assert got.answer.trajectory is None
        assert refused in got.answer.refused


def test_a_card_has_the_hash_of_the_words_that_a_service_gets(service: Service) -> None:
    """The question is about a VUT that stands: ages and motion are in the words, too."""
    asked = model(service.url)
    still = tuple(EgoSample(0.0 - 0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0) for k in range(20, -1, -1))
    at_ns, jpeg = 60_000_000_000, question().frames[0].jpeg
    frames = tuple(SeenFrame(at_ns - 100_000_000 * k, jpeg) for k in range(9, -1, -1))
    driver = BridgeDriver(asked)
    try:
        driver.give(replace(question(), stamp_ns=at_ns, history=still, frames=frames))
    finally:
        driver.close()
    got = service.last_request
    assert "[-2.0, 0.00, 0.00, 0.00], " in got["prompt"]
    sent = {"task": got["task"], "prompt": got["prompt"]}
    assert prompt_facts(asked)["prompt_sha256"] == sha256_json(sent)


def chat(**options: Any) -> DriverModel:
    interface = find_interface("openemma")
    given = {"base_url": "http://127.0.0.1:1/v1", "model": "m", **options}
    return DriverModel("mine", "openai", given, interface, "openemma", interface.preprocessing)


def test_a_card_tells_other_words_of_a_chat_from_other_options(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    usual = prompt_facts(chat())["prompt_sha256"]
    assert usual == prompt_facts(chat(temperature=1.0, timeout_s=3.0))["prompt_sha256"]
    assert usual != prompt_facts(chat(images="none"))["prompt_sha256"]
    monkeypatch.setattr("ssp_vla_bridge.driving.driver.TASK", replace(TASK, instruction="Drive."))
    assert usual != prompt_facts(chat())["prompt_sha256"]


@pytest.mark.parametrize(
    ("backend", "is_hashed", "what"),
    [
        ("python", True, "words that it makes of it aren't known"),
        ("my_models:Mine", True, "words that it makes of it aren't known"),
        ("opencv_baseline", False, "reads no words"),
        ("recorded", False, "isn't asked"),
    ],
)
def test_a_card_says_why_a_model_has_no_prompt(backend: str, is_hashed: bool, what: str) -> None:
    facts = prompt_facts(replace(chat(), backend=backend, options={}))
    assert (facts["prompt_sha256"] is not None) == is_hashed
    assert what in str(facts["prompt"])


HOSTILE = """
import os
import subprocess
import sys
import time

import numpy as np

from ssp_vla_bridge.messages import Answer


def number(request):
    return Answer("I keep my speed.", decoding={"p": np.float32(1.0)})


def large(request):
    return Answer("I keep my speed.", decoding={"p": "x" * 50_000_000})


def half_a_pair(request):
    return Answer("I keep \\ud800 my speed.")


def odd_error(request):
    raise RuntimeError("\\ud800")


def own_clock(request):
    time.perf_counter = lambda: 0.0
    time.sleep(0.2)
    return "I keep my speed."


def helper(request):
    held = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    return str(held.pid)
"""


def ask_python(folder: Path, function: str) -> GivenAnswer:
    (folder / "hostile_models.py").write_text(HOSTILE)
    interface = find_interface("waypoints")
    options = {"function": f"hostile_models:{function}", "folder": str(folder)}
    made = DriverModel("mine", "python", options, interface, "waypoints", interface.preprocessing)
    driver = BridgeDriver(made)
    try:
        return driver.give(question())
    finally:
        driver.close()


@pytest.mark.parametrize(
    ("function", "refused"),
    [
        ("number", "the answer can't be kept: Object of type float32 is not JSON serializable"),
        ("large", "characters and 0 numbers, at most 1048576"),
        ("half_a_pair", "the answer can't be kept: 'utf-8' codec can't encode"),
    ],
)
def test_an_answer_that_can_t_be_kept_is_refused(
    tmp_path: Path, function: str, refused: str
) -> None:
    """It would end the session, or the campaign, where it is written."""
    got = ask_python(tmp_path, function)
    assert got.answer is not None
    assert got.answer.trajectory is None
    assert refused in got.answer.refused


class Verbose:
    """A model with a text that is far too long."""

    model_id = "verbose"
    text = "I keep my speed. " * 2_000_000

    def answer(self, _request: Request) -> Answer:
        return Answer(self.text)


def test_an_answer_that_is_far_too_long_is_refused_without_a_copy_of_it() -> None:
    """Each question to a model that answers hundreds of MB would take seconds."""
    verbose = Verbose()
    asked = request_of(question(), model("http://127.0.0.1:1"))
    tracemalloc.start()
    try:
        got = measured_answer(verbose, "mine", "waypoints", asked)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert (
        "the answer has 34000007 characters and 0 numbers, at most 1048576"
        in got.response.error_msg
    )
    assert peak < len(verbose.text) // 10


def test_an_error_s_words_can_be_written(tmp_path: Path) -> None:
    got = ask_python(tmp_path, "odd_error")
    assert got.ended
    got.ended.encode()


def test_a_model_s_own_clock_doesn_t_shorten_its_latency(tmp_path: Path) -> None:
    assert ask_python(tmp_path, "own_clock").latency.total_ns >= 200_000_000


def test_what_a_model_starts_ends_with_its_run(tmp_path: Path) -> None:
    got = ask_python(tmp_path, "helper")
    assert got.answer is not None
    started = int(got.answer.text)
    until(lambda: not is_alive(started), "the end of the helper's process")


def test_a_service_that_is_gone_ends_the_driver(service: Service) -> None:
    driver = BridgeDriver(model(service.url))
    assert not driver.give(question()).ended
    service.shutdown()
    service.server_close()
    # The listening socket is closed, and nobody else has its port at once.
    got = driver.give(question(2))
    driver.close()
    assert "took no request" in got.ended


def test_a_process_that_is_stopped_is_ended_after_its_time(service: Service) -> None:
    """Neither sending nor receiving waits for ever."""
    driver = BridgeDriver(model(service.url, timeout_s=0.5))
    process = driver._process
    assert process is not None
    os.kill(process.pid, 19)
    got = driver.give(question())
    driver.close()
    assert got.ended == "gave no answer within its timeout_s of 0.5 s"


def test_a_driver_waits_for_60_s_unless_it_says_otherwise() -> None:
    assert model("http://127.0.0.1:1").limit_s == 60.0
    assert model("http://127.0.0.1:1", timeout_s=7.0).limit_s == 7.0
    interface = find_interface("waypoints")
    own = DriverModel("a", "python", {}, interface, "waypoints", interface.preprocessing, 3.0)
    assert own.limit_s == 3.0
