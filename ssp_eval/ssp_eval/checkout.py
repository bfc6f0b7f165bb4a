"""``ssp bench`` and ``ssp test``: benchmarks and checks of a source checkout."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from ssp_core import console
from ssp_core.errors import HostError, PeerError

# In the order in which the data flow.
BENCHMARKS = (
    "topology",
    "wire",
    "dispatch",
    "sil",
    "adaptation",
    "recorder",
    "recording",
    "replay",
    "memory",
    "scoring",
    "analysis",
    "extraction",
    "page",
    "report_page",
)


def run_benchmark(folder: Path, name: str) -> list[dict[str, Any]]:
    """The figures of one benchmark.

    Raises:
        PeerError: it failed; the message ends with its last lines.
    """
    done = subprocess.run(
        [sys.executable, f"{name}.py"], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        tail = "\n".join(done.stderr.splitlines()[-10:])
        raise PeerError(f"benchmark {name} failed with status {done.returncode}\n{tail}")
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(BENCHMARKS))
@click.option("--json", "as_json", is_flag=True, help="One line per figure, for programs.")
def bench(names: tuple[str, ...], as_json: bool) -> int:
    """Measure each path beside its own lower bound, in the same run.

    The ratio says how many times as bad as the bound we are; 1 can't be beaten. Where a limit must
    hold, the table says whether it does. Leave the machine alone meanwhile.
    """
    root = os.environ.get("SSP_ROOT")
    if root is None or not (Path(root) / "tests" / "bench").is_dir():
        raise HostError("the benchmarks need the source checkout: start them with ./ssp bench")
    table = Table(box=None, pad_edge=False)
    for title in ("what", "ours", "bound", "unit", "ratio", "limit", "", "with"):
        table.add_column(title, justify="right" if title in ("ours", "bound", "ratio") else "left")
    kept = True
    chosen = names or BENCHMARKS
    with console.progress("bench", len(chosen)) as bar:
        for name in chosen:
            bar.update(bar.task_ids[0], description=f"bench {name}")
            for figure in run_benchmark(Path(root) / "tests" / "bench", name):
                if as_json:
                    click.echo(json.dumps(figure))
                kept = kept and figure["kept"]
                limit = figure["limit"]
                table.add_row(
                    figure["name"],
                    f"{figure['ours']:.4g}",
                    "" if figure["bound"] is None else f"{figure['bound']:.4g}",
                    figure["unit"],
                    "" if figure["ratio"] is None else f"{figure['ratio']:.2f}",
                    limit or "",
                    "" if limit is None else "ok" if figure["kept"] else "not ok",
                    figure["note"],
                )
            bar.advance(bar.task_ids[0])
    if not as_json:
        console.out.print(table)
    return 0 if kept else 1


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


def _checks(arguments: tuple[str, ...], quick: bool) -> list[tuple[str, list[str]]]:
    checks = [
        ("format", ["ruff", "format", "--check", "."]),
        ("lint", ["ruff", "check", "."]),
        ("types", ["mypy", *PACKAGES]),
        ("tools", [sys.executable, "bootstrap/bootstrap.py", "--test-tools"]),
    ]
    pytest = [sys.executable, "-m", "pytest", "--durations=50", "--durations-min=0.5"]
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
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(quick: bool, pytest_arguments: tuple[str, ...]) -> int:
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
    failed = []
    for name, command in _checks(pytest_arguments, quick):
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
