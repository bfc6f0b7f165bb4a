"""Campaigns whose models start slowly, or sit behind services that want or refuse something."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_eval.evaluate.bridges import PROFILE, TopicClients
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.clients.model_client import ModelClient
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.cell_file import CellResult
from tests.support.processes.waiting import until

pytestmark = [pytest.mark.ros, pytest.mark.system]

BagMaker = Callable[..., Path]
KEY = "a-key-of-the-service-0123456789"
PLAN = {
    "name": "trajectory",
    "shape": [3, 2],
    "data": [0, 0, 4, 0, 8, 0],
    "frame": "ego_xy",
    "unit": "m",
    "step_s": 0.5,
    "first_time_s": 0.0,
}


class Service(ThreadingHTTPServer):
    """A model behind HTTP, with a key if it has one, busy for some of its requests or silent."""

    def __init__(
        self, key: str = "", busy_at: tuple[int, ...] = (), silent_at: tuple[int, ...] = ()
    ) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.key, self.busy_at, self.silent_at, self.request_count = key, busy_at, silent_at, 0
        self.ended = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class _Handler(BaseHTTPRequestHandler):
    server: Service

    def _reply(self, status: int, value: dict[str, Any], **headers: str) -> None:
        body = json.dumps({"schema": "ssp.vla_http/1", "model_id": "m/1", **value}).encode()
        self.send_response(status)
        for name, text in headers.items():
            self.send_header(name, text)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def _allowed(self) -> bool:
        key = self.server.key
        if not key or self.headers.get("Authorization") == f"Bearer {key}":
            return True
        self._reply(401, {"error": "no key"})
        return False

    def do_GET(self) -> None:
        if self._allowed():
            self._reply(200, {"ready": True, "detail": ""})

    def do_POST(self) -> None:
        asked = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        if not self._allowed():
            return
        self.server.request_count += 1
        if self.server.request_count - 1 in self.server.silent_at:
            self.server.ended.wait(60.0)
            return
        if self.server.request_count - 1 in self.server.busy_at:
            self._reply(503, {"error": "busy"}, **{"Retry-After": "1"})
            return
        answer = {"text": "A car is ahead.", "arrays": [PLAN], "decoding": {"seed": 1}}
        self._reply(200, {"request_id": asked["request_id"], **answer})

    def log_message(self, *args: Any) -> None:
        """Says nothing."""


@contextmanager
def serving(**options: Any) -> Iterator[Service]:
    with Service(**options) as service:
        thread = threading.Thread(target=service.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield service
        finally:
            service.ended.set()
            service.shutdown()
            thread.join()


def evaluate(
    bag: Path, out: Path, *models: ModelSpec, start_timeout_s: float = 30.0, **options: Any
) -> list[CellResult]:
    with TopicClients(out / "logs", 20.0, False, start_timeout_s) as clients:
        return run_campaign([(bag, None)], models, clients, out, CellOptions(**options), True)


def test_a_service_that_needs_a_key_costs_its_cell_and_no_key_is_kept(
    make_bag: BagMaker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SERVICE_KEY", KEY)
    bag, out = make_bag(), tmp_path / "out"
    with serving(key=KEY) as service:
        lacking = ModelSpec("lacking", {"url": service.url}, backend="http")
        given = {"url": service.url, "api_key_env": "SERVICE_KEY"}
        refused, answered = evaluate(bag, out, lacking, ModelSpec("keyed", given, backend="http"))
    assert (refused.status, refused.sent, refused.missing) == ("failed", 9, 9)
    assert dict(refused.losses) == {"bridge answered an error": 9}
    asked = [json.loads(line) for line in (refused.folder / "requests.jsonl").open()]
    for one in asked:
        assert "asks for a key (401)" in one["missing"]
        assert "api_key_env" in one["missing"]
    # The campaign went on to the next model, over the same backend.
    assert (answered.status, answered.missing, service.request_count) == ("ok", 0, 9)
    assert answered.score is not None
    assert answered.score["n"] == 9
    cell = json.loads((answered.folder / "cell.json").read_text())
    assert cell["backend_options"]["api_key_env"] == "SERVICE_KEY"
    files = [file for file in out.rglob("*") if file.is_file()]
    assert len(files) > 10
    assert not [file for file in files if KEY.encode() in file.read_bytes()]


def test_a_request_that_a_service_didn_t_take_is_asked_again(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    bag = make_bag()
    with serving(busy_at=(2, 5)) as service:
        options = {"url": service.url, "tries": 1}
        model = ModelSpec("m", options, backend="http")
        (once,) = evaluate(bag, tmp_path / "once", model)
        assert dict(once.losses) == {"bridge overloaded": 2}
        service.request_count = 0
        (again,) = evaluate(bag, tmp_path / "again", model, retry_errors=1, retry_pause_s=0.0)
    assert (again.missing, again.again, service.request_count) == (0, 2, 11)
    answers = json.loads((again.folder / "cell.json").read_text())["answers"]
    assert (answers["asked_again"], answers["sent"]) == (2, 9)


def test_a_service_that_hangs_is_asked_again_only_where_that_is_wanted(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    """Two in a row: a bridge that is at a request still would be started again, this one isn't."""
    bag = make_bag()
    with serving(silent_at=(2, 3)) as service:
        model = ModelSpec("m", {"url": service.url, "timeout_s": 3.0}, backend="http")
        (once,) = evaluate(bag, tmp_path / "once", model)
        assert (dict(once.losses), service.request_count) == ({"no answer in time": 2}, 9)
        asked = [json.loads(line) for line in (once.folder / "requests.jsonl").open()]
        assert "error 1: " in asked[2]["missing"]
        # Of the second, what was left when the request had been made ready.
        within = re.search(r"no whole answer within (\S+) s", asked[2]["missing"])
        assert within is not None
        assert 0.0 < float(within[1]) <= 3.0
        log = (tmp_path / "once" / "logs" / "bridge_m.log").read_text()
        assert log.count("is ready") == 1
        service.request_count = 0
        (again,) = evaluate(bag, tmp_path / "again", model, retry_errors=2, retry_pause_s=0.0)
    assert (again.missing, again.again, service.request_count) == (0, 2, 11)


def test_the_time_to_start_is_an_option(make_bag: BagMaker, tmp_path: Path) -> None:
    with free_domain() as domain_id:
        run = subprocess.run(
            [
                sys.executable,
                "-m",
                "ssp_core.cli",
                "evaluate",
                str(make_bag()),
                "--json",
                "--propose-labels",
                "--attach",
                "nobody",
                "--start-timeout",
                "0.5",
                "--out",
                str(tmp_path / "out"),
                "--no-controls",
            ],
            env=session_environment(domain_id, PROFILE),
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
    assert run.returncode == 1
    line = json.loads(run.stdout)
    assert (line["status"], line["missing"]) == ("failed", 9)
    assert line["reasons"] == ["no bridge for nobody on its topics within 0.5 s"]


def test_a_bridge_that_comes_late_serves_the_cell_that_is_asked_once_more(
    make_bag: BagMaker, tmp_path: Path
) -> None:
    """Its model loads until the second cell asks for it; by then the first was asked in vain."""
    go, log = tmp_path / "go", tmp_path / "logs" / "bridge_slow.log"
    (tmp_path / "slow_model.py").write_text(
        f"import pathlib, time\nwhile not pathlib.Path({str(go)!r}).exists():\n"
        "    time.sleep(0.05)\ndef drive(request):\n    return 'I keep my speed.'\n"
    )

    class Clients(TopicClients):
        call_count = 0

        def client(self, *arguments: Any) -> ModelClient:
            self.call_count += 1
            if self.call_count == 2:
                go.touch()
                until(lambda: "is ready" in log.read_text(), "the bridge to be ready")
            return super().client(*arguments)

    options = {"function": "slow_model:drive", "folder": str(tmp_path)}
    slow = ModelSpec("slow", options, backend="python")
    bags = [(make_bag(), None), (make_bag("second", domain="physical"), None)]
    with Clients(log.parent, 20.0, False, 5.0) as clients:
        first, second = run_campaign(bags, [slow], clients, tmp_path / "out", CellOptions(), True)
    assert (first.status, second.status, clients.call_count) == ("ok", "ok", 3)
    # It was started once: two bridges on the same topics would answer everything twice.
    answers = json.loads((second.folder / "cell.json").read_text())["answers"]
    assert answers["ignored"] == {"late": 0, "duplicate": 0, "unknown": 0}
    assert (tmp_path / "logs" / "bridge_slow.log").read_text().count("is ready") == 1
