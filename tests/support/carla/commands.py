"""Commands that import CARLA's client, run in processes of their own, and what they must leave."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.support.carla.counterpart import Counterpart

ROOT = Path(__file__).parents[3]
# Far more than any of these processes takes on a busy machine.
PATIENCE_S = 300.0


# Runs several command lines in one process, each from a new client, and prints what came of them.
_COMMANDS = """
import contextlib, io, json, sys
from ssp_core.cli import main
told = []
for arguments in json.loads(sys.stdin.read()):
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        status = main(arguments)
    told.append((status, out.getvalue()))
print(json.dumps(told))
"""
Told = tuple[int, str]


def client(*arguments: str, given: str = "", starts: int = 1) -> str:
    """Run Python, which may import CARLA's client, in a process of its own; its output.

    Args:
        *arguments: of Python.
        given: to its standard input.
        starts: how often it may be started, where the client crashes in its own code: in one of
            some hundred starts on a busy machine it calls a null pointer, or closes a socket twice
            and boost ends the process.
    """
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    for _ in range(starts):
        done = subprocess.run(
            [sys.executable, *arguments],
            input=given,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
            env={**os.environ, "PYTHONPATH": path},
        )
        aborted = done.returncode == -signal.SIGABRT and "boost" in done.stderr
        if done.returncode != -signal.SIGSEGV and not aborted:
            break
    assert done.returncode == 0, (done.returncode, done.stdout, done.stderr)
    return done.stdout


def ssp(*commands: Sequence[object]) -> list[Told]:
    given = json.dumps([[str(one) for one in command] for command in commands])
    # CARLA's client writes its own warnings to the same output, line by line.
    return json.loads(client("-c", _COMMANDS, given=given).splitlines()[-1])  # type: ignore[no-any-return]


def left_as_found(server: Counterpart) -> None:
    assert server.settings == server.left_settings
    server.settle(PATIENCE_S)
    assert (server.lights, server.lights_stopped) == (server.left_lights, False)
    assert sorted(actor.definition[1] for actor in server.actors.values()) == sorted(
        ["spectator", *["traffic.traffic_light"] * 2, *server.behaviour.foreign]
    )


def refused(told: Told, *words: str) -> None:
    status, text = told
    assert status == 1, text
    for word in words:
        assert word in " ".join(text.split()), text
