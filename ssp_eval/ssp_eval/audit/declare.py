"""``ssp audit declare``: a named person's word on what the participants of a session were."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import click
import yaml

from ssp_core import console
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.declaration import SCHEMA, day_of, load_declaration, seal_declaration
from ssp_core.errors import InputError
from ssp_core.files.writing import write_text
from ssp_core.host.terminal import pasteable
from ssp_core.names import absolute, declared_topic
from ssp_core.run_file.participation import ParticipantKind
from ssp_eval.data.provenance import bag_folder, find_bag, read_provenance

_PATH = click.Path(path_type=Path, dir_okay=False)


@click.command("declare")
@click.argument("bag", metavar="BAG", type=click.Path(path_type=Path))
@click.argument("file", metavar="[FILE]", type=_PATH, required=False)
@click.option("--template", type=_PATH, metavar="NEW", help="Write a file to fill in, and end.")
def declare(bag: Path, file: Path | None, template: Path | None) -> None:
    """Bind a person's word on what took part in a live session to its bag (METHOD 4.4b).

    BAG is a bag directory, or a run folder that holds bag/. FILE names who says it, when and where
    the session was, and of each participant its kind, device and serial number. The word counts for
    participants that declared nothing themselves; it is sealed and put into the bag's folder.
    """
    if (file is None) == (template is None):
        raise click.UsageError("give FILE, or --template NEW")
    path = find_bag(bag)
    with BagReader(path) as reader:
        facts, day = read_provenance(reader), day_of(reader)
    run, part = facts.run, facts.participation
    if run is None or part is None:
        raise InputError(
            "is no session of ours",
            file=path,
            remedy="give --declared-by to the import of another's recording",
        )
    if template is not None:
        if template.exists():
            raise InputError("exists already", file=template, remedy="name another file")
        silent = [who for who in part.silent or part.declared if who not in part.lost]
        blank = {"kind": ParticipantKind.REAL.value, "device": "", "serial": ""}
        value = {
            "schema": SCHEMA,
            "who": "",
            "date": (day or datetime.now(UTC).date()).isoformat(),
            "place": "",
            "participants": {who: dict(blank) for who in silent},
        }
        write_text(template, yaml.safe_dump(value, sort_keys=False, allow_unicode=True))
        then = pasteable("audit", "declare", bag, template)
        console.note(f"{template}: fill it in, then {then}")
        return
    if file is None:
        return
    folder = bag_folder(path)
    if not folder.is_dir():
        raise InputError("is no bag folder", file=path, remedy="name the folder of the bag")
    declaration = load_declaration(file, run)
    for who in part.lost:
        if who in declaration.participants:
            raise InputError(
                "declared itself when this was recorded, and that was taken out of this bag",
                file=path,
                field=absolute(declared_topic(who)),
                remedy="take the bag as it was recorded, or cut it with this topic",
            )
    declaration_path = seal_declaration(declaration, folder)
    console.out.print(f"{declaration_path}: declared by {declaration.text}", markup=False)
    with BagReader(path) as reader:
        after = read_provenance(reader).participation
    if after is not None:
        console.note(f"the session is {after.standing.value}: {after.text}")
