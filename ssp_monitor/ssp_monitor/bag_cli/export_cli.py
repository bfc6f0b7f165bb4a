"""``ssp bag export``: frames as images or MP4, everything else as tables."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from ssp_core.bag.reader import BagReader
from ssp_core.console import note, out, progress
from ssp_monitor.bag_cli.selection import chosen_span, chosen_topics, span_options
from ssp_monitor.export.export import ExportReport, Wanted, export_bag


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@span_options
@click.option(
    "--frames",
    type=click.Choice(["jpg", "png"]),
    help="Each frame as an image; what was recorded so is copied byte for byte.",
)
@click.option("--video", is_flag=True, help="An MP4 per image topic, at the recorded times.")
@click.option("--csv", is_flag=True, help="A table per topic as CSV.")
@click.option("--parquet", is_flag=True, help="A table per topic as Parquet (needs pyarrow).")
@click.option(
    "-o", "--out", "target", type=click.Path(path_type=Path), required=True, help="New folder."
)
@click.option("--json", "json_", is_flag=True, help="Print JSON for programs.")
def export_command(
    source: Path,
    start: str | None,
    end: str | None,
    topics: tuple[str, ...],
    exclude: tuple[str, ...],
    frames: str | None,
    video: bool,
    csv: bool,
    parquet: bool,
    target: Path,
    json_: bool,
) -> None:
    """Export frames of a bag as images or MP4, and its topics as tables.

    Tables have one row per message, or per item where a message is an array of messages; nested
    fields have dotted names, and times stand in ns and in s.
    """
    if not (frames or video or csv or parquet):
        raise click.UsageError("nothing to export: give --frames, --video, --csv or --parquet")
    with BagReader(source) as bag:
        start_ns, stop_ns = chosen_span(bag, start, end)
        wanted = Wanted(
            topics=chosen_topics(bag, topics, exclude),
            start_ns=start_ns,
            stop_ns=stop_ns,
            frames=f".{frames}" if frames else None,
            video=video,
            csv=csv,
            parquet=parquet,
        )
        with progress("exporting", None) as bar:
            task = bar.task_ids[0]
            report = export_bag(bag, wanted, target, lambda count: bar.advance(task, count))
    if json_:
        click.echo(json.dumps({"path": str(target), **asdict(report)}, indent=1))
        return
    _tell(target, report)


def _tell(target: Path, report: ExportReport) -> None:
    for text in report.notes:
        note(text)
    width = max((len(one.file) for one in report.written), default=0)
    for one in report.written:
        out.print(f"{one.file:{width}}  {one.count:>8} {one.unit}", markup=False)
    out.print(f"{target}: {len(report.written)} exported", markup=False)
