"""``ssp bench``: runs the benchmarks of a source checkout and prints ours, bound and ratio."""

from __future__ import annotations

import json
import os
import subprocess
import sys
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
