"""``ssp bag cut``: a span of time and some topics as a new bag."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from ssp_core.bag.cut import CutReport, cut_bag
from ssp_core.bag.reader import BagReader
from ssp_core.clock import ns_to_seconds
from ssp_core.console import note, out, progress
from ssp_monitor.bag_cli.info_cli import topics_text
from ssp_monitor.bag_cli.selection import chosen_span, chosen_topics, span_options

BAG = click.Path(path_type=Path)


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
    """Cut a span of time, or some topics, out of a bag.

    SOURCE stays as it is. Attachments are kept. Latched topics keep the messages that were valid
    when the span begins; video begins at the keyframe before it.
    """
    with BagReader(source) as bag:
        start_ns, stop_ns = chosen_span(bag, start, end)
        chosen = chosen_topics(bag, topics, exclude)
    with progress("cutting", None) as bar:
        task = bar.task_ids[0]
        report = cut_bag(
            source, target, chosen, start_ns, stop_ns, lambda count: bar.advance(task, count)
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
