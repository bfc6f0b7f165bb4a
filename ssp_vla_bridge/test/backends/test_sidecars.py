"""The sidecars as processes: everything but a model's weights is real."""

from __future__ import annotations

import ast
import http.client
import importlib.util
import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ssp_core.errors import PeerError
from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import make_backend, respond
from ssp_vla_bridge.http_messages import request_to_json
from ssp_vla_bridge.messages import Frame
from tests.support.processes.waiting import DEADLINE_S, until

HERE = Path(__file__).resolve().parents[1]
SIDECARS = HERE.parent / "sidecars"
NS = 1_000_000_000


def load_io():
    """sidecar_io, as a script beside it imports it."""
    sys.path.insert(0, str(SIDECARS))
    try:
        spec = importlib.util.spec_from_file_location("sidecar_io", SIDECARS / "sidecar_io.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(SIDECARS))
    return module


class Sidecar:
    """A process that listens at ``url``."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        line = process.stdout.readline()
        if not line.startswith("listening on "):
            raise AssertionError(f"{line!r} {process.communicate(timeout=DEADLINE_S)}")
        self.url = line.split()[-1]
        self.port = int(self.url.rsplit(":", 1)[1])

    def call(self, method, path, body=None, headers=None, timeout_s=DEADLINE_S):
        """Status, headers and JSON of a reply."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout_s)
        try:
            text = None if body is None else json.dumps(body)
            connection.request(method, path, text, headers or {})
            reply = connection.getresponse()
            return reply.status, reply.headers, json.loads(reply.read())
        finally:
            connection.close()

    def until_ready(self):
        until(lambda: self.call("GET", "/health")[2]["ready"], "readiness")
        return self

    def stop(self) -> int:
        """SIGTERM; gives the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(DEADLINE_S)


@pytest.fixture
def start(tmp_path):
    """Starts a sidecar of a script with arguments and variables."""
    running = []

    def call(script, *arguments, **variables):
        process = popen(script, *arguments, cwd=tmp_path, **variables)
        running.append(process)
        return Sidecar(process)

    yield call
    for process in running:
        process.kill()
        process.communicate(timeout=DEADLINE_S)


def popen(script, *arguments, cwd, **variables):
    environment = {**os.environ, "PYTHONPATH": str(HERE), **variables}
    environment.pop("AMENT_PREFIX_PATH", None)
    return subprocess.Popen(
        [sys.executable, str(SIDECARS / script), "--port", "0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=environment,
    )


@pytest.fixture
def drive_request(make_request, straight_history, grey_jpeg):
    """The request that Alpamayo's interface needs: four frames at 10 Hz and 2 s of history."""
    return make_request(jpegs=[grey_jpeg] * 4, history=straight_history(8.0))


def backend_of(name, sidecar, **options):
    return make_backend(name, {"url": sidecar.url, "start_s": 20.0, "timeout_s": 20.0, **options})


def test_alpamayo_of_the_real_shapes_becomes_a_trajectory(start, drive_request):
    sidecar = start("alpamayo_sidecar.py", "--loader", "sidecar_models:alpamayo", "--samples", "3")
    response = respond(backend_of("alpamayo", sidecar), "alpamayo", drive_request).response
    assert (response.error_code, response.error_msg) == (0, "")
    assert response.model_id == "shapes-of-alpamayo/1"
    assert response.text == "Keep speed because the lane is clear (0)."
    (array,) = response.arrays
    assert (array.name, array.shape) == ("pred_xyz", (1, 1, 3, 64, 3))
    assert (array.frame, array.unit, array.step_s, array.first_time_s) == ("ego_xyz", "m", 0.1, 0.1)
    assert array.data[64 * 3 + 1] == 1.0  # y of the second sample
    assert response.decoding["extra"]["cot"][0][0][2].endswith("(2).")
    assert response.decoding["seed"] == 42
    trajectory = adapt("alpamayo", response, drive_request).trajectory
    assert trajectory.t_s[:2] == (0.0, pytest.approx(0.1))
    assert trajectory.t_s[-1] == pytest.approx(6.4)
    assert trajectory.x_m[:3] == pytest.approx((0.0, 0.8, 1.6), abs=1e-5)
    assert sidecar.stop() == 0


def test_alpamayo_fills_nothing_in(start, drive_request, straight_history):
    sidecar = start("alpamayo_sidecar.py", "--loader", "sidecar_models:alpamayo")
    backend = backend_of("alpamayo", sidecar)
    apart = [
        Frame(f.stamp_ns - (NS // 10) * (i == 0), f.jpeg)
        for i, f in enumerate(drive_request.frames)
    ]
    wrong = {
        "needs 4 frames, the request has 3": {"frames": drive_request.frames[1:]},
        "needs frames 0.1 s apart, two are 0.200 s apart": {"frames": tuple(apart)},
        "needs the ego history, and the request has none": {"ego_provenance": "unknown"},
        "from -1.5 to 0 s, the request has it from -1.400": {"history": straight_history(8.0)[6:]},
    }
    for words, changes in wrong.items():
        response = respond(backend, "m", replace(drive_request, **changes)).response
        assert response.error_code == 2
        assert words in response.error_msg
        assert "/answer says 422" in response.error_msg
    assert respond(backend, "m", drive_request).response.error_code == 0


def test_a_model_that_gives_nan_or_raises_costs_its_answer(start, drive_request):
    arguments = ("alpamayo_sidecar.py", "--loader", "sidecar_models:alpamayo")
    response = respond(
        backend_of("alpamayo", start(*arguments, BROKEN="nan")), "m", drive_request
    ).response
    assert response.error_code == 0
    assert adapt("alpamayo", response).invalid == ("non_finite",)
    sidecar = start(*arguments, BROKEN="raises")
    backend = backend_of("alpamayo", sidecar)
    for _ in range(2):
        response = respond(backend, "m", drive_request).response
        assert "/answer says 500: RuntimeError: CUDA out of memory. Tried" in response.error_msg
    assert sidecar.stop() == 0


def test_llavida_is_asked_in_words_and_its_text_becomes_a_trajectory(
    start, drive_request, tmp_path
):
    sidecar = start("llavida_sidecar.py", "--loader", "sidecar_models:llavida")
    request = replace(drive_request, frames=drive_request.frames[-1:])
    response = respond(backend_of("llavida", sidecar), "m", request).response
    assert response.text.startswith("(72, 128, 3) uint8 ")
    assert response.decoding["prompt"] == "the request's"
    trajectory = adapt("llavida", response, request).trajectory
    assert trajectory.t_s == (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    assert trajectory.x_m[:2] == (0.0, 4.0)
    assert trajectory.y_m[1] == pytest.approx(0.1)  # their x is to the right
    assert sidecar.call("POST", "/answer", {**request_to_json(request)})[0] == 422

    (tmp_path / "words.txt").write_text("{history} {speed_mps:.1f}")
    sidecar = start(
        "llavida_sidecar.py", "--loader", "sidecar_models:llavida", "--prompt", "words.txt"
    )
    other = respond(backend_of("llavida", sidecar), "m", request).response
    assert other.text.startswith("(72, 128, 3) uint8 5\n")  # five positions
    assert other.decoding["prompt"] == "words.txt"
    assert other.decoding["prompt_sha256"] != response.decoding["prompt_sha256"]


def test_a_model_that_loads_says_so_and_is_waited_for(start, drive_request, tmp_path):
    gate = tmp_path / "loaded"
    sidecar = start("alpamayo_sidecar.py", "--loader", "sidecar_models:alpamayo", LOADING=str(gate))
    _, _, health = sidecar.call("GET", "/health")
    assert (health["ready"], health["detail"]) == (False, "the model is being loaded")
    status, headers, _ = sidecar.call("POST", "/answer", request_to_json(drive_request))
    assert (status, headers["Retry-After"]) == (503, "5")
    backend = backend_of("alpamayo", sidecar, start_s=0.3)
    with pytest.raises(PeerError, match="isn't ready yet \\(the model is being loaded\\)"):
        backend.answer(drive_request)
    gate.write_text("")
    sidecar.until_ready()
    assert backend.answer(drive_request).text.startswith("Keep speed")


def post_in_thread(sidecar, request_id, replies, **options):
    """Posts a bare request; its reply goes into replies."""

    def post():
        value = {"schema": "ssp.vla_http/1", "request_id": request_id}
        try:
            replies[request_id] = sidecar.call("POST", "/answer", value, **options)
        except OSError as error:
            replies[request_id] = error

    thread = threading.Thread(target=post)
    thread.start()
    return thread


@pytest.fixture
def counting(start, tmp_path):
    """A sidecar that works on its first request until the gate is opened; it has begun that."""
    begun, gate = tmp_path / "begun", tmp_path / "gate"
    sidecar = start(
        "sidecar_service.py",
        "--loader",
        "sidecar_models:counting",
        BEGUN=str(begun),
        WORKING=str(gate),
    ).until_ready()
    replies = {}
    thread = post_in_thread(sidecar, "first", replies)
    until(begun.exists, "begin of the call")
    yield sidecar, gate, replies
    gate.write_text("")
    thread.join(DEADLINE_S)


def queued_request(sidecar, request_id, replies):
    """The thread of a request that got the place in the queue; before that it gets 503 at once."""
    threads = []

    def tried():
        threads.append(post_in_thread(sidecar, request_id, replies))
        threads[-1].join(0.5)
        return threads[-1].is_alive()

    until(tried, "try")
    return threads[-1]


def test_one_works_one_waits_and_a_third_is_told_when_to_come_back(counting):
    sidecar, gate, replies = counting
    second = queued_request(sidecar, "second", replies)
    post_in_thread(sidecar, "third", replies).join(DEADLINE_S)
    status, headers, _ = replies["third"]
    assert (status, headers["Retry-After"]) == (503, "1")
    gate.write_text("")
    second.join(DEADLINE_S)
    until(lambda: "first" in replies, "first reply")
    status, _, first = replies["first"]
    assert (status, first["request_id"], first["text"]) == (200, "first", "first")
    assert first["decoding"]["ssp"] == []  # nothing of SSP is in its process
    assert replies["second"][2]["text"] == "first second"


def test_a_request_whose_sender_has_gone_is_dropped(counting):
    sidecar, gate, replies = counting
    post_in_thread(sidecar, "gone", replies, timeout_s=0.3).join(DEADLINE_S)
    assert isinstance(replies["gone"], TimeoutError)
    following = queued_request(sidecar, "next", replies)
    gate.write_text("")
    following.join(DEADLINE_S)
    assert replies["next"][2]["text"] == "first next"


def test_sigterm_lets_the_answer_in_the_works_go_out(counting):
    sidecar, gate, replies = counting
    sidecar.process.send_signal(signal.SIGTERM)
    gate.write_text("")
    assert sidecar.process.wait(DEADLINE_S) == 0
    until(lambda: "first" in replies, "first reply")
    assert replies["first"][2]["text"] == "first"


def test_a_sigterm_that_another_thread_takes_ends_it(start, drive_request):
    sidecar = start("sidecar_service.py", "--loader", "sidecar_models:struck").until_ready()
    assert sidecar.call("POST", "/answer", request_to_json(drive_request))[0] == 200
    assert sidecar.process.wait(DEADLINE_S) == 0


def test_sigterm_ends_what_loads_and_what_is_idle(start, tmp_path, drive_request):
    arguments = ("alpamayo_sidecar.py", "--loader", "sidecar_models:alpamayo", "--stop-s", "600")
    assert start(*arguments, LOADING=str(tmp_path / "never")).stop() == 0
    # Right behind an answer: the main thread is about to wait for the next one.
    for _ in range(3):
        sidecar = start(*arguments).until_ready()
        assert sidecar.call("POST", "/answer", request_to_json(drive_request))[0] == 200
        assert sidecar.stop() == 0


def test_sigterm_ends_a_model_that_hangs(start, tmp_path):
    begun = tmp_path / "begun"
    sidecar = start(
        "sidecar_service.py",
        "--loader",
        "sidecar_models:hanging",
        "--stop-s",
        "0.2",
        BEGUN=str(begun),
    ).until_ready()
    replies = {}
    thread = post_in_thread(sidecar, "first", replies)
    until(begun.exists, "begin of the call")
    assert sidecar.stop() == 0
    thread.join(DEADLINE_S)
    assert isinstance(replies["first"], OSError | http.client.HTTPException)


def test_a_token_is_asked_for(start, drive_request, monkeypatch):
    monkeypatch.setenv("SIDECAR_TOKEN", "a-long-token")
    monkeypatch.setenv("OTHER_TOKEN", "another-token")
    sidecar = start(
        "alpamayo_sidecar.py", "--loader", "sidecar_models:alpamayo", "--token-env", "SIDECAR_TOKEN"
    )
    assert sidecar.call("GET", "/health")[0] == 401
    right = backend_of("alpamayo", sidecar, api_key_env="SIDECAR_TOKEN")
    assert right.answer(drive_request).text
    for options in ({}, {"api_key_env": "OTHER_TOKEN"}):
        with pytest.raises(PeerError, match=r"asks for a key \(401\)"):
            backend_of("alpamayo", sidecar, start_s=1.0, **options).answer(drive_request)


def test_what_is_no_request_is_refused(start):
    sidecar = start(
        "sidecar_service.py",
        "--loader",
        "sidecar_models:counting",
        "--max-mb",
        "0.001",
        BEGUN=os.devnull,
    ).until_ready()
    schema = {"schema": "ssp.vla_http/1"}
    assert sidecar.call("GET", "/")[0] == 404
    assert sidecar.call("POST", "/health", schema)[0] == 404
    assert sidecar.call("POST", "/answer", {"schema": "x"})[0] == 400
    assert sidecar.call("POST", "/answer", schema)[0] == 400
    assert sidecar.call("POST", "/answer", {**schema, "request_id": "x" * 2000})[0] == 413
    assert sidecar.call("POST", "/answer", None, {"Content-Length": "-1"})[0] == 411
    assert sidecar.call("GET", "/health")[2]["ready"]


@pytest.mark.parametrize(
    ("script", "arguments", "status", "words"),
    [
        ("alpamayo_sidecar.py", (), 1, "error: alpamayo1_5 can't be imported by "),
        *(
            ("alpamayo_sidecar.py", ("--loader", f"sidecar_models:weights_{kind}"), 1, words)
            for kind, words in (
                ("without_flash_attention", "isn't installed); start with --attention sdpa"),
                ("of_another_attention", "is not supported.); start with --attention sdpa"),
                ("elsewhere", "the weights nowhere can't be loaded (Repo id must be in the form"),
            )
        ),
        ("llavida_sidecar.py", ("--weights", "x"), 1, "error: LLaViDA can't be imported by"),
        ("llavida_sidecar.py", (), 1, "--weights must name the folder"),
        ("llavida_sidecar.py", ("--prompt", "nowhere.txt"), 2, "nowhere.txt can't be read"),
        ("sidecar_service.py", (), 2, "--loader is missing"),
        ("sidecar_service.py", ("--loader", "nowhere:load"), 1, "--loader nowhere:load: No module"),
        ("sidecar_service.py", ("--loader", "json:load_it"), 1, "has no attribute 'load_it'"),
        (
            "sidecar_service.py",
            ("--loader", "sidecar_models:raising"),
            1,
            "error: the model can't be loaded: the checkpoint is torn",
        ),
        (
            "sidecar_service.py",
            ("--loader", "x:y", "--token-env", "NOT_THERE"),
            2,
            "NOT_THERE holds no token",
        ),
        (
            "sidecar_service.py",
            ("--loader", "x:y", "--host", "192.0.2.1"),
            1,
            "error: can't listen on 192.0.2.1:0",
        ),
    ],
)
def test_what_cant_be_started_says_so_in_a_line(tmp_path, script, arguments, status, words):
    process = popen(script, *arguments, cwd=tmp_path)
    _, errors = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == status
    assert words in errors
    if "raising" not in " ".join(arguments):
        assert "Traceback" not in errors


@pytest.mark.parametrize("script", sorted(path.name for path in SIDECARS.glob("*.py")))
def test_sidecars_are_python_3_10_and_import_nothing_of_ours(script):
    tree = ast.parse((SIDECARS / script).read_text(), feature_version=(3, 10))
    for node in ast.walk(tree):
        names = [node.module] if isinstance(node, ast.ImportFrom) else []
        names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        assert not [name for name in names if name and name.startswith("ssp")]


class TensorLike:
    """A tensor on a GPU, which can't be read before it is detached and on the CPU."""

    def __init__(self, values, where="cuda", attached=True):
        self._values, self._where, self._attached = values, where, attached

    def detach(self):
        return TensorLike(self._values, self._where, False)

    def cpu(self):
        return TensorLike(self._values, "cpu", self._attached)

    @property
    def shape(self):
        return self._values.shape

    def reshape(self, *shape):
        return TensorLike(self._values.reshape(*shape), self._where, self._attached)

    def tolist(self):
        if self._attached or self._where != "cpu":
            raise TypeError("can't convert this tensor")
        return self._values.tolist()


def test_arrays_and_tensors_become_json_exactly():
    values = np.array([[0.1, np.nan], [-np.inf, 4.0]], np.float32)
    io = load_io()
    for one in (values, TensorLike(values)):
        array = io.native_array("a", one, "ego_xyz", "m", 0.1, 0.1)
        assert array["shape"] == [2, 2]
        assert array["data"] == [float(np.float32(0.1)), "nan", "-inf", 4.0]
    assert io.texts(np.array([["a", "b"]])) == [["a", "b"]]
    assert io.texts("['a']") == "['a']"
    assert [io.first_text(x) for x in ([["a", "b"]], "c", [[]])] == ["a", "c", ""]


def test_poses_are_interpolated_inside_the_history(straight_history):
    io = load_io()
    history = [
        {"t_s": t_s, "x_m": 8 * t_s, "y_m": 0.0, "yaw_rad": yaw}
        for t_s, yaw in ((-0.25, 3.1), (-0.15, -3.1), (0.0, 0.0))
    ]
    request = {"history": history, "ego_provenance": "measured"}
    poses = io.past_poses(request, 3, 0.1)
    assert [x for x, _, _ in poses] == pytest.approx([-1.6, -0.8, 0.0])
    # Half way from 3.1 over π to −3.1, not over 0.
    assert abs(abs(poses[0][2]) - np.pi) < 1e-9
    with pytest.raises(io.UnanswerableError, match=r"from -0\.3 to 0 s"):
        io.past_poses(request, 4, 0.1)
