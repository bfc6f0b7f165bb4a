"""``ssp twins``: recordings beside a recording that differ from it in one cause."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from pathlib import Path

import click
from rich.table import Table

from ssp_core import console
from ssp_core.bag.reading.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.options import usage_errors
from ssp_core.vocabulary import ObjectClass
from ssp_eval.data.provenance import find_bag
from ssp_eval.twins.bag import TOGETHER, make_twins
from ssp_eval.twins.changes import Change, parse_change, usual_changes
from ssp_eval.twins.files import (
    SET_FILE,
    TwinRecord,
    finished_twin,
    read_set,
    remove_twin,
    twins_folder,
    write_set,
)
from ssp_eval.twins.playback import IMAGE, Factual, World, read_factual

ALL = "all"


@click.command("twins")
@click.argument("recording", metavar="RUN", type=click.Path(path_type=Path))
@click.option(
    "--change",
    "wanted",
    multiple=True,
    required=True,
    metavar="WHAT",
    help="What differs, in one of the forms above; may be repeated.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the twins as JSON (ssp.twin_set/1).")
@click.option("--force", is_flag=True, help="Make existing twins again.")
def twins(recording: Path, wanted: tuple[str, ...], as_json: bool, force: bool) -> int:
    """Make twins of a recording: the same in everything but one cause.

    RUN is the folder of a simulated session, or its bag. In a twin the VUT and everything unchanged
    are where they were recorded, and nothing reacts. Each becomes a bag, RUN/twins/NAME/bag, with
    its differences in twin.json; twin_set.json lists all twins. A finished twin of the same
    recording isn't made again.

    \b
    without=ID         the object is removed
    class=ID:CLASS     another class in its place
    mirror=ID          on the other side of the VUT
    shift=ID:SECONDS   later by SECONDS, or earlier if negative
    control[=CLASS]    an irrelevant object far beside the road is added
    camera=SECONDS     frames from where the VUT was SECONDS earlier; its history unchanged
    history=SHARE      the VUT's history at this share of its speed; frames unchanged
    all                each of these for each object target

    Exit status 1 if a twin that was named differs in more than its cause, or in nothing.
    """
    with usage_errors():
        changes_by_word = {word: parse_change(word) for word in wanted if word != ALL}
    bag_path = find_bag(recording)
    began_s = time.monotonic()
    with BagReader(bag_path) as bag:
        factual = read_factual(bag)
        changes = list(changes_by_word.values())
        if ALL in wanted:
            targets = factual.run.targets
            classes = {one.id: ObjectClass.from_word(one.object_class) for one in targets}
            changes += usual_changes(classes)
        changes = list({change.name: change for change in changes}.values())
        for change in changes:
            World(factual, change)  # raises for somebody who isn't there
        _check_set(bag_path, factual, force)
        missing = _missing(bag_path, factual, changes, force)
        _make(factual, bag, missing)
    made_of = factual.run.run_id, factual.provenance.bag_sha256
    twin_set = write_set(bag_path, *made_of)
    if as_json:
        click.echo(twin_set.model_dump_json(by_alias=True, indent=1))
    else:
        show([twin for twin in twin_set.twins if twin.identity.name in {c.name for c in changes}])
        there = len(changes) - len(missing)
        console.note(
            f"{len(missing)} made in {time.monotonic() - began_s:.1f} s"
            + (f", {there} were there already" if there else "")
            + f"; written to {twins_folder(bag_path)}"
        )
    names = {change.name for change in changes_by_word.values()}
    return int(any(t.identity.name in names and not t.audit.holds for t in twin_set.twins))


def _check_set(bag: Path, factual: Factual, force: bool) -> None:
    """Check that the folder's twins are of this recording; with ``force`` remove others.

    Raises:
        InputError: they are of another recording.
    """
    try:
        there = read_set(bag)
    except InputError:
        if not force:
            raise
        shutil.rmtree(twins_folder(bag))
        return
    if there is None or there.of_sha256 == factual.provenance.bag_sha256:
        return
    if not force:
        raise InputError(
            "holds twins of another recording",
            file=twins_folder(bag) / SET_FILE,
            field="of_sha256",
            value=there.of_sha256,
            remedy="give --force to replace them, or move the folder away",
        )
    shutil.rmtree(twins_folder(bag))


def _missing(bag: Path, factual: Factual, changes: Sequence[Change], force: bool) -> list[Change]:
    """Return the changes without a finished twin; remains of these are removed."""
    missing = []
    for change in changes:
        if force or finished_twin(bag, change.name, factual.provenance.bag_sha256) is None:
            remove_twin(bag, change.name)
            missing.append(change)
    return missing


def _make(factual: Factual, bag: BagReader, changes: Sequence[Change]) -> None:
    with console.progress("making twins", len(changes) * bag.topics[IMAGE].count) as bar:
        task = bar.task_ids[0]
        for first in range(0, len(changes), TOGETHER):
            group = changes[first : first + TOGETHER]
            bar.update(task, description=", ".join(change.name for change in group))
            make_twins(factual, bag, group, lambda: bar.advance(task))
            write_set(bag.path, factual.run.run_id, factual.provenance.bag_sha256)


def show(records: Sequence[TwinRecord]) -> None:
    """Print the differences, a twin a row, and every reason why one doesn't hold.

    Frames that differ and pixels in each of these, pixels outside object and shadow, messages that
    differ or are gone.
    """
    table = Table(box=None, pad_edge=False)
    for name in ("twin", "frames", "px each", "outside", "messages", "holds"):
        table.add_column(name, no_wrap=True, justify="left" if name == "twin" else "right")
    for twin in records:
        audit = twin.audit
        outside = "–" if audit.outside_px is None else str(audit.outside_px)
        if audit.outside_px and not audit.outside_judged:
            outside = f"({outside})"
        table.add_row(
            twin.identity.name,
            f"{audit.frames_changed} of {audit.frames}",
            str(round(audit.changed_px / max(1, audit.frames_changed))),
            outside,
            str(sum(audit.messages_changed.values()) + sum(audit.messages_missing.values())),
            "yes" if audit.holds else "no",
        )
    console.out.print(table)
    for twin in records:
        for reason in twin.audit.reasons:
            console.out.print(f"{twin.identity.name}: {reason}", markup=False)
