"""``ssp audit observe`` and ``ssp audit agree``: what persons saw in a recording (METHOD 4.3)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from ssp_core import console
from ssp_core.bag.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_text
from ssp_core.names import VUT_ID
from ssp_core.options import Number
from ssp_eval.data.provenance import Provenance, bag_folder, find_bag, read_provenance
from ssp_eval.observations.agreement import Agreement, agree
from ssp_eval.observations.files import (
    Footage,
    default_place,
    footage_of,
    load_observation,
    read_observation,
    sealed_observation,
    write_observation,
)
from ssp_eval.observations.model import SCHEMA, Observation
from ssp_eval.observations.page import Choice, chosen, render, shown_frames
from ssp_eval.observations.questions import blank, cards, template
from ssp_scenario_manager.compile.task import TASK_FOLDER
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import LOG_FILE, Record, append_record, utc_now

_PATH = click.Path(path_type=Path)
DEFAULT_TARGETS = ("ot1",)


@dataclass(frozen=True)
class _Subject:
    """A recording to look at, and who takes part in it."""

    bag: Path
    name: str
    provenance: Provenance
    footage: Footage

    @property
    def about(self) -> dict[str, Any]:
        """The file's head, as far as the recording says it."""
        return {
            "recording": self.name,
            "bag_sha256": self.footage.bag_sha256,
            "scenario": self.provenance.scenario,
            "event_version": self.provenance.event_version,
        }

    @property
    def has_log(self) -> bool:
        """Only a session of ours has one."""
        return self.provenance.run is not None


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
@click.option(
    "--most",
    type=click.IntRange(2, 5000),
    default=600,
    show_default=True,
    help="Frames in all, at most.",
)
@click.option(
    "--width", type=click.IntRange(160, 4096), default=960, show_default=True, help="Of frames, px."
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
    most: int,
    width: int,
    force: bool,
) -> None:
    """Makes an offline page to look at BAG with: its frames beside a form (METHOD 4.3).

    BAG is a bag directory, or a run folder that holds bag/. The page saves a draft; `ssp audit
    observe BAG --seal DRAFT` checks it, binds it to the recording by its hash, seals it and puts
    it beside the bag, where `ssp audit SYN SIM PHY` finds it.
    """
    if draft is None and (who is not None or log is not None):
        raise click.UsageError("--who and --log belong to --seal")
    if draft is not None and (as_template or event_name is not None):
        raise click.UsageError("--seal takes neither --template nor --event")
    with console.progress("reading", None):
        subject = _subject(find_bag(bag))
    if draft is not None:
        _seal(subject, draft, who, out, log, force)
        return
    about = subject.about
    vut, targets = _people(subject.provenance)
    if event_name is not None:
        event, version = load_event(event_name)
        about |= {"scenario": event.name, "event_version": version}
        vut = event.vut_id
        targets = tuple(name for name in event.participants if name != vut)
    target = out or subject.bag.absolute().parent / (
        f"{subject.name}.observe.{'yaml' if as_template else 'html'}"
    )
    _check_free(target, force)
    footage = subject.footage
    if as_template:
        text = template(
            str(bag), about, vut, targets, subject.has_log, footage.frames_s, footage.period_s
        )
        make_folder(target.parent)
        write_text(target, text)
        console.note(f"{target}: fill it in, then `ssp audit observe {bag} --seal {target}`")
        return
    indices = chosen(footage, Choice(rate, most, start, end))
    with console.progress("frames", len(indices)) as bar:
        task = bar.task_ids[0]
        frames = shown_frames(subject.bag, indices, footage, width, lambda: bar.advance(task))
    page = render(
        {"schema": SCHEMA, **about, "who": None, "role": None, "when": None, "remark": None}
        | blank(vut, targets, subject.has_log)
        | {"seal": None},
        cards(vut, targets, subject.has_log),
        frames,
        str(bag),
    )
    make_folder(target.parent)
    write_text(target, page)
    console.note(
        f"{target}: {len(frames)} of {len(footage.frames_s)} frames, "
        f"{frames[0].t_s:.2f} to {frames[-1].t_s:.2f} s; open it in a browser"
    )


def _subject(bag: Path) -> _Subject:
    footage = footage_of(bag)
    with BagReader(bag) as reader:
        provenance = read_provenance(reader, footage.bag_sha256)
    folder = bag_folder(bag.absolute())
    name = folder.parent.name if folder.name == "bag" else folder.stem
    return _Subject(bag, name, provenance, footage)


def _people(provenance: Provenance) -> tuple[str, tuple[str, ...]]:
    who = provenance.participants
    return (VUT_ID, DEFAULT_TARGETS) if who is None else (who.vut, tuple(who.targets))


def _check_free(path: Path, force: bool) -> None:
    if path.exists() and not force:
        raise InputError("exists already", file=path, remedy="give --force to replace it")


def _seal(
    subject: _Subject, draft: Path, who: str | None, out: Path | None, log: Path | None, force: bool
) -> None:
    found = sealed_observation(draft, subject.footage, subject.name, utc_now(), who)
    target = out or default_place(subject.bag.absolute(), found.who)
    _check_free(target, force)
    make_folder(target.parent)
    log = log or log_of(subject.bag.absolute())
    append_record(log, observation_record(found, target))
    write_observation(target, found)
    console.out.print(f"{target}: observed by {found.who}, {found.seal}", markup=False)
    open_ones = found.unanswered()
    if open_ones:
        console.note(f"{len(open_ones)} unverified: {', '.join(open_ones)}")
    for reason in found.rejections():
        console.note(f"the source gate refuses it: {reason.replace('_', ' ')}")
    console.note(f"entered into {log}")


def log_of(bag: Path) -> Path:
    """The log L of a recording: that of its task, else the one beside the bag."""
    folder = bag_folder(bag)
    task = folder.parent / TASK_FOLDER / LOG_FILE
    return task if task.is_file() else folder.with_name(f"{folder.name}.log.jsonl")


def observation_record(found: Observation, file: Path) -> Record:
    """The entry of L on a sealed observation."""
    return Record(
        kind="observation",
        when=utc_now(),
        who=found.who,
        subject=found.recording,
        version=found.bag_sha256,
        reason=found.remark or "looked at the recording",
        details={
            "seal": found.seal,
            "file": file.name,
            "looked_at": found.when.isoformat(),
            "unverified": list(found.unanswered()),
        },
    )


@click.command("agree")
@click.argument("files", metavar="A B", nargs=-1, type=_PATH)
@click.option("--bag", type=_PATH, help="Hold the observations against this recording, too.")
@click.option("--json", "as_json", is_flag=True, help="For programs.")
def agree_command(files: tuple[Path, ...], bag: Path | None, as_json: bool) -> int:
    """Shows where two persons' sealed observations A and B of one recording agree.

    A field on which they differ is unverified; times within 0.1 s, or one frame, are the same and
    their mean counts. Exit status 1 where they differ.
    """
    if len(files) < 2:
        raise click.UsageError("name two sealed observations")
    period_s = 0.0
    if bag is None:
        observations = [read_observation(path) for path in files]
    else:
        footage = footage_of(find_bag(bag))
        observations = [load_observation(path, footage) for path in files]
        period_s = footage.period_s
    found = agree(observations, period_s)
    if as_json:
        click.echo(json.dumps(found.to_json(), indent=1, ensure_ascii=False))
    else:
        console.out.print(_agreement_table(found))
        console.note(_agreement_summary(found))
    return 1 if found.differing else 0


def _agreement_table(found: Agreement) -> Table:
    """Field, each observer's answer, how they agree, and what counts."""
    table = Table(box=None, pad_edge=False)
    for name in ("field", *found.observers, "", "counts"):
        table.add_column(name, overflow="fold")
    for row in found.rows:
        table.add_row(row.field, *row.values, row.verdict, row.result)
    return table


def _agreement_summary(found: Agreement) -> str:
    """One sentence."""
    differing = found.differing
    if not differing:
        return f"{found.by} differ in nothing (times within {found.tolerance_s:g} s)"
    return f"{found.by} differ in {len(differing)}: {', '.join(differing)}"
