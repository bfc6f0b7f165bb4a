"""``ssp bag``: looks into bags, checks, recovers, cuts and exports them, and records."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.cut import CutReport, cut_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.sqlite import open_bag
from ssp_core.clock import ns_to_seconds
from ssp_core.console import note, out, progress
from ssp_monitor.bag_tools.export import export_command
from ssp_monitor.bag_tools.info import info_command, topics_text
from ssp_monitor.bag_tools.record import record_command
from ssp_monitor.bag_tools.selection import select_span, select_topics, span_options

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
        click.echo(json.dumps({"path": str(path), "ok": report.ok, **asdict(report)}, indent=1))
    else:
        for problem in report.problems:
            out.print(problem, markup=False)
        for remark in report.remarks:
            note(remark)
        for topic, why in report.undecoded.items():
            out.print(
                f"{topic}: {report.messages.get(topic, 0)} messages not decoded: {why}",
                markup=False,
            )
        if report.seal:
            out.print(f"{path}: {report.seal}", markup=False)
        verdict = "sound" if report.ok else f"problems: {len(report.problems)}"
        out.print(f"{path}: {verdict}, {report.count} messages decoded", markup=False)
    if not report.ok:
        ctx.exit(1)


@click.command("recover")
@click.argument("source", type=BAG)
@click.option("--out", "target", type=BAG, help="New bag directory [default: SOURCE_recovered].")
@as_json
def recover_command(source: Path, target: Path | None, json_: bool) -> None:
    """Recover a readable bag from a recording that was cut off or is damaged in places.

    SOURCE, a directory or .mcap file, stays as it is.
    """
    if target is None:
        target = source.resolve().with_name(f"{source.resolve().stem}_recovered")
    report = recover(source, target)
    if json_:
        click.echo(json.dumps({"path": str(target), **asdict(report)}, indent=1))
        return
    for damage in report.damage:
        note(damage)
    out.print(
        f"{target}: {report.count} messages of {len(report.messages)} topics and "
        f"{len(report.attachments)} attachments kept; read {report.bytes_read} of "
        f"{report.bytes_total} bytes",
        markup=False,
    )


@click.command("cut")
@click.argument("source", type=BAG)
@span_options
@click.option("-o", "--out", "target", type=BAG, required=True, help="New bag directory.")
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def cut_command(
    source: Path,
    start: str | None,
    end: str | None,
    topics: tuple[str, ...],
    exclude: tuple[str, ...],
    target: Path,
    json_: bool,
) -> None:
    """Cut a span of time, or some topics, out of a bag (MCAP or SQLite); the new one is MCAP.

    SOURCE stays as it is. Attachments are kept. Latched topics keep the messages that were valid
    when the span begins; video begins at the keyframe before it.
    """
    with open_bag(source) as bag:
        start_ns, stop_ns = select_span(bag, start, end)
        topic_names = select_topics(bag, topics, exclude)
    with progress("cutting", None) as bar:
        task = bar.task_ids[0]
        report = cut_bag(
            source, target, topic_names, start_ns, stop_ns, lambda count: bar.advance(task, count)
        )
    if json_:
        click.echo(json.dumps({"path": str(target), **asdict(report)}, indent=1))
        return
    _tell(target, report)


def _tell(target: Path, report: CutReport) -> None:
    length = "empty"
    if report.start_ns is not None and report.end_ns is not None:
        length = f"{ns_to_seconds(report.end_ns - report.start_ns):.3f} s"
    out.print(
        f"{target}: {report.count} messages of {topics_text(report.messages.values())}, {length}, "
        f"{len(report.attachments)} attachments",
        markup=False,
    )
    for topic, count in report.repeated.items():
        note(f"{topic}: {count} latched from before the span, at its beginning")
    for topic, count in report.led_in.items():
        note(f"{topic}: {count} frames from the keyframe before the span on")


@click.group()
def bag() -> None:
    """Inspect, cut, export and repair bags."""


for command in (
    info_command,
    check_command,
    cut_command,
    export_command,
    recover_command,
    record_command,
):
    bag.add_command(command)
