"""``ssp spec``: check, draw, compare, extract and review event specifications."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from ssp_core.cli import VerbGroup
from ssp_core.console import note, visible
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json, write_text
from ssp_core.host.terminal import pasteable
from ssp_scenario_manager.checks.base import Failure, summed_up
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.event_spec.fields import show
from ssp_scenario_manager.event_spec.graph import differences, interaction_graph
from ssp_scenario_manager.event_spec.load import (
    event_text,
    event_version,
    load_event,
    read_event_file,
)
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.event_spec.picture import picture
from ssp_scenario_manager.extract.blank import blank_event
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Of fields with one cause, how many are named.
MOST_NAMED = 8
# Loaded when they are asked for: they need what the other commands don't.
# The clip's module lives in a package that this one doesn't depend on.
_LAZY = {
    "clip": (
        "ssp_eval.recordings.source_clip:clip_command",
        "Make a synthetic source clip, and the K* that is bound to it.",
    ),
    "extract": (
        "ssp_scenario_manager.cli.spec_extract:extract_command",
        "Ask a vision model about a clip and write a candidate.",
    ),
    "review": (
        "ssp_scenario_manager.cli.spec_extract:review_command",
        "Decide what a candidate or a K* leaves open, field by field.",
    ),
}


@click.group(cls=VerbGroup, verbs=_LAZY)
def spec() -> None:
    """Check, draw, compare, extract and review event specifications (K*)."""


@spec.command()
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
def check(files: tuple[str, ...], as_json: bool) -> int:
    """Check K* files, or shipped events by name (METHOD 1).

    All failures are reported together: those of the file's form, or, if there are none, those of
    C1-C5 and of the review state with its seals. Failures that one action mends are grouped (--json
    lists each).
    """
    reports = [_report(name) for name in files]
    if as_json:
        click.echo(json.dumps(reports, indent=1, sort_keys=True))
    else:
        for report in reports:
            _print_report(report)
    return 0 if all(report["ok"] for report in reports) else 1


def _report(name: str) -> dict[str, Any]:
    """Report on one file; one that can't be read has an error."""
    report: dict[str, Any] = {"file": name, "ok": False, "version": None, "error": None}
    try:
        value, path = read_event_file(name)
    except InputError as error:
        return report | {"error": str(error), "failures": []}
    failures = check_event(value)
    if not any(failure.check == "form" for failure in failures):
        report["version"] = event_version(Event.model_validate(value))
    failure_entries = [failure.as_dict() for failure in failures]
    return report | {"file": str(path), "ok": not failures, "failures": failure_entries}


def _print_report(report: dict[str, Any]) -> None:
    if report["error"]:
        click.echo(f"{click.style('error', fg='red', bold=True)}  {visible(report['error'])}")
        return
    count = len(report["failures"])
    if not count:
        click.echo(f"{click.style('ok', fg='green', bold=True)}  {visible(report['file'])}")
        click.echo(f"    {report['version']}")
        return
    checks = "1 failure" if count == 1 else f"{count} failures"
    click.echo(f"{click.style(checks, fg='red', bold=True)}  {visible(report['file'])}")
    for group in summed_up([Failure(**item) for item in report["failures"]]):
        _print_group(group, report["file"])


def _print_group(group: Sequence[Failure], file: str) -> None:
    """Print once the failures that one action mends; `--json` has every failure by itself."""
    first = group[0]
    fields = [failure.field for failure in group]
    texts = {name: getattr(first, name) for name in ("evidence", "reason", "origin", "remedy")}
    texts["remedy"] = texts["remedy"].replace(" FILE", f" {file}")
    title = first.field
    if first.origin == "open decision":
        click.echo(f"\n  {click.style(f'{len(group)} open decisions', bold=True)}")
        for failure in group:
            click.echo(visible(f"    {failure.field:<36} {failure.remedy}"))
        then = pasteable("spec", "review", file, "--who", "NAME")
        click.echo(visible(f"    fill them in, or {then} asks for each"))
        return
    if len(group) > 1:
        title, texts["evidence"] = f"{len(group)} fields", _name_list(fields)
    click.echo(f"\n  {click.style(f'{first.check:<6}', bold=True)} {visible(title)}")
    for name, text in texts.items():
        label = "fields" if name == "evidence" and len(group) > 1 else name
        click.echo(f"    {click.style(f'{label:<9}', dim=True)} {visible(text)}")


def _name_list(fields: Sequence[str]) -> str:
    listing = ", ".join(fields[:MOST_NAMED])
    more = len(fields) - MOST_NAMED
    return f"{listing} and {more} more" if more > 0 else listing


@spec.command()
@click.argument("kind", type=click.Choice(list(KINDS)), metavar="KIND")
@click.option("--name", help="Name of the event [default: new_KIND].")
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="File to write [default: NAME.event.yaml].",
)
def new(kind: str, name: str | None, out: Path | None) -> None:
    """Write a commented K* for a KIND of interaction, complete but for a person's decisions."""
    name = name or f"new_{kind}"
    out = out or Path(f"{name}.event.yaml")
    if out.exists():
        raise InputError("exists already", file=out, remedy="another --out")
    blank = blank_event(kind, name)
    write_text(out, event_text(blank.event, blank.marks))
    click.echo(visible(out))
    then = pasteable("spec", "check", out)
    note(f"fill in what is marked `decide`; {then} lists what is left")


@spec.command()
@click.argument("file")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="A .svg (picture) or .json (graph) file, or a folder for both.",
)
@click.option("--force", is_flag=True, help="Replace existing files.")
@click.option("--json", "as_json", is_flag=True, help="Print the graph as JSON.")
def graph(file: str, out: Path | None, force: bool, as_json: bool) -> None:
    """Draw a K*: the typed interaction graph as JSON and as a picture (METHOD 1)."""
    event, version = load_event(file)
    targets = [] if out is None else _targets(event, out)
    for path in targets:
        if path.exists() and not force:
            raise InputError("exists already", file=path, remedy="another --out, or --force")
    open_ = check_event(event)
    if open_:
        note(f"{len(open_)} checks don't hold; {pasteable('spec', 'check', file)} says which")
    data = interaction_graph(event)
    if as_json:
        click.echo(json.dumps(data, indent=1))
    elif out is None:
        _print_graph(data, version)
    for path in targets:
        make_folder(path.parent)
        if path.suffix == ".svg":
            write_text(path, picture(event))
        else:
            write_json(path, data)
        (note if as_json else click.echo)(visible(path))


def _targets(event: Event, out: Path) -> list[Path]:
    """Return files to write: the one that was named, or both in a folder."""
    if out.suffix in (".svg", ".json") and not out.is_dir():
        return [out]
    if out.suffix and not out.is_dir():
        raise click.UsageError(f"--out {out}: name a .svg or .json file, or a folder")
    return [out / f"{event.name}.graph.json", out / f"{event.name}.graph.svg"]


def _print_graph(data: dict[str, Any], version: str) -> None:
    click.echo(f"{visible(data['event']['name'])}  {version}")
    for node in data["nodes"]:
        click.echo(visible(f"  {node['type']:<14} {node['id']}"))
    for edge in data["edges"]:
        line = f"  {edge['kind']:<12} {edge['from']} —{edge['relation']}→ {edge['to']}"
        click.echo(visible(line))
    intervals = sum("value" in item for item in data["uncertain"].values())
    click.echo(f"  {len(data['determined'])} determined values, {intervals} open or intervals")


@spec.command()
@click.argument("first", metavar="A")
@click.argument("second", metavar="B")
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
def diff(first: str, second: str, as_json: bool) -> int:
    """Compare two K* field by field; notations that mean the same count as equal.

    Exit status 1 if they differ.
    """
    (old, old_version), (new, new_version) = load_event(first), load_event(second)
    changes = differences(old, new)
    if as_json:
        items = [item.as_dict() for item in changes]
        versions = {"first": old_version, "second": new_version}
        click.echo(
            json.dumps(
                {"same": not changes, "versions": versions, "differences": items},
                indent=1,
                sort_keys=True,
            )
        )
        return 1 if changes else 0
    if not changes:
        click.echo(f"the same version: {old_version}")
        return 0
    click.echo(visible(f"{first}  {old_version}\n{second}  {new_version}"))
    for item in changes:
        click.echo(f"\n  {click.style(visible(item.field), bold=True)}")
        _print_side("-", "red", item.old, missing=item.where == "second")
        _print_side("+", "green", item.new, missing=item.where == "first")
    return 1


def _print_side(sign: str, colour: str, value: Any, *, missing: bool) -> None:
    text = "(not there)" if missing else visible(show(value))
    click.echo(click.style(f"    {sign} {text}", fg=colour))
