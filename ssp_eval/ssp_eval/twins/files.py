"""A twin's description of itself (``twin.json``), and a recording's twins (``twin_set.json``)."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.files.writing import write_json
from ssp_core.run_file.values import Finite, Strict
from ssp_core.vocabulary import ObjectWord
from ssp_eval.data.provenance import TWIN_ATTACHMENT, bag_folder

TWIN_SCHEMA: Literal["ssp.twin/1"] = "ssp.twin/1"
SET_SCHEMA: Literal["ssp.twin_set/1"] = "ssp.twin_set/1"
FOLDER, SET_FILE, TWIN_FILE = "twins", "twin_set.json", TWIN_ATTACHMENT

Digest = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0)]


class TwinIdentity(Strict):
    """The identity of a twin, as an attachment of its bag."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.twin/1"] = Field(TWIN_SCHEMA, alias="schema")
    name: str = Field(description="of the change; folder and condition have it")
    kind: str
    object_id: str = Field(description="the object that is changed; empty: none")
    object_class: ObjectWord | None = None
    value: Finite = Field(description="s of shift and camera, share of history; else 0")
    words: str = Field(description="the change, for people")
    of: str = Field(description="name of the factual recording")
    of_sha256: Digest = Field(description="hash of its bag")
    seed: int
    software: str


class TwinAudit(Strict):
    """The differences of a twin from the factual recording, found by comparing both.

    Pixels are those of the pictures before JPEG.
    """

    holds: bool
    reasons: list[str] = Field(description="why it doesn't hold; empty where it does")
    frames: Count
    frames_redrawn_alike: Count = Field(
        description="factual frames that give the recorded bytes when they are drawn again"
    )
    frames_changed: Count
    changed_px: Count = Field(description="sum over all frames")
    most_changed_px: Count = Field(description="in one frame")
    outside_px: Count | None = Field(
        description="of these, outside the object's image and shadow; null: no such bound"
    )
    outside_judged: bool = Field(
        description="false: lamps at dusk, wet ground or motion blur reach further, or no object"
    )
    messages_alike: Count = Field(description="messages with the same bytes and times")
    messages_changed: dict[str, Count] = Field(description="by topic")
    messages_missing: dict[str, Count] = Field(description="by topic; those that the twin lacks")


class TwinRecord(Strict):
    """``twin.json`` beside the twin's bag."""

    identity: TwinIdentity
    audit: TwinAudit
    bag_sha256: Digest


class TwinSet(Strict):
    """``twin_set.json``: all twins of a recording."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    schema_: Literal["ssp.twin_set/1"] = Field(SET_SCHEMA, alias="schema")
    of: str
    of_sha256: Digest
    twins: list[TwinRecord]


def twins_folder(bag: Path) -> Path:
    """Return the folder of a recording's twins: ``twins/`` beside its bag.

    Args:
        bag: its folder, or an MCAP file in it.
    """
    return bag_folder(bag).parent / FOLDER


def read_set(bag: Path) -> TwinSet | None:
    """Return the twins beside a recording; None: there are none.

    Raises:
        InputError: the file is damaged.
    """
    file = twins_folder(bag) / SET_FILE
    return load_model(TwinSet, file) if file.is_file() else None


def finished_twin(bag: Path, name: str, of_sha256: str) -> TwinRecord | None:
    """Return a recording's twin; None: it isn't there, isn't whole, or is of another recording.

    Args:
        bag: folder of the recording's bag.
        name: of the twin.
        of_sha256: hash of the recording.
    """
    record = _read_twin_record(bag, name, of_sha256)
    if record is None:
        return None
    try:
        with BagReader(bag_of(bag, name)) as twin:
            return record if content_sha256(twin) == record.bag_sha256 else None
    except InputError:
        return None


def _read_twin_record(bag: Path, name: str, of_sha256: str) -> TwinRecord | None:
    """Read ``twin.json`` of a recording's twin, whatever its bag holds by now."""
    try:
        record = load_model(TwinRecord, twins_folder(bag) / name / TWIN_FILE)
    except InputError:
        return None
    return record if record.identity.of_sha256 == of_sha256 else None


def write_set(bag: Path, of: str, of_sha256: str) -> TwinSet:
    """List the twins that lie beside a recording, by their names, in its twin_set.json.

    Args:
        bag: folder of the recording's bag.
        of: name of the recording.
        of_sha256: its hash.
    """
    folder = twins_folder(bag)
    names = sorted(file.parent.name for file in folder.glob(f"*/{TWIN_FILE}"))
    records = [_read_twin_record(bag, name, of_sha256) for name in names]
    twin_set = TwinSet(
        of=of, of_sha256=of_sha256, twins=[record for record in records if record is not None]
    )
    write_json(folder / SET_FILE, twin_set.model_dump(mode="json", by_alias=True))
    return twin_set


def remove_twin(bag: Path, name: str) -> None:
    """Remove a recording's twin, if there is one."""
    folder = twins_folder(bag) / name
    if folder.is_dir():
        shutil.rmtree(folder)


def usable_twins(bag: Path, bag_sha256: str) -> Iterator[TwinRecord]:
    """Yield the twins that a recording may be asked about.

    Args:
        bag: folder of the recording's bag.
        bag_sha256: hash of the recording.

    Raises:
        InputError: they were made of another recording.
    """
    twin_set = read_set(bag)
    if twin_set is None:
        return
    if twin_set.of_sha256 != bag_sha256:
        raise InputError(
            "is of another recording",
            file=twins_folder(bag) / SET_FILE,
            field="of_sha256",
            value=twin_set.of_sha256,
            remedy=f"make the twins of {bag} anew with `ssp twins`",
        )
    yield from (twin for twin in twin_set.twins if twin.audit.holds)


def bag_of(bag: Path, name: str) -> Path:
    """Return the bag of a recording's twin."""
    return twins_folder(bag) / name / "bag"
