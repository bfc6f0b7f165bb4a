"""A named person's word on what the participants of a live session were (METHOD 4.4b).

The file (``ssp.declaration/1``) is written by hand; sealed, it is bound to a bag by the bag's
content hash and lies in the bag's folder as ``declaration.json``.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.bag.seals.seal import REPORT_NAME
from ssp_core.bag.seals.verdict import result_beside
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.files.reading import load_model, parse_mapping
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_json
from ssp_core.names import absolute, declared_topic
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import ParticipantKind, Participation, declaring, stands_in
from ssp_core.run_file.values import Strict
from ssp_core.run_file.verdict import RESULT_FILE

DECLARATION_FILE = "declaration.json"
SCHEMA: Literal["ssp.declaration/1"] = "ssp.declaration/1"
# Log times above this, in 2001, are of a clock that somebody has set.
_SYSTEM_CLOCK_NS = 10**18
Words = Annotated[str, Field(min_length=1, max_length=200, pattern=r"\S")]


class DeclaredParticipant(Strict):
    """The declared kind of one participant."""

    kind: ParticipantKind
    device: Words = Field(description="make and model")
    serial: Words = Field(description="serial number, number plate or the like")


class Declaration(Strict):
    """A person's declaration of what a session's participants were, and when and where that was."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.declaration/1"] = Field(SCHEMA, alias="schema")
    who: Words
    date: date
    place: Words
    participants: Annotated[dict[str, DeclaredParticipant], Field(min_length=1)]
    bag_sha256: str | None = Field(None, description="of the bag; null: not sealed")
    seal: str | None = Field(None, description="hash of all the rest; null: not sealed")

    @property
    def content_sha256(self) -> str:
        """Compute the seal that the declaration must have."""
        value = self.model_dump(mode="json", by_alias=True)
        del value["seal"]
        return sha256_json(value)

    @property
    def kinds(self) -> dict[str, str]:
        """Kinds by participant."""
        return {who: one.kind.value for who, one in self.participants.items()}

    @property
    def text(self) -> str:
        """Person, date and place, for people."""
        return f"{self.who}, {self.date.isoformat()}, {self.place}"


def load_declaration(file: Path, run: RunSpec) -> Declaration:
    """Read a declaration that was written by hand.

    Raises:
        InputError: it can't be read, is sealed already, or doesn't fit the run.
    """
    declaration = load_model(Declaration, file)
    if declaration.seal is not None:
        raise InputError(
            "is sealed already",
            file=file,
            field="seal",
            value=declaration.seal,
            remedy="give the file that was written by hand",
        )
    if run.mode != "live":
        raise InputError(
            "is of a session with a simulated world, which no declaration makes a live one",
            file=file,
            field="participants",
            value=run.mode,
            remedy="leave --declared out",
        )
    participants = declaring(run)
    for who in declaration.participants:
        if who not in participants:
            raise InputError(
                "takes no part in this session",
                file=file,
                field=f"participants.{who}",
                remedy=f"its participants are {', '.join(participants)}",
            )
    return declaration


def day_of(bag: BagReader) -> date | None:
    """Return the day on which a bag was recorded, UTC; None where its clock wasn't set."""
    if bag.start_ns is None or bag.start_ns < _SYSTEM_CLOCK_NS:
        return None
    return datetime.fromtimestamp(bag.start_ns / NS_PER_S, UTC).date()


def _check_day(declaration: Declaration, bag: BagReader, folder: Path) -> None:
    """Refuse another day than that of the recording, wherever on earth it was made."""
    recorded = day_of(bag)
    if recorded is not None and abs(declaration.date - recorded) > timedelta(days=1):
        raise InputError(
            f"isn't the day of the session: the bag was recorded on {recorded}",
            file=folder,
            field="date",
            value=str(declaration.date),
            remedy="write the day on which the session was, in local time or UTC",
        )


def seal_declaration(declaration: Declaration, folder: Path) -> Path:
    """Bind a declaration to the bag in a folder, and write it there.

    Raises:
        InputError: the folder holds no bag, or a declaration already; or the bag was recorded on
            another day.
    """
    file = folder / DECLARATION_FILE
    if file.exists():
        raise InputError("exists already", file=file, remedy="remove it first")
    with BagReader(folder) as bag:
        _check_day(declaration, bag, folder)
        bound = declaration.model_copy(update={"bag_sha256": content_sha256(bag)})
    sealed = bound.model_copy(update={"seal": bound.content_sha256})
    write_json(file, sealed.model_dump(mode="json", by_alias=True))
    return file


def read_declaration(folder: Path, bag_sha256: str) -> Declaration | None:
    """Read the sealed declaration in a bag's folder; None where there is none.

    Args:
        folder: of the bag.
        bag_sha256: content hash of the bag; empty: it isn't known yet.

    Raises:
        InputError: it was changed after it was sealed, or is of another bag.
    """
    file = folder / DECLARATION_FILE
    if not file.is_file():
        return None
    declaration = load_model(Declaration, file)
    if declaration.seal != declaration.content_sha256:
        raise InputError(
            f"was changed after {declaration.who} sealed it",
            file=file,
            field="seal",
            value=declaration.seal,
            remedy="remove it, and declare anew with `ssp audit declare`",
        )
    if bag_sha256 and declaration.bag_sha256 != bag_sha256:
        raise InputError(
            f"is of another bag, or of an earlier state of this one, which has the hash "
            f"{bag_sha256}",
            file=file,
            field="bag_sha256",
            value=declaration.bag_sha256,
            remedy="remove it, and declare anew with `ssp audit declare`",
        )
    return declaration


def participation_of(
    bag: BagReader, run: RunSpec, folder: Path, bag_sha256: str | None = None
) -> Participation:
    """Read what the participants of a session declared, and a named person's word.

    Args:
        bag: recording of the session.
        run: of the session; only a live one's participants declare themselves.
        folder: of the bag.
        bag_sha256: see read_declaration; None: a person's word isn't looked for.

    Raises:
        InputError: that word was changed, or is of another bag.
    """
    if run.mode != "live":
        return Participation(run.mode, {})
    declared = {who: list[str]() for who in declaring(run)}
    topics = {absolute(declared_topic(who)): who for who in declared}
    for message in bag.messages([topic for topic in topics if topic in bag.topics]):
        declared[topics[message.topic]].append(str(bag.decode(message).data))
    bag_topics = written_topics(bag)
    lost = [who for topic, who in topics.items() if topic in bag_topics and not declared[who]]
    word = None
    if bag_sha256 is not None and folder.is_dir():
        word = read_declaration(folder, bag_sha256)
    return Participation(
        run.mode,
        {who: tuple(dict.fromkeys(kinds)) for who, kinds in declared.items()},
        {} if word is None else word.kinds,
        "" if word is None else word.text,
        tuple(lost),
    )


def written_topics(bag: BagReader) -> frozenset[str]:
    """Return topics of which the recorder wrote messages, by its report; empty without one.

    Raises:
        InputError: the report can't be read.
    """
    data = bag.attachment(REPORT_NAME)
    if data is None:
        return frozenset()
    rows = parse_mapping(data, f"{bag.path}:{REPORT_NAME}").get("topics")
    rows = [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []
    return frozenset(str(row.get("name")) for row in rows if row.get("written"))


def check_result(run: RunSpec, part: Participation, folder: Path) -> None:
    """Hold what the run's result says of a stand-in against the bag.

    A person's word may have been given after it was written. Results that name no participants are
    older.

    Raises:
        InputError: it says something else.
    """
    run_result = result_beside(folder)
    if run_result.get("participants") is None:
        return
    by_itself = replace(part, word={}, said_by="")
    allowed = [stands_in(run, one) for one in (part, by_itself)]
    if run_result.get("stand_in") not in allowed:
        raise InputError(
            f"says another thing than its bag: {part.text}",
            file=folder.parent / RESULT_FILE,
            field="stand_in",
            value=run_result.get("stand_in"),
            remedy="restore bag and result as the run left them",
        )
