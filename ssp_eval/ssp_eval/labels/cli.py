"""``ssp labels``: propose a labels file or write a template, check one, show its frames."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.reading import load_model, read_mapping
from ssp_core.files.writing import write_text
from ssp_core.host.terminal import pasteable
from ssp_core.options import Number
from ssp_core.vocabulary import PHASES
from ssp_eval.data.labels import FILL_IN, counts_text, load_labels, phase_counts, unfilled
from ssp_eval.labels.boxes import boxes_command
from ssp_eval.labels.check import (
    event_problems,
    phase_problems,
    plan_problems,
    response_problems,
    risk_warnings,
)
from ssp_eval.labels.new import new
from ssp_eval.labels.review import is_unreviewed, sidecar
from ssp_eval.labels.sheet import Rows, html_sheet, pictures
from ssp_scenario_manager.event_spec.load import load_event

_PATH = click.Path(path_type=Path)


@click.group()
def labels() -> None:
    """Propose labels files, check them, show the frames to label from (METHOD 5.2)."""


labels.add_command(boxes_command)
labels.add_command(new)


@labels.command()
@click.argument("file", type=_PATH)
@click.option("--event", help="K* of the labelled clip itself: its times and version.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
def check(file: Path, event: str | None, as_json: bool) -> int:
    """Check FILE by METHOD 5.2, 5.2b and 1, and warn when no risk response could be reached.

    Exit status 1 if it is a template, or its phases contradict each other, its plan or the event's
    times.
    """
    waiting = unfilled(read_mapping(file))
    if waiting:
        if as_json:
            click.echo(json.dumps({"file": str(file), "template": True, "unfilled": waiting}))
        else:
            click.echo(f"{file}: {FILL_IN} {len(waiting)} fields:")
            for field in waiting:
                click.echo(f"  {field}")
        return 1
    loaded = load_labels(file)
    problems = [*phase_problems(loaded), *plan_problems(loaded)]
    counts = phase_counts(loaded)
    if event is not None:
        k_star, version = load_event(event)
        problems += event_problems(loaded, k_star, version)
    responses = response_problems(loaded)
    warnings = risk_warnings(loaded)
    unreviewed = is_unreviewed(file)
    if as_json:
        value: dict[str, Any] = {
            "file": str(file),
            "template": False,
            "scenario": loaded.scenario,
            "domain": loaded.domain,
            "labels": len(loaded.labels),
            "plan": loaded.plan,
            "phases": counts,
            "risk_onset_s": loaded.risk_onset_s,
            "unreviewed": unreviewed,
            "problems": problems,
            "warnings": [*responses, *warnings],
        }
        click.echo(json.dumps(value, sort_keys=True))
        return 1 if problems else 0
    click.echo(
        console.visible(
            f"{file}: {loaded.scenario} in {loaded.domain}, {len(loaded.labels)} labels "
            f"({counts_text(counts)} in {'/'.join(PHASES)}, by {loaded.plan}), risk from "
            f"{loaded.risk_onset_s:g} s"
        )
    )
    for problem in problems:
        click.echo(console.visible(f"  {problem}"))
    if unreviewed:
        then = pasteable("spec", "review", file, "--who", "NAME")
        console.note(f"note: as proposed and not reviewed ({sidecar(file).name}); {then}")
    for problem in responses:
        console.note(f"warning: no model can get a risk response: {problem}")
    for warning in warnings:
        console.note(f"warning: {warning}")
    return 1 if problems else 0


@labels.command()
@click.argument("source", metavar="BAG|VIDEO", type=_PATH)
@click.option("--labels", "file", type=_PATH, required=True, help="Labels file or template.")
@click.option("--out", type=_PATH, required=True, help="Page to write, .html.")
@click.option(
    "--start", type=Number(0), default=0.0, help="Start of the clip in the file VIDEO, s."
)
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def sheet(source: Path, file: Path, out: Path, start: float, force: bool) -> None:
    """Write a contact sheet: the frames of BAG or VIDEO at the labels' times, with the labels."""
    if out.suffix.lower() != ".html":
        raise click.UsageError(f"--out {out}: name a file that ends in .html")
    if out.exists() and not force:
        raise InputError("exists already", file=out, remedy="give --force to overwrite it")
    rows = load_model(Rows, file)
    with console.progress("frames", None):
        frames = pictures(source, [row.t_s for row in rows.labels], start)
    missing = [f"{row.t_s:g}" for row, one in zip(rows.labels, frames, strict=True) if one is None]
    if len(missing) == len(frames):
        raise InputError(
            "no label's time lies inside the clip",
            file=file,
            field="labels",
            remedy="give the clip that the labels are of, or another --start",
        )
    make_folder(out.parent)
    write_text(out, html_sheet(rows, frames, str(source)))
    if missing:
        console.note(f"warning: no frame at {', '.join(missing)} s")
    console.note(f"{out}: {len(frames) - len(missing)} frames")
