"""``ssp bag``: look into, check and repair bags. Any rosbag2 bag that is stored as MCAP will do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from ssp_core.bag import BagReader, RecoverReport, recover
from ssp_core.bag.check import CheckReport, check_bag
from ssp_core.clock import ns_to_seconds
from ssp_core.console import note, out, progress

BAG = click.Path(path_type=Path)
as_json = click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")


@click.group()
def bag() -> None:
    """Look into, check and repair bags."""


@bag.command("info")
@click.argument("path", type=BAG)
@as_json
def info(path: Path, json_: bool) -> None:
    """Topics, types, counts, times and attachments of a bag directory or .mcap file."""
    with BagReader(path) as reader:
        summary = _summary(reader)
    if json_:
        click.echo(json.dumps(summary, indent=1))
        return
    out.print(f"{summary['path']}: {summary['messages']} messages, {_times(summary)}", markup=False)
    rows = [("topic", "type", "messages")]
    rows += [(n, t["type"], str(t["messages"])) for n, t in sorted(summary["topics"].items())]
    name_width, type_width = (max(len(row[column]) for row in rows) for column in (0, 1))
    for name, msgtype, count in rows:
        out.print(f"{name:{name_width}}  {msgtype:{type_width}}  {count:>8}", markup=False)
    for attachment in summary["attachments"]:
        out.print(f"attachment {attachment}", markup=False)


def _summary(reader: BagReader) -> dict[str, Any]:
    start_ns, end_ns = reader.start_ns, reader.end_ns
    return {
        "path": str(reader.path),
        "files": [{"name": f.name, "bytes": f.stat().st_size} for f in reader.files],
        "messages": reader.count,
        "start_ns": start_ns,
        "end_ns": end_ns,
        "topics": {
            name: {"type": t.msgtype, "messages": t.count, "type_hash": t.type_hash}
            for name, t in reader.topics.items()
        },
        "attachments": list(reader.attachments),
    }


def _times(summary: dict[str, Any]) -> str:
    if summary["start_ns"] is None:
        return "no times"
    start_s, end_s = ns_to_seconds(summary["start_ns"]), ns_to_seconds(summary["end_ns"])
    return f"from {start_s:.3f} s to {end_s:.3f} s ({end_s - start_s:.3f} s)"


@bag.command("check")
@click.argument("path", type=BAG)
@as_json
@click.pass_context
def check(ctx: click.Context, path: Path, json_: bool) -> None:
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


@bag.command("recover")
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
