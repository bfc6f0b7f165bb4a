"""``ssp test``: format, lint, types and tests of a source checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import click

from ssp_core import console
from ssp_core.errors import HostError

PACKAGES = (
    "ssp_msgs/ssp_core",
    "ssp_scenario_manager/ssp_scenario_manager",
    "ssp_ot_controller/ssp_ot_controller",
    "ssp_monitor/ssp_monitor",
    "ssp_vla_bridge/ssp_vla_bridge",
    "ssp_eval/ssp_eval",
)


QUICK = "ros and not system"
SESSIONS = "ros or system"
# Where the language model of --real-model lies, and the variable that tells its tests so.
MODEL_FOLDER = ".venv/real-model"
MODEL_VARIABLE = "SSP_REAL_MODEL"


def _checks(
    arguments: tuple[str, ...], quick: bool, real_model: bool
) -> list[tuple[str, list[str]]]:
    tools = ("tools", [sys.executable, "bootstrap/bootstrap.py", "--test-tools"])
    pytest = [sys.executable, "-m", "pytest", "--durations=50", "--durations-min=0.5"]
    if real_model:
        folder = "tests/real_model"
        return [
            tools,
            ("model", [sys.executable, f"{folder}/install.py", MODEL_FOLDER]),
            ("tests with a real model", [*pytest, "-m", "real_model", folder, *arguments]),
        ]
    checks = [
        tools,
        ("format", ["ruff", "format", "--check", "."]),
        ("lint", ["ruff", "check", "."]),
        ("types", ["mypy", *PACKAGES]),
    ]
    if arguments:
        chosen = ["-m", "not system"] if quick else []
        return [*checks, ("tests", [*pytest, *chosen, *arguments])]
    # Who has done its share takes of another's. A test of nodes waits for processes more than it
    # works: one more at once than there are processors.
    stealing = ["--dist", "worksteal", "-n"]
    at_once = str((os.cpu_count() or 1) + 1)
    of_nodes = ("tests of nodes", QUICK) if quick else ("tests of nodes and sessions", SESSIONS)
    return [
        *checks,
        ("tests of cores", [*pytest, *stealing, "auto", "-m", "not ros and not system"]),
        (of_nodes[0], [*pytest, *stealing, at_once, "-m", of_nodes[1]]),
    ]


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--quick", is_flag=True, help="Leave out the tests that run whole sessions.")
@click.option(
    "--real-model",
    is_flag=True,
    help="Instead, download a small language model (130 MB) and run the tests that ask it: about "
    "15 minutes, both processors, half a GB of memory.",
)
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(quick: bool, real_model: bool, pytest_arguments: tuple[str, ...]) -> int:
    """Run format, lint, types and all tests; further arguments go to pytest.

    All of them run even when one fails; exit status 1 when any did.
    """
    root = os.environ.get("SSP_ROOT")
    if root is None or not (Path(root) / "pyproject.toml").is_file():
        raise HostError("the tests need the source checkout: start them with ./ssp test")
    # Compiled tests are kept: to rewrite their asserts takes each process half a minute.
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    # As many processes as processors: a small matrix isn't worth waiting for each other's threads.
    environment.setdefault("OPENBLAS_NUM_THREADS", "1")
    environment[MODEL_VARIABLE] = str(Path(root) / MODEL_FOLDER)
    failed = []
    for name, command in _checks(pytest_arguments, quick, real_model):
        console.note(f"== {name}")
        started = time.monotonic()
        status = subprocess.run(command, cwd=root, env=environment, check=False).returncode
        seconds = time.monotonic() - started
        console.note(f"== {name} {'ok' if status == 0 else 'FAILED'} after {seconds:.0f} s")
        if status != 0:
            failed.append(name)
    if failed:
        console.report_error(f"failed: {', '.join(failed)}")
    return 1 if failed else 0
