"""All that a driver gets, byte by byte: a proxy between a session and a model's service records it.

It gets frames, its own motion, the camera and the task, and nothing else (METHOD 8.2).
"""

from __future__ import annotations

import base64
import json
import re
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from typing import Any

import pytest

from ssp_core.run_file.latency import Latency
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.vocabulary import CONFLICTS, MOTIONS, POSITIONS, Phase
from ssp_core.world.driver import driver_options
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import run_in_process

SEED = 1
PARTS = {
    *("schema", "request_id", "stamp_ns", "frames", "camera", "history"),
    *("ego_provenance", "task", "previous", "prompt"),
}
HEALTH = {"schema": "ssp.vla_http/1", "model_id": "m", "ready": True, "detail": ""}


class Proxy(ThreadingHTTPServer):
    """Records each byte that comes, and passes it on to a service."""

    daemon_threads = True

    def __init__(self, service: int) -> None:
        super().__init__(("127.0.0.1", 0), BaseHTTPRequestHandler)
        self.service = service
        self.came: list[bytes] = []

    def finish_request(self, request: Any, client_address: Any) -> None:
        """Pass one connection on; a model's bridge has one exchange in each."""
        del client_address
        with socket.create_connection(("127.0.0.1", self.service)) as onward:
            back = threading.Thread(target=self._pass, args=(onward, request, None))
            back.start()
            came = bytearray()
            self.came.append(came)  # type: ignore[arg-type]
            forth = threading.Thread(target=self._pass, args=(request, onward, came), daemon=True)
            forth.start()
            back.join()

    @staticmethod
    def _pass(source: socket.socket, to: socket.socket, kept: bytearray | None) -> None:
        try:
            while data := source.recv(65536):
                if kept is not None:
                    kept += data
                to.sendall(data)
        except OSError:
            return


class Keeps(BaseHTTPRequestHandler):
    """A service that plans at its present speed."""

    def log_message(self, *_: Any) -> None:
        """Say nothing."""

    def do_GET(self) -> None:
        self._say(HEALTH)

    def do_POST(self) -> None:
        asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        v = asked["history"][-1]["speed_mps"]
        data = [value for k in range(11) for value in (0.5 * v * k, 0.0)]
        array = {"name": "trajectory", "shape": [11, 2], "data": data, "frame": "ego_xy"}
        array |= {"unit": "m", "step_s": 0.5, "first_time_s": 0.0}
        answer = {"schema": asked["schema"], "request_id": asked["request_id"], "model_id": "m"}
        self._say({**answer, "text": "", "arrays": [array], "decoding": {}})

    def _say(self, value: Any) -> None:
        body = json.dumps(value).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)


@pytest.fixture(scope="module")
def proxy() -> Iterator[Proxy]:
    service = ThreadingHTTPServer(("127.0.0.1", 0), Keeps)
    made = Proxy(service.server_address[1])
    threads = [
        threading.Thread(target=one.serve_forever, kwargs={"poll_interval": 0.01})
        for one in (service, made)
    ]
    for thread in threads:
        thread.start()
    yield made
    for one in (made, service):
        one.shutdown()
        one.server_close()
    for thread in threads:
        thread.join()


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    folder = tmp_path_factory.mktemp("leakage") / "cut_in"
    compiled = prepare_run("cut_in", "boulevard", folder, seed=SEED, mode="lockstep")
    small = compiled.model_copy(update={"camera": Camera(width_px=64, height_px=64)})
    return make_start(small, load_event("cut_in")[0], SEED, latency_max_s=0.3)


def requests_of(run: RunSpec, proxy: Proxy) -> list[tuple[bytes, Any]]:
    """Head and body of each request of a run."""
    proxy.came.clear()
    run_in_process(run)
    whole = [bytes(came).partition(b"\r\n\r\n") for came in proxy.came]
    return [(head, json.loads(body)) for head, _, body in whole if head.startswith(b"POST")]


def words_of(run: RunSpec, start: Start) -> list[str]:
    """Return the words of the run and of its start that a driver must not get."""
    names = [run.scenario, run.site, run.run_id, run.event_version, start.hash]
    ids = [*run.object_ids, *(trigger.id for trigger in run.triggers)]
    files = ["run.yaml", "task.json", "answers.json", "/tmp", "seed", "trigger", "expert"]
    return [*names, *ids, *files]


def numbers_in(value: Any) -> Iterator[float]:
    if isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from numbers_in(inner)
    elif isinstance(value, int | float):
        yield float(value)


def words_in(text: str, words: list[str]) -> list[str]:
    return [w for w in words if re.search(rf"(?<!\w){re.escape(w.lower())}(?!\w)", text.lower())]


def test_a_driver_gets_frames_motion_camera_and_task_and_nothing_else(
    proxy: Proxy, start: Start
) -> None:
    url = f"http://127.0.0.1:{proxy.server_address[1]}"
    options = driver_options("mine", {"backend": "http", "url": url})
    event = requests_of(start.driven_by("mine", options, Latency(0.3)), proxy)
    free = requests_of(start.driven_by("mine", options, Latency(0.3), event=False), proxy)
    assert len(event) > 20

    for head, body in event:
        lines = head.decode().split("\r\n")
        assert lines[0] == "POST /answer HTTP/1.1"
        fields = {line.partition(":")[0] for line in lines[1:]}
        known = {"Host", "Accept", "Accept-Encoding", "Content-Type", "Content-Length"}
        assert fields <= known | {"User-Agent", "Connection"}
        assert set(body) == PARTS
        assert {key for one in body["history"] for key in one} == {
            *("t_s", "x_m", "y_m", "yaw_rad", "speed_mps", "yaw_rate_radps"),
        }
        assert {key for one in body["frames"] for key in one} == {"stamp_ns", "jpeg_base64"}
        assert (body["previous"], body["ego_provenance"]) == (None, "measured")
        for frame in body["frames"]:
            jpeg = base64.b64decode(frame["jpeg_base64"])
            # The segments of a JPEG before its picture: no comment, no camera's notes.
            assert b"\xff\xfe" not in jpeg[: jpeg.index(b"\xff\xda")]
            assert b"Exif" not in jpeg
            frame["jpeg_base64"] = ""

    # The question is the same at all times, but for the numbers of the own motion in its words.
    tasks = {
        json.dumps([body["task"], body["camera"], re.sub(r"[-\d.]+", "#", body["prompt"])])
        for _, body in event
    }
    assert len(tasks) == 1

    run = start.driven_by("mine", options, Latency(0.3))
    words = words_of(run, start)
    whole = "\n".join(head.decode() + json.dumps(body) for head, body in event)
    assert not words_in(whole, words)
    assert words_in(whole + " ot1 ", words) == ["ot1"]
    # The task's own words name conflicts; all else names no phase and no label.
    rest = json.dumps([{**body, "task": None, "prompt": None} for _, body in event])
    labels = [*(phase.name for phase in Phase), *MOTIONS, *POSITIONS, *CONFLICTS]
    assert not words_in(rest, labels)

    instants_s = [start.hand_over_s, start.observable_s, start.end_s]
    instants_s += start.facts()["triggers_s"]
    for _, body in event:
        told = [body["history"], body["camera"], body["task"]]
        assert not {t for t in instants_s for one in numbers_in(told) if abs(one - t) < 1e-9}

    # Up to the event its twin is the same run, to the byte.
    until_ns = round(start.observable_s * 1e9)
    before = [body for _, body in event if body["stamp_ns"] < until_ns]
    again = [
        {**body, "frames": [{**frame, "jpeg_base64": ""} for frame in body["frames"]]}
        for _, body in free
        if body["stamp_ns"] < until_ns
    ]
    assert [b["request_id"] for b in before] == [str(k + 1) for k in range(len(before))]
    assert len(before) > 3
    triggered_ns = round(min(start.facts()["triggers_s"]) * 1e9)
    steady = [one for one in before if one["stamp_ns"] <= triggered_ns]
    assert steady == again[: len(steady)]


def test_a_driver_that_is_given_its_lane_gets_that_and_nothing_else_more(
    proxy: Proxy, start: Start
) -> None:
    """The boulevard's lane is straight, and the initiator comes from the one beside it."""
    url = f"http://127.0.0.1:{proxy.server_address[1]}"
    options = driver_options("mine", {"backend": "http", "url": url, "centre_line": True})
    run = start.driven_by("mine", options, Latency(0.3))
    asked = requests_of(run, proxy)
    assert len(asked) > 20
    for _, body in asked:
        assert set(body) == PARTS | {"route_m"}
        line = body["route_m"]
        assert 2 <= len(line) <= 81
        assert all(len(point) == 2 for point in line)
        ahead_m = [x for x, _ in line]
        assert ahead_m[0] == pytest.approx(0.0, abs=1e-6)
        assert ahead_m[-1] <= 80.5
        assert ahead_m == sorted(ahead_m)
        # No place of another lane, 3.5 m away, whatever the initiator does there.
        assert max(abs(y) for _, y in line) < 1.0
    # The lane says of a moment only where the VUT is: it is the same line at all times.
    begin, later = asked[0][1]["route_m"], asked[-1][1]["route_m"]
    assert [round(b[0] - a[0], 3) for a, b in pairwise(begin)] == pytest.approx(
        [round(b[0] - a[0], 3) for a, b in pairwise(later)], abs=0.01
    )
    whole = "\n".join(head.decode() + json.dumps(_blind(body)) for head, body in asked)
    assert not words_in(whole, words_of(run, start))


def _blind(body: Any) -> Any:
    return {**body, "frames": [{**frame, "jpeg_base64": ""} for frame in body["frames"]]}
