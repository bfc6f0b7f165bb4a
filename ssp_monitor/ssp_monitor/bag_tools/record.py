"""``ssp bag record``: record topics without a session."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ssp_core.console import err, note, out
from ssp_core.host.terminal import on_stop_signals
from ssp_core.options import Number, WholeNumber, usage_errors
from ssp_monitor.recorder.encoding import CODECS
from ssp_monitor.recorder.plan import MB, QUEUE_MB, RESERVE_MB, options_plan
from ssp_monitor.recorder.report import RepeatedWarnings
from ssp_monitor.recorder.topics import MOST_TOPICS


@click.command("record")
@click.argument("topics", nargs=-1, metavar="[TOPIC]...")
@click.option("--all", is_flag=True, help="Every topic, also those that appear later.")
@click.option(
    "--include", multiple=True, metavar="RE", help="Topics whose names match; repeatable."
)
@click.option(
    "--exclude", multiple=True, metavar="RE", help="Leave out topics whose names match; repeatable."
)
@click.option(
    "-o", "--out", "bag", type=click.Path(path_type=Path), required=True, help="New bag directory."
)
@click.option("--duration", type=Number(0.1), metavar="S", help="End after S seconds.")
@click.option("--split-mb", type=Number(0), default=0.0, help="New file at this size.")
@click.option("--split-s", type=Number(0), default=0.0, help="New file after this time.")
@click.option("--video", type=click.Choice(CODECS), help="Record images as video.")
@click.option("--video-topics", default="", metavar="RE", help="Only the images of these topics.")
@click.option(
    "--queue-mb",
    type=WholeNumber(1),
    default=QUEUE_MB,
    show_default=True,
    help="Size of the queue to the disk before messages are dropped.",
)
@click.option(
    "--reserve-mb",
    type=WholeNumber(0),
    default=RESERVE_MB,
    show_default=True,
    help="End the recording when the disk has less free space than this.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def record_command(
    topics: tuple[str, ...],
    bag: Path,
    duration: float | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Record topics into a bag until Ctrl-C.

    Topics given by name are always recorded; --all and --include leave out hidden topics,
    /rosout and /parameter_events. An expression may match anywhere in a name. Ctrl-C is the regular
    end: exit status 0, or 1 if messages were lost or the bag isn't sound.
    """
    if not (topics or given["all"] or given["include"]):
        raise click.UsageError("name topics, or give --all or --include")
    topic_names = frozenset(topic if topic.startswith("/") else f"/{topic}" for topic in topics)
    with usage_errors():
        plan = options_plan({**given, "most_topics": MOST_TOPICS}, bag, "--{}")
    plan = replace(plan, selection=replace(plan.selection, named=topic_names))
    from ssp_monitor.ros.recording import record

    sayings = RepeatedWarnings()
    with _stopped_by_signals() as stop, err.status("") as live:

        def tell(status: Any) -> None:
            live.update(_line(status))
            for warning in status.warnings:
                if sayings.say(warning):
                    note(f"warning: {warning}")

        closed, why = record(plan, stop, duration, tell)
    for name in sorted(topic_names.difference(closed.topics, closed.ambiguous)):
        note(f"warning: {name} had no publisher")
    if why:
        note(f"ended by itself: {why}")
    problems = list(closed.problems)
    ok = not (closed.lost or problems or why)
    if as_json:
        result = {
            "bag": str(bag),
            "ok": ok,
            "messages": closed.state.messages,
            "bytes": closed.state.bytes,
            "files": closed.state.files,
            "topics": len(closed.topics),
            "lost": closed.lost,
            "ended": why,
            "problems": problems,
            "seal": closed.state.seal or None,
            "warnings": sayings.texts(),
        }
        click.echo(json.dumps(result))
    else:
        checked = closed.check.text if closed.check else f"not closed: {closed.state.failure}"
        sealed = [f"seal {closed.state.seal}"] if closed.state.seal else []
        checked = ", ".join((checked, *sealed, *closed.incomplete))
        out.print(
            f"{bag}: {closed.state.messages} messages of {len(closed.topics)} topics, "
            f"{closed.state.bytes / MB:.1f} MB, {closed.lost} lost, {checked}",
            markup=False,
        )
    click.get_current_context().exit(0 if ok else 1)


def _line(status: Any) -> str:
    """Return the recorder's state (RecorderStatus.msg) in one line."""
    return (
        f"{status.messages} messages of {len(status.topics)} topics, {status.bytes / MB:.1f} MB at "
        f"{status.write_bytes_per_s / MB:.1f} MB/s, {status.lost} lost, "
        f"{100 * status.queue_bytes / max(status.queue_limit_bytes, 1):.0f} % of the queue in use"
    )


@contextmanager
def _stopped_by_signals() -> Iterator[threading.Event]:
    """Yield an event that Ctrl-C, SIGTERM and a closed terminal set, so that the bag is closed."""
    stop = threading.Event()
    with on_stop_signals(lambda _: stop.set()):
        yield stop
