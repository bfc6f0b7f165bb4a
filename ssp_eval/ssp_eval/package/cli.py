"""``ssp package``: evidence packages, and changes on site."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path, PurePosixPath

import click
from rich.progress import Progress as RichProgress

from ssp_core import console
from ssp_core.errors import InputError
from ssp_core.options import WholeNumber
from ssp_eval.package.log import Change, LogEntries, log_change
from ssp_eval.package.model import Package, Progress, load_table
from ssp_scenario_manager.compile.task import RUN_FILE
from ssp_scenario_manager.event_spec.log import check_not_ahead, utc_now

_PATH = click.Path(path_type=Path)
_WORKERS = click.option(
    "--workers",
    type=WholeNumber(1, 1024),
    default=lambda: os.cpu_count() or 1,
    show_default="processors of this machine",
    help="Processes that share the work, each in half a gigabyte of memory.",
)


@click.group()
def package() -> None:
    """Make and verify evidence packages (METHOD 4); log changes on site."""


@package.command("make")
@click.argument("folders", type=_PATH, nargs=-1, required=True)
@click.option("--out", type=_PATH, required=True, help="Folder to make.")
@click.option("--force", is_flag=True, help="Replace an earlier package there.")
@click.option("--copy", is_flag=True, help="Copy everything; by default, recordings are linked.")
@_WORKERS
@click.option("--json", "as_json", is_flag=True, help="Print a summary as JSON.")
def make_command(
    folders: tuple[Path, ...], out: Path, force: bool, copy: bool, workers: int, as_json: bool
) -> int:
    """Pack everything in FOLDERS into an evidence package.

    Source videos, K*, compiled folders, recordings, labels, audits and evaluated cells, with every
    part of log L. A package is made only if every hash named in it leads to something in it;
    whatever else METHOD 4 asks for is listed as missing.
    """
    from ssp_eval.package.make import make_package

    with console.progress("package (MiB)", None) as bar:
        table, findings = make_package(
            folders, out, force=force, copy=copy, progress=_progress_on(bar), workers=workers
        )
    if as_json:
        summary = {
            "package": str(out),
            "id": table.id,
            "files": len(table.files),
            "links": len(table.links),
            "scores": len(table.chains),
            "missing": table.missing,
            "notes": list(findings.notes),
        }
        click.echo(json.dumps(summary, sort_keys=True))
        return 0
    size_mb = sum(entry.bytes for entry in table.files) / 1e6
    console.out.print(
        f"{out}: {len(table.files)} files, {size_mb:.1f} MB, {len(table.links)} links, "
        f"{len(table.chains)} scores that can be walked back",
        markup=False,
    )
    console.out.print(f"id {table.id}", markup=False)
    _notes(table.missing, findings.notes)
    return 0


@package.command("verify")
@click.argument("folder", metavar="PACKAGE", type=_PATH)
@click.option("--id", "expected_id", help="Id that the package must have, noted when it was made.")
@_WORKERS
@click.option("--json", "as_json", is_flag=True, help="Print what was found as JSON.")
def verify_command(folder: Path, expected_id: str | None, workers: int, as_json: bool) -> int:
    """Check every byte and every link of PACKAGE.

    Exit status 1 if anything was changed; each file is named, with what depends on it.
    """
    from ssp_eval.package.verify import verify_package

    with console.progress("verify (MiB)", None) as bar:
        verdict = verify_package(
            folder, expected_id=expected_id, progress=_progress_on(bar), workers=workers
        )
    if as_json:
        click.echo(json.dumps({"ok": verdict.ok, **asdict(verdict)}, sort_keys=True))
        return 0 if verdict.ok else 1
    for finding in verdict.findings:
        place = f" ({finding.object})" if finding.object not in ("", finding.file) else ""
        console.out.print(f"{finding.kind}: {finding.file}{place}: {finding.text}", markup=False)
        for name in finding.breaks:
            console.out.print(f"  breaks {name}", markup=False)
    _notes(verdict.missing, verdict.notes)
    if verdict.ok:
        console.out.print(
            f"{folder}: sound: {verdict.files} files, {verdict.links} links, {verdict.scores} "
            f"scores walk back to K*\nid {verdict.id}",
            markup=False,
        )
    else:
        count = len(verdict.findings)
        count_text = "1 finding" if count == 1 else f"{count} findings"
        console.out.print(f"{folder}: not sound: {count_text}", markup=False)
    return 0 if verdict.ok else 1


@package.command("show")
@click.argument("folder", metavar="PACKAGE", type=_PATH)
@click.argument("scores", metavar="[SCORE]...", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="Print the steps as JSON.")
def show_command(folder: Path, scores: tuple[str, ...], as_json: bool) -> int:
    """Trace each SCORE of PACKAGE back to K*; without one, list the cells.

    SCORE is CELL:LABEL, the folder name of a cell and the number of a label from 0, such as
    cut_in__simulation__my_model:3; CELL alone means all its labels. Every file on the way is
    hashed.
    """
    from ssp_eval.package.contents import Contents
    from ssp_eval.package.trace import Walker, find_cell

    table = load_table(folder)
    if not scores:
        _list(table, as_json)
        return 0
    walker = Walker(Contents(folder, table.files), table)
    for score in scores:
        name, colon, number = score.rpartition(":")
        cell = find_cell(table, name if colon else score)
        labels = sorted(chain.label for chain in table.chains if chain.cell == cell.path)
        if colon:
            if not number.isascii() or not number.isdigit():
                raise InputError("is no label", value=score, remedy="give CELL:NUMBER, from 0")
            labels = [int(number)]
        for label in labels:
            steps = walker.walk(cell, label)
            if as_json:
                value = {"score": f"{name or score}:{label}", "steps": [asdict(s) for s in steps]}
                click.echo(json.dumps(value, sort_keys=True, ensure_ascii=False))
                continue
            for step in steps:
                console.out.print(f"{step.what}: {step.path}\n  {step.sha256}", markup=False)
                for line in step.says:
                    console.out.print(f"  {line}", markup=False)
    return 0


def _list(table: Package, as_json: bool) -> None:
    counts = Counter(chain.cell for chain in table.chains)
    cells = {e.path: counts[e.path] for e in table.files if e.role == "cell"}
    if as_json:
        value = {"id": table.id, "cells": cells, "missing": table.missing}
        click.echo(json.dumps(value, sort_keys=True))
        return
    console.out.print(f"id {table.id}, made by {table.software}", markup=False)
    for role, count in sorted(Counter(entry.role for entry in table.files).items()):
        console.out.print(f"  {count:5d} {role}", markup=False)
    for path, count in cells.items():
        console.out.print(f"{PurePosixPath(path).parent.name}: {count} scores", markup=False)
    _notes(table.missing, ())


def _notes(missing: Iterable[str], notes: Iterable[str]) -> None:
    """Print what is missing, and each remark once with the first place that it is about."""
    for part in missing:
        console.note(f"missing: {part}")
    places = dict[str, list[str]]()
    for text in notes:
        place, _, remark = text.partition(": ")
        places.setdefault(remark or text, []).append(place)
    for remark, (first, *others) in places.items():
        more = f" and {len(others)} more" if others else ""
        console.note(f"note: {first}{more}: {remark}" if first != remark else f"note: {remark}")


def _progress_on(bar: RichProgress) -> Progress:
    """Show a count of bytes in whole MiB, and the step that follows."""
    task = bar.task_ids[0]
    byte_count = 0

    def more(count: int) -> None:
        nonlocal byte_count
        byte_count += count
        bar.update(task, completed=byte_count >> 20)

    return Progress(
        lambda total: bar.update(task, total=total >> 20),
        more,
        # Reading and judging take longer than hashing, and nobody knows how long.
        lambda text: bar.update(task, description=text, total=None),
    )


@package.command("log-change")
@click.argument("folder", type=_PATH)
@click.option("--field", required=True, help="Path in run.yaml, such as limits.speed_mps.")
@click.option("--old", required=True, help="Compiled value, or the one that was logged last.")
@click.option("--new", required=True, help="Value from now on.")
@click.option("--who", required=True, help="Who changed it.")
@click.option("--reason", required=True, help="Why.")
@click.option("--when", help="ISO 8601, UTC. [default: now]")
@click.option("--apply", is_flag=True, help="Write the new value into run.yaml too.")
@click.option("--json", "as_json", is_flag=True, help="Print the entry as JSON.")
def log_change_command(
    folder: Path,
    field: str,
    old: str,
    new: str,
    who: str,
    reason: str,
    when: str | None,
    apply: bool,
    as_json: bool,
) -> int:
    """Enter a change on site into the log of FOLDER.

    FOLDER is a folder of `ssp compile`, before it is run; or one of `ssp run`, for a change that
    was forgotten. Such an entry stands beside the recording and not in it, and the audit says
    that it was entered later.
    """
    for name, text in (("--who", who), ("--reason", reason)):
        if not text.strip():
            raise InputError("is empty", field=name, remedy="write who, or why, in words")
    time = check_not_ahead(when or utc_now(), utc_now())
    logged = log_change(folder, Change(field, old, new, who, reason, time), apply)
    if as_json:
        record = logged.record.model_dump(mode="json", by_alias=True)
        place = {"log": str(logged.log), "applied": logged.applied, "later": logged.later}
        click.echo(json.dumps({**place, "record": record}, sort_keys=True))
    else:
        _say(logged)
    return 0


def _say(logged: LogEntries) -> None:
    record = logged.record
    console.out.print(
        f"{record.field}: {json.dumps(record.old)} → {json.dumps(record.new)}, entered into "
        f"{logged.log}",
        markup=False,
    )
    if logged.later:
        console.note("entered after the run: the audit will say so")
    elif logged.applied:
        console.note(f"written into {logged.log.with_name(RUN_FILE)}")
    elif logged.run_has != record.new:
        console.note(
            f"{logged.log.with_name(RUN_FILE)} still says {json.dumps(logged.run_has)}; edit it "
            "before the run"
        )
