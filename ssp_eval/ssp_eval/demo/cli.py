"""``ssp demo``: the whole way from K* to report and evidence package in one command."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import click
from rich.progress import Progress

from ssp_core import console
from ssp_core.files import make_folder, write_json
from ssp_eval.demo import plan
from ssp_eval.demo.folder import LOGS, MARKER, SCHEMA, own_folder
from ssp_eval.demo.follow import follow


@click.command()
@click.option(
    "--scenario",
    "scenarios",
    type=click.Choice(plan.SCENARIOS),
    multiple=True,
    default=plan.DEFAULT_SCENARIOS,
    show_default=True,
    help="Event to show; repeatable.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    help="Folder for everything; an earlier demonstration there is replaced.",
)
@click.option("--json", "as_json", is_flag=True, help="Print a summary as JSON.")
def demo(scenarios: tuple[str, ...], out: Path, as_json: bool) -> int:
    """Show events in three domains: compile, run, audit, ask two bridges, score, report, pack.

    Each event comes from its K* file. The `physical` sessions are a software stand-in on another
    site with disturbances: no vehicle moves, and no figure of this demonstration says anything
    about one.
    """
    started = time.monotonic()
    with own_folder(out) as folder:
        if folder != out:
            console.note(f"another demonstration works in {out}; this one goes to {folder}")
        console.note("the physical sessions are a software stand-in, not a vehicle")
        (folder / "clips").mkdir()
        steps = plan.steps(folder, list(dict.fromkeys(scenarios)))
        with console.progress("demo", len(steps)) as bar:
            follow(
                steps,
                make_folder(folder / LOGS),
                on_start=lambda step, number: _tell(bar, step, number, len(steps)),
                on_end=lambda _: bar.advance(bar.task_ids[0]),
            )
        seconds = time.monotonic() - started
        index, package = folder / "index.html", plan.package_folder(folder)
        write_json(folder / MARKER, {"schema": SCHEMA, "wall_s": round(seconds, 1)})
    if as_json:
        summary = {"report": str(index), "package": str(package), "wall_s": round(seconds, 1)}
        click.echo(json.dumps(summary))
    else:
        console.out.print(f"done in {seconds:.0f} s; open {index}", markup=False)
        console.out.print(f"evidence package, verified: {package}", markup=False)
    return 0


def _tell(bar: Progress, step: plan.Step, number: int, total: int) -> None:
    bar.update(bar.task_ids[0], description=step.title)
    if not sys.stderr.isatty():
        console.note(f"[{number}/{total}] {step.title}")
