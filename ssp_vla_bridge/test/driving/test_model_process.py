"""The process of a model that drives: its end, what it holds open, and what it sends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import tracemalloc
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.errors import PeerError
from ssp_core.world.driver import GivenAnswer
from ssp_vla_bridge.backend import make_backend
from ssp_vla_bridge.driving.process import ModelProcess, measured_answer, measured_to_bytes
from ssp_vla_bridge.messages import Frame, Request
from tests.support.processes.children import is_alive
from tests.support.processes.waiting import until


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
        assert is_alive(daemon)
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
        assert is_alive(daemon)
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
    until(lambda: not is_alive(model_pid), "the end of the model's process")


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
