"""``ssp bag check`` and ``recover``: is a bag sound, and what can be saved of one that isn't."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ssp_core.bag.check import CheckReport, check_bag
from ssp_core.bag.repair import RecoverReport, recover
from ssp_core.console import note, out, progress

BAG = click.Path(path_type=Path)
as_json = click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")


@click.command("check")
@click.argument("path", type=BAG)
@as_json
@click.pass_context
def check_command(ctx: click.Context, path: Path, json_: bool) -> None:
    """Read a bag from end to end: checksums, indexes, counts, types. Exit 1 when one is wrong."""
    with progress("checking", None) as bar:
        task = bar.task_ids[0]
        report = check_bag(path, lambda count: bar.advance(task, count))
    if json_:
        click.echo(json.dumps(_check_json(path, report), indent=1))
    else:
        for problem in report.problems:
            out.print(problem, markup=False)
        verdict = "sound" if report.ok else f"problems: {len(report.problems)}"
        out.print(f"{path}: {verdict}, {report.count} messages decoded", markup=False)
    if not report.ok:
        ctx.exit(1)


def _check_json(path: Path, report: CheckReport) -> dict[str, Any]:
    return {
        "path": str(path),
        "ok": report.ok,
        "messages": report.messages,
        "problems": list(report.problems),
    }


@click.command("recover")
@click.argument("source", type=BAG)
@click.option("--out", "target", type=BAG, help="New bag directory [default: SOURCE_recovered].")
@as_json
def recover_command(source: Path, target: Path | None, json_: bool) -> None:
    """Make a readable bag of a recording that was cut off or is damaged in places.

    SOURCE, a directory or .mcap file, stays as it is.
    """
    if target is None:
        target = source.resolve().with_name(f"{source.resolve().stem}_recovered")
    report = recover(source, target)
    if json_:
        click.echo(json.dumps(_recover_json(target, report), indent=1))
        return
    for damage in report.damage:
        note(damage)
    out.print(
        f"{target}: {report.count} messages of {len(report.messages)} topics and "
        f"{len(report.attachments)} attachments kept; read {report.bytes_read} of "
        f"{report.bytes_total} bytes",
        markup=False,
    )


def _recover_json(target: Path, report: RecoverReport) -> dict[str, Any]:
    return {
        "path": str(target),
        "complete": report.complete,
        "messages": report.messages,
        "attachments": list(report.attachments),
        "bytes_read": report.bytes_read,
        "bytes_total": report.bytes_total,
        "damage": list(report.damage),
    }
