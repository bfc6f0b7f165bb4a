"""``ssp audit observe`` and ``ssp audit agree``: what persons saw in a recording (METHOD 4.3)."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.table import Table

from ssp_core import console
from ssp_core.bag.reading.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_text
from ssp_core.host.terminal import pasteable
from ssp_core.names import VUT_ID
from ssp_core.options import Number
from ssp_eval.data.provenance import bag_folder, find_bag, read_provenance
from ssp_eval.observations.agreement import agree
from ssp_eval.observations.files import (
    Footage,
    default_place,
    read_observation,
    sealed_observation,
    write_observation,
)
from ssp_eval.observations.model import SCHEMA, Observation
from ssp_eval.observations.page import page_frames, render, select_frames
from ssp_eval.observations.questions import blank, cards, template
from ssp_eval.recordings.states import frame_times
from ssp_scenario_manager.compile.task import TASK_FOLDER
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import LOG_FILE, Record, append_record, utc_now

_PATH = click.Path(path_type=Path)
DEFAULT_TARGETS = ("ot1",)


@click.command()
@click.argument("bag", type=_PATH)
@click.option(
    "--event", "event_name", metavar="K*", help="By name or file: it gives the participants' ids."
)
@click.option(
    "--out",
    type=_PATH,
    help="File to write [default: beside the bag; NAME.observe.html, NAME.observe.yaml or the "
    "sealed observation].",
)
@click.option("--template", "as_template", is_flag=True, help="YAML for a text editor, no page.")
@click.option("--seal", "draft", type=_PATH, metavar="FILE", help="Check, bind and seal FILE.")
@click.option("--who", metavar="NAME", help="With --seal: who looked, where FILE doesn't say.")
@click.option("--log", type=_PATH, help="With --seal: log L [default: the recording's].")
@click.option("--from", "start", type=Number(), help="Show frames from this clip time on, s.")
@click.option("--to", "end", type=Number(), help="Show frames up to this clip time, s.")
@click.option(
    "--rate",
    metavar="HZ",
    type=Number(0, 1000, low_open=True),
    default=10.0,
    show_default=True,
    help="Show every n-th frame, n as large as leaves at least HZ.",
)
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def observe(
    bag: Path,
    event_name: str | None,
    out: Path | None,
    as_template: bool,
    draft: Path | None,
    who: str | None,
    log: Path | None,
    start: float | None,
    end: float | None,
    rate: float,
    force: bool,
) -> None:
    """Make an offline page to look at BAG with: its frames beside a form (METHOD 4.3).

    BAG is a bag directory, or a run folder that holds bag/. The page saves a draft; `ssp audit
    observe BAG --seal DRAFT` checks it, binds it to the recording by its hash, seals it and puts
    it beside the bag, where `ssp audit SYN SIM PHY` finds it.
    """
    if draft is None and (who is not None or log is not None):
        raise click.UsageError("--who and --log belong to --seal")
    if draft is not None and (as_template or event_name is not None):
        raise click.UsageError("--seal takes neither --template nor --event")
    path = find_bag(bag)
    folder = bag_folder(path.absolute())
    name = folder.parent.name if folder.name == "bag" else folder.stem
    with console.progress("reading", None), BagReader(path) as reader:
        provenance = read_provenance(reader)
        footage = Footage(provenance.bag_sha256, frame_times(reader, provenance)[0])
    if draft is not None:
        observation = sealed_observation(draft, footage, name, utc_now(), who)
        _keep(
            observation,
            out or default_place(path.absolute(), observation.who),
            log or log_of(path),
            force,
        )
        return
    present = provenance.participants
    vut, targets = (VUT_ID, DEFAULT_TARGETS) if present is None else (present.vut, present.ids[1:])
    about = {"scenario": provenance.scenario, "event_version": provenance.event_version}
    if event_name is not None:
        event, version = load_event(event_name)
        about = {"scenario": event.name, "event_version": version}
        vut = event.vut_id
        targets = tuple(name for name in event.participants if name != vut)
    kind = "yaml" if as_template else "html"
    target = out or path.absolute().parent / f"{name}.observe.{kind}"
    _check_free(target, force)
    has_log = provenance.run is not None
    head = {"schema": SCHEMA, "recording": name, "bag_sha256": footage.bag_sha256, **about}
    head |= dict.fromkeys(("who", "role", "when", "remark"))
    empty, questions = head | blank(vut, targets, has_log), cards(vut, targets, has_log)
    if as_template:
        write_text(target, template(str(bag), empty, questions, footage))
        then = pasteable("audit", "observe", bag, "--seal", target)
        console.note(f"{target}: fill it in, then {then}")
        return
    indices = select_frames(footage, rate, start, end)
    with console.progress("frames", len(indices)) as bar:
        task = bar.task_ids[0]
        frames = page_frames(path, indices, footage, lambda: bar.advance(task))
    write_text(target, render(empty | {"seal": None}, questions, frames, str(bag)))
    console.note(
        f"{target}: {len(frames)} of {len(footage.frames_s)} frames, "
        f"{frames[0].t_s:.2f} to {frames[-1].t_s:.2f} s; open it in a browser"
    )


def _check_free(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise InputError("exists already", file=path, remedy="give --force to replace it")


def _keep(observation: Observation, target: Path, log: Path, force: bool) -> None:
    """Write a sealed observation, enter it into the log, and print what it leaves open."""
    _check_free(target, force)
    make_folder(target.parent)
    record = Record(
        kind="observation",
        when=utc_now(),
        who=observation.who,
        subject=observation.recording,
        version=observation.bag_sha256,
        reason=observation.remark or "looked at the recording",
        details={
            "seal": observation.seal,
            "file": target.name,
            "looked_at": observation.when.isoformat(),
            "unverified": list(observation.unanswered()),
        },
    )
    append_record(log, record)
    write_observation(target, observation)
    console.out.print(f"{target}: observed by {observation.who}, {observation.seal}", markup=False)
    if open_ones := observation.unanswered():
        console.note(f"{len(open_ones)} unverified: {', '.join(open_ones)}")
    for reason in observation.rejections():
        console.note(f"the source gate refuses it: {reason.replace('_', ' ')}")
    console.note(f"entered into {log}")


def log_of(bag: Path) -> Path:
    """Return the log L of a recording: that of its task, else the one beside the bag."""
    folder = bag_folder(bag.absolute())
    task = folder.parent / TASK_FOLDER / LOG_FILE
    return task if task.is_file() else folder.with_name(f"{folder.name}.log.jsonl")


@click.command("agree")
@click.argument("files", metavar="A B", nargs=-1, type=_PATH)
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs.")
def agree_command(files: tuple[Path, ...], as_json: bool) -> int:
    """Show where two persons' sealed observations A and B of one recording agree.

    A field on which they differ is unverified; times within 0.1 s, or one frame, are the same and
    their mean counts. Exit status 1 if they differ.
    """
    if len(files) < 2:
        raise click.UsageError("name two sealed observations")
    agreement = agree([read_observation(path) for path in files])
    if as_json:
        click.echo(json.dumps(agreement.to_json(), indent=1, ensure_ascii=False))
        return 1 if agreement.differing else 0
    table = Table(box=None, pad_edge=False)
    for name in ("field", *agreement.observers, "", "counts"):
        table.add_column(name, overflow="fold")
    for row in agreement.rows:
        table.add_row(row.field, *row.values, row.verdict, row.result)
    console.out.print(table)
    if differing := agreement.differing:
        console.note(f"{agreement.by} differ in {len(differing)}: {', '.join(differing)}")
    else:
        console.note(f"{agreement.by} differ in nothing (times within {agreement.tolerance_s:g} s)")
    return 1 if agreement.differing else 0
