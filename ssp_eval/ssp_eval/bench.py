"""``ssp bench``: the benchmarks of a source checkout, each path beside its own lower bound."""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import HostError, PeerError

# In the order in which the data flow.
BENCHMARKS = (
    "topology",
    "wire",
    "consistency",
    "dispatch",
    "iso",
    "sil",
    "sil_in_process",
    "sil_driven",
    "closed_loop",
    "carla",
    "recorder",
    "recording",
    "seek",
    "replay",
    "memory",
    "scoring",
    "analysis",
    "extraction",
    "page",
    "report_page",
    "growth",
)
# These show a page in a browser, which isn't installed with the project.
NEED_BROWSER = ("report_page",)
# This one speaks to CARLA's client, which is an extra.
NEED_CARLA = ("carla",)
# A file carla.py would stand in the way of the client of that name.
FILES = {"carla": "carla_camera"}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# A benchmark that missed a limit is measured this often in all.
MOST_RUNS = 3
NAME_COLUMNS, WIDTH = 31, 80


@dataclass(frozen=True)
class Figure:
    """One figure of a benchmark, as measured in each of its runs."""

    runs: tuple[dict[str, Any], ...]

    @property
    def median_run(self) -> dict[str, Any]:
        """The run in the middle by our figure: of three runs neither the luckiest nor the worst."""
        middle = statistics.median_low([run["ours"] for run in self.runs])
        return next(run for run in self.runs if run["ours"] == middle)

    @property
    def missed(self) -> int:
        """Runs in which the limit was missed."""
        return sum(not run["kept"] for run in self.runs)

    @property
    def is_within_limit(self) -> bool:
        """The limit was kept in most of the runs."""
        return 2 * self.missed < len(self.runs)

    @property
    def verdict(self) -> str:
        """``ok``, ``noisy`` (missed, but not in most of the runs), ``MISSED``; empty: no limit."""
        if self.median_run["limit"] is None:
            return ""
        if self.missed:
            return "noisy" if self.is_within_limit else "MISSED"
        return "ok"


def file_of(name: str) -> str:
    """Name the file of a benchmark."""
    return f"{FILES.get(name, name)}.py"


def run_benchmark(folder: Path, name: str, long: bool) -> list[dict[str, Any]]:
    """Return the figures of one run of a benchmark.

    Raises:
        PeerError: it failed; the message ends with its last lines.
    """
    path = os.pathsep.join(filter(None, (str(folder.parents[1]), os.environ.get("PYTHONPATH"))))
    process = subprocess.run(
        [sys.executable, file_of(name)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": path, "SSP_BENCH_LONG": "1" if long else ""},
    )
    if process.returncode != 0:
        tail = "\n".join(process.stderr.splitlines()[-10:])
        raise PeerError(f"benchmark {name} failed with status {process.returncode}\n{tail}")
    return [json.loads(line) for line in process.stdout.splitlines() if line.startswith("{")]


def measure(folder: Path, name: str, long: bool) -> list[Figure]:
    """Return a benchmark's figures; one beyond a limit is measured again, to rule out noise."""
    runs = [run_benchmark(folder, name, long)]
    while len(runs) < MOST_RUNS and not all(figure["kept"] for run in runs for figure in run):
        runs.append(run_benchmark(folder, name, long))
    return [Figure(repeats) for repeats in zip(*runs, strict=True)]


def row(figure: Figure, notes: bool) -> str:
    """Return a figure as a line of at most 80 columns; misses and notes stand on lines below."""
    median = figure.median_run
    name = median["name"].split(": ", 1)[-1]
    ours = f"{median['ours']:.4g} {median['unit']}"
    ratio = "" if median["ratio"] is None else f"x {median['ratio']:.2f}"
    limit = (median["limit"] or "").removesuffix(f" {median['unit']}")
    values = f"{ours:<17} {ratio:<7} {figure.verdict:<6} {limit}".rstrip()
    if len(name) > NAME_COLUMNS:
        lines = [f"  {name}", f"  {'':{NAME_COLUMNS}} {values}"]
    else:
        lines = [f"  {name:{NAME_COLUMNS}} {values}"]
    if figure.missed:
        each = ", ".join(f"{run['ours']:.4g}" for run in figure.runs)
        ratios = ", ".join(f"{run['ratio']:.2f}" for run in figure.runs if run["ratio"] is not None)
        lines.append(
            f"      missed in {figure.missed} of {len(figure.runs)} runs: {each} {median['unit']}"
            + (f"; ratios {ratios}" if ratios else "")
        )
    if notes:
        if median["bound"] is not None:
            lines.append(f"      bound: {median['bound']:.4g} {median['unit']}")
        lines += click.wrap_text(median["note"], WIDTH, "      ", "      ").splitlines()
    return "\n".join(lines)


@click.command()
@click.argument("names", nargs=-1, type=click.Choice(BENCHMARKS))
@click.option(
    "--long", is_flag=True, help="The long loads too: half an hour instead of five minutes."
)
@click.option("--notes", is_flag=True, help="Show below each figure its bound, sizes and counts.")
@click.option("--json", "as_json", is_flag=True, help="One line per figure, for programs.")
def bench(names: Sequence[str], long: bool, notes: bool, as_json: bool) -> int:
    """Measure each path beside its own lower bound, in the same run.

    A row shows our figure, its ratio to the bound (x 1 can't be beaten), and whether a limit is
    kept. A row that misses its limit is measured twice more: `noisy` missed it in one of three
    runs, `MISSED` in most of them. Leave the machine idle meanwhile.

    Without a browser the row of the report's page is left out, with a notice at the start.

    Exit status: 0 every limit is kept, 1 one is missed.
    """
    root = os.environ.get("SSP_ROOT")
    if root is None or not (Path(root) / "tests" / "bench").is_dir():
        raise HostError("the benchmarks need the source checkout: start them with ./ssp bench")
    is_within_limits = True
    selection = tuple(names) or BENCHMARKS
    lacking = [
        name for name in selection if name in NEED_BROWSER and not any(map(shutil.which, BROWSERS))
    ]
    if lacking:
        why = f"there is no browser ({', '.join(BROWSERS)}): apt-get install chromium"
        if names:
            raise HostError(f"{', '.join(lacking)}: {why}")
        console.note(f"{why}; left out: {', '.join(lacking)}")
        selection = tuple(name for name in selection if name not in lacking)
    lacking = [name for name in selection if name in NEED_CARLA and find_spec("carla") is None]
    if lacking:
        why = "CARLA's client isn't installed (docs/carla.md)"
        if names:
            raise HostError(f"{', '.join(lacking)}: {why}")
        console.note(f"{why}; left out: {', '.join(lacking)}")
        selection = tuple(name for name in selection if name not in lacking)
    with console.progress("bench", len(selection)) as bar:
        for name in selection:
            bar.update(bar.task_ids[0], description=f"bench {name}")
            figures = measure(Path(root) / "tests" / "bench", name, long)
            is_within_limits = is_within_limits and all(
                figure.is_within_limit for figure in figures
            )
            if as_json:
                for figure in figures:
                    record = figure.median_run | {
                        "kept": figure.is_within_limit,
                        "runs": len(figure.runs),
                    }
                    click.echo(json.dumps(record | {"missed": figure.missed}))
            else:
                click.echo("\n".join([name, *(row(figure, notes) for figure in figures)]))
            bar.advance(bar.task_ids[0])
    return 0 if is_within_limits else 1
