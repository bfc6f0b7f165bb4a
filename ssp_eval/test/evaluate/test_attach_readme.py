"""The ways to attach a model, as the documents give them: taken out of the text and run."""

from __future__ import annotations

import json
import re
import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_eval.evaluate.bridges import PROFILE
from tests.support.processes.waiting import DEADLINE_S

pytestmark = [pytest.mark.ros, pytest.mark.system]

ROOT = Path(__file__).parents[3]
README = ROOT / "ssp_vla_bridge" / "README.md"
RESEARCHER = ROOT / "docs" / "researcher.md"
WAYS = [
    pytest.param(README, "python", id="python"),
    pytest.param(README, "http", id="http"),
    pytest.param(README, "node", id="node"),
    pytest.param(RESEARCHER, "python", id="researcher"),
]


def way(file: Path, name: str) -> tuple[str, str]:
    """Code and command of a way, as they stand in the text."""
    found = re.search(
        rf"<!-- way: {name} -->\n```python\n(.*?)```\n+```sh\n(.*?)```", file.read_text(), re.S
    )
    assert found is not None, f"{file} has no way {name}"
    return found[1], found[2]


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def running(script: Path, env: Mapping[str, str], wait_for: Callable[[], bool]) -> Iterator[None]:
    """The user's script in a process of its own, up to the end of the block."""
    process = subprocess.Popen([sys.executable, script.name], cwd=script.parent, env=dict(env))
    try:
        deadline = time.monotonic() + DEADLINE_S
        while not wait_for():
            assert process.poll() is None, f"{script.name} ended"
            assert time.monotonic() < deadline, f"{script.name} isn't ready"
            time.sleep(0.05)
        yield
    finally:
        process.kill()
        process.wait()


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def evaluate(command: str, bag: Path, folder: Path, env: Mapping[str, str]) -> dict[str, Any]:
    """Runs a document's command for a bag, and gives its cell.json."""
    words = shlex.split(command.replace("BAG", str(bag)))
    assert words[0] == "./ssp"
    run = subprocess.run(
        [sys.executable, "-m", "ssp_core.cli", *words[1:], "--propose-labels"],
        cwd=folder,
        env=dict(env),
        capture_output=True,
        text=True,
        timeout=DEADLINE_S,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    (cell,) = (folder / "out" / "mine" / "cells").glob("*__mine/cell.json")
    found: dict[str, Any] = json.loads(cell.read_text())
    records = [json.loads(line) for line in cell.with_name("records.jsonl").open()]
    assert len(records) == 9
    assert all(record["trajectory"] is not None and record["text"] for record in records)
    return found


@pytest.mark.parametrize(("file", "name"), WAYS)
def test_the_text_of_a_way_is_short_and_runs(
    name: str, file: Path, bag_writer: Callable[..., Path], tmp_path: Path
) -> None:
    code, command = way(file, name)
    assert len((code + command).splitlines()) < 20
    bag = bag_writer(tmp_path / "bag")
    port = str(free_port())
    code, command = code.replace("8300", port), command.replace("8300", port)
    named = re.match(r"# (\w+\.py)\n", code)
    assert named is not None
    script = tmp_path / named[1]
    script.write_text(code)
    with free_domain() as domain_id:
        env = session_environment(domain_id, PROFILE)
        if name == "python":
            cell = evaluate(command, bag, tmp_path, env)
            assert cell["model_ids"] == ["python(my_model:drive)"]
            return
        ready = (lambda: listens(int(port))) if name == "http" else lambda: True
        with running(script, env, ready):
            cell = evaluate(command, bag, tmp_path, env)
    assert cell["model_ids"] == ["my/model-1.0"]
    assert cell["decoding"] == [{"temperature": 0}]
    assert cell["answers"]["missing"] == []
