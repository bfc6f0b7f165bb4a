"""A model behind HTTP as a driver: what becomes of each way in which its service fails."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
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

from ssp_core.errors import PeerError
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import Camera
from ssp_core.world.driver import EgoSample, GivenAnswer, Question, SeenFrame
from ssp_vla_bridge.backend import make_backend
from ssp_vla_bridge.driving.driver import BridgeDriver, DriverModel, prompt_facts, request_of
from ssp_vla_bridge.driving.process import ModelProcess, measured_answer, measured_to_bytes
from ssp_vla_bridge.http_messages import HTTP_SCHEMA
from ssp_vla_bridge.messages import TASK, Answer, Frame, Request
from ssp_vla_bridge.window import find_interface
from tests.support.waiting import until

WAY = [(5.0 * k, 0.0) for k in range(11)]


class Service(ThreadingHTTPServer):
    """A model's service that answers as its ``way`` says."""

    daemon_threads = True
    way = "well"
    asked: dict[str, Any]

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
        way, self.server.asked = self.server.way, asked
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
    got = service.asked
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


def is_over(pid: int) -> bool:
    try:
        stat = Path("/proc", str(pid), "stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return True
    return stat.rpartition(")")[2].split()[0] == "Z"


def test_what_a_model_starts_ends_with_its_run(tmp_path: Path) -> None:
    got = ask_python(tmp_path, "helper")
    assert got.answer is not None
    started = int(got.answer.text)
    until(lambda: is_over(started), "the end of the helper's process")


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


def small_request() -> Request:
    shown = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    return Request("1", 0, (Frame(0, shown),))


DAEMON = """
import os
import time
from pathlib import Path

begun, begins = os.pipe()
if not (pid := os.fork()):
    os.setsid()
    os.write(begins, b"1")
    time.sleep(600.0)
    os._exit(0)
os.read(begun, 1)
Path(__file__).with_name("pid").write_text(str(pid))


def hang(request):
    time.sleep(3600.0)
"""


def test_a_process_that_left_its_model_s_group_delays_no_answer(tmp_path: Path) -> None:
    """It holds the model's end of the connection open."""
    (tmp_path / "models_with_daemon.py").write_text(DAEMON)
    options = {"function": "models_with_daemon:hang", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    daemon = int((tmp_path / "pid").read_text())
    try:
        got = process.ask(small_request(), 0.1)
        process.close()
        assert not is_over(daemon)
    finally:
        os.kill(daemon, signal.SIGKILL)
    assert isinstance(got, GivenAnswer)
    assert got.ended == "gave no answer within its timeout_s of 0.1 s"


def test_a_model_is_not_given_the_command_line_of_its_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It names the event, and the folder in which the times of triggers lie."""
    (tmp_path / "models_that_look.py").write_text(
        "import sys\n\n\ndef look(request):\n    return ' '.join(sys.argv)\n"
    )
    monkeypatch.setattr("sys.argv", ["ssp", "run", "cut_in", "--out", "out/here"])
    options = {"function": "models_that_look:look", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    got = process.ask(small_request(), 60.0)
    process.close()
    assert not isinstance(got, GivenAnswer)
    assert got[0].response.text == "m"


def test_a_model_that_takes_the_machine_s_memory_ends_before_its_session(tmp_path: Path) -> None:
    (tmp_path / "models_of_memory.py").write_text(
        "from pathlib import Path\n\n\ndef look(request):\n"
        "    return Path('/proc/self/oom_score_adj').read_text()\n"
    )
    options = {"function": "models_of_memory:look", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    got = process.ask(small_request(), 60.0)
    process.close()
    assert not isinstance(got, GivenAnswer)
    assert got[0].response.text.strip() == "1000"


@pytest.mark.parametrize(("line", "words"), [("os._exit(3)", "while it was loaded"), ("", "")])
def test_a_model_that_crashes_while_what_it_started_lives_on_is_seen_at_once(
    tmp_path: Path, line: str, words: str
) -> None:
    """Both hold the model's end of the connection, and only one of them has ended."""
    text = DAEMON.replace("    time.sleep(3600.0)", "    os._exit(3)") + f"\n\n{line}\n"
    (tmp_path / "crashing_models.py").write_text(text)
    options = {"function": "crashing_models:hang", "folder": str(tmp_path)}
    reason = "its process ended with exit status 3"
    try:
        if words:
            with pytest.raises(PeerError, match=f"{reason} {words}"):
                ModelProcess("m", "python", options, "waypoints:ego_xy", start_s=60.0)
        else:
            process = ModelProcess("m", "python", options, "waypoints:ego_xy")
            got = process.ask(small_request(), 60.0)
            process.close()
            assert isinstance(got, GivenAnswer)
            assert got.ended == reason
        daemon = int((tmp_path / "pid").read_text())
        assert not is_over(daemon)
    finally:
        os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)


OWNER = """
import sys

from ssp_vla_bridge.driving.process import ModelProcess
from ssp_vla_bridge.messages import TASK, Answer, Frame, Request

folder, shown = sys.argv[1:]
options = {"function": "models_of_owner:hang", "folder": folder}
process = ModelProcess("m", "python", options, "waypoints:ego_xy")
process.ask(Request("1", 0, (Frame(0, bytes.fromhex(shown)),)), 3600.0)
"""


def test_a_model_that_is_asked_ends_with_its_owner_however_that_ends(tmp_path: Path) -> None:
    asked = tmp_path / "asked"
    os.mkfifo(asked)
    (tmp_path / "models_of_owner.py").write_text(
        "import os\nimport time\nfrom pathlib import Path\n\n\ndef hang(request):\n"
        f"    Path({str(asked)!r}).write_text(str(os.getpid()))\n    time.sleep(3600.0)\n"
    )
    (frame,) = small_request().frames
    owner = subprocess.Popen([sys.executable, "-c", OWNER, str(tmp_path), frame.jpeg.hex()])
    try:
        model_pid = int(asked.read_text())
    finally:
        owner.kill()
        owner.wait()
    until(lambda: is_over(model_pid), "the end of the model's process")


def test_a_model_that_is_closed_while_it_is_asked_ends_the_question(tmp_path: Path) -> None:
    """A session that is aborted waits for no answer."""
    asked = tmp_path / "asked"
    os.mkfifo(asked)
    (tmp_path / "hanging_models.py").write_text(
        "import time\n\n\ndef hang(request):\n"
        f"    open({str(asked)!r}, 'w').close()\n    time.sleep(3600.0)\n"
    )
    options = {"function": "hanging_models:hang", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    request = small_request()
    got: list[Any] = []
    question = threading.Thread(target=lambda: got.append(process.ask(request, 3600.0)))
    question.start()
    asked.read_text()  # until it is opened at the other end
    process.close()
    process.close()
    question.join()
    (given,) = got
    assert isinstance(given, GivenAnswer)
    assert "its process" in given.ended
    assert process.ask(request, 1.0) == GivenAnswer(None, ended="its process was ended")


# A model's own code finds the connection, and writes to it what it likes.
FORGING = """
import gc
import os
import struct
import time
from multiprocessing.connection import Connection


class Command:
    def __reduce__(self):
        return open, ({mark!r}, "w")


def connection():
    return next(one for one in gc.get_objects() if isinstance(one, Connection) and not one.closed)


def text(request):
    connection().send("junk")


def command(request):
    connection().send(Command())


def bytes_(request):
    connection().send_bytes(b'{{"response": 1}}')


def not_finite(request):
    connection().send_bytes(
        b'{{"response": {{"schema": "ssp.response/1", "request_id": "1", "stamp_ns": 0,'
        b'"model": "m", "model_id": "m"}}, "trajectory": null, "invalid": "", "raised": false,'
        b'"encoding_s": NaN, "parsing_s": 0.0}}'
    )


def long(request):
    os.write(connection().fileno(), struct.pack("!iQ", -1, 1 << 30))
    time.sleep(3600.0)
"""


@pytest.mark.parametrize("function", ["text", "command", "bytes_", "not_finite", "long"])
def test_what_a_model_writes_to_its_connection_is_no_answer_and_runs_nothing(
    tmp_path: Path, function: str
) -> None:
    mark = tmp_path / "was_run"
    (tmp_path / "forging_models.py").write_text(FORGING.format(mark=str(mark)))
    options = {"function": f"forging_models:{function}", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    tracemalloc.start()
    try:
        got = process.ask(small_request(), 60.0)
        assert tracemalloc.get_traced_memory()[1] < 1 << 24
    finally:
        tracemalloc.stop()
        process.close()
    assert isinstance(got, GivenAnswer)
    assert got.ended == "its process sent what is no answer"
    assert not mark.exists()


ANSWERING_TWICE = """
import gc
from multiprocessing.connection import Connection


def drive(request):
    found = [one for one in gc.get_objects() if isinstance(one, Connection) and not one.closed]
    found[0].send_bytes({again!r})
    return "I keep my speed.", [(0.0, 0.0), (5.0, 0.0)]
"""


def test_an_answer_that_is_sent_ahead_of_its_question_ends_the_driver(tmp_path: Path) -> None:
    backend = make_backend("constant_velocity", {})
    ahead = measured_to_bytes(measured_answer(backend, "m", "waypoints:ego_xy", small_request()))
    (tmp_path / "answering_twice.py").write_text(ANSWERING_TWICE.format(again=ahead))
    options = {"function": "answering_twice:drive", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    first = process.ask(small_request(), 60.0)
    assert not isinstance(first, GivenAnswer)
    until(process._connection.poll, "the second answer")
    got = process.ask(small_request(), 60.0)
    process.close()
    assert isinstance(got, GivenAnswer)
    assert got.ended == "its process sent an answer that wasn't asked for"


NUMBERS = """
import numpy as np

from ssp_vla_bridge.messages import Answer, NativeArray


def large(request):
    return Answer("", (NativeArray("trajectory", (1, 2), (10**400, 0.0), "ego_xy", "m", 0.5, 0.0),))


def no_arrays(request):
    return Answer("I stop.", (1, 2))


def whole(request):
    return Answer("I stop.", decoding={"seed": 10**5000})


def frame(request):
    return Answer("", (NativeArray("trajectory", (1, 2), (5.0, 0.0), None, "m", 0.5, 0.0),))


def of_numpy(request):
    data = np.array([[5.0, 0.0], [10.0, 0.0], [15.0, 0.0]], np.float32)
    shape = tuple(np.array(data.shape))
    told = {"temperature": np.float64(0.5)}
    array = NativeArray("trajectory", shape, data.ravel(), "ego_xy", "m", np.float64(0.5), 0.5)
    return Answer("", (array,), told)
"""


@pytest.mark.parametrize("function", ["large", "no_arrays", "whole", "frame"])
def test_an_answer_of_what_no_message_can_hold_is_an_error_and_no_crash(
    tmp_path: Path, function: str
) -> None:
    (tmp_path / "models_of_numbers.py").write_text(NUMBERS)
    options = {"function": f"models_of_numbers:{function}", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    got = [process.ask(small_request(), 60.0) for _ in range(2)]
    process.close()
    for one in got:
        assert not isinstance(one, GivenAnswer), one
        assert one[0].response.error_msg
        assert one[0].trajectory is None


def test_numbers_of_numpy_are_numbers(tmp_path: Path) -> None:
    (tmp_path / "models_of_numpy.py").write_text(NUMBERS)
    options = {"function": "models_of_numpy:of_numpy", "folder": str(tmp_path)}
    process = ModelProcess("m", "python", options, "waypoints:ego_xy")
    got = process.ask(small_request(), 60.0)
    process.close()
    assert not isinstance(got, GivenAnswer)
    measured, _ = got
    assert measured.trajectory is not None, measured
    assert measured.trajectory.x_m == (0.0, 5.0, 10.0, 15.0)
    assert measured.response.decoding == {"temperature": 0.5}
