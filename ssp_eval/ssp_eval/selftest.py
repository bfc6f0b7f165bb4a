"""``ssp test``: format, lint, types and all tests of a source checkout."""

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


def _checks(arguments: tuple[str, ...], quick: bool) -> list[tuple[str, list[str]]]:
    checks = [
        ("format", ["ruff", "format", "--check", "."]),
        ("lint", ["ruff", "check", "."]),
        ("types", ["mypy", *PACKAGES]),
        ("tools", [sys.executable, "bootstrap/bootstrap.py", "--test-tools"]),
    ]
    pytest = [sys.executable, "-m", "pytest"]
    if arguments:
        chosen = ["-m", "not system"] if quick else []
        return [*checks, ("tests", [*pytest, *chosen, *arguments])]
    # Tests of nodes and sessions are decided by deadlines and run by themselves, one at a time.
    side_by_side = ["-m", "not ros and not system", "-n", "auto", "--dist", "loadfile"]
    one_by_one = ["-m", "ros and not system" if quick else "ros or system"]
    return [
        *checks,
        ("tests of cores", [*pytest, *side_by_side]),
        ("tests of nodes" if quick else "tests of nodes and sessions", [*pytest, *one_by_one]),
    ]


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--quick", is_flag=True, help="Leave out the tests that run whole sessions.")
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(quick: bool, pytest_arguments: tuple[str, ...]) -> int:
    """Run format, lint, types and all tests; further arguments go to pytest.

    All of them run even when one fails; exit status 1 when any did.
    """
    root = os.environ.get("SSP_ROOT")
    if root is None or not (Path(root) / "pyproject.toml").is_file():
        raise HostError("the tests need the source checkout: start them with ./ssp test")
    failed = []
    for name, command in _checks(pytest_arguments, quick):
        console.note(f"== {name}")
        started = time.monotonic()
        status = subprocess.run(command, cwd=root, check=False).returncode
        seconds = time.monotonic() - started
        console.note(f"== {name} {'ok' if status == 0 else 'FAILED'} after {seconds:.0f} s")
        if status != 0:
            failed.append(name)
    if failed:
        console.report_error(f"failed: {', '.join(failed)}")
    return 1 if failed else 0
