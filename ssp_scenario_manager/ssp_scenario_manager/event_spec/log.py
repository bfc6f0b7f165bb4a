"""The log L: who changed or decided what, when and why; JSON Lines that are only appended to."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.reading import check_characters, parse_model, read_text
from ssp_core.files.strict_json import parse_strict
from ssp_core.run_file.values import Strict

LOG_FILE = "log.jsonl"

EntryKind = Literal[
    "source",  # hash, generator, original version and crop of the source clip
    "gate",  # a source clip that was refused, with one of the gate's reasons
    "extraction",  # a candidate was made: model, prompts, answers
    "edit",  # a field of the event was changed
    "accept",  # a field was accepted as it is
    "choice",  # a person chose between tied blocks
    "tuning",  # the compiler chose or changed a value within part C
    "shortlist",  # the event was a candidate for the track, in a list of the two virtual stages
    "validation",  # a simulation run validated the anchors
    "site_change",  # something was changed on site
    "disclosure",  # a difference between domains that is allowed and must be known
    "observation",  # a person looked at a recording, and what he saw was sealed
    "label_review",  # a person confirmed or edited proposed labels
]


def _utc(text: str) -> str:
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        when = None
    if when is None or when.utcoffset() != timedelta(0):
        raise ValueError("must be a time in ISO 8601 and UTC, such as 2025-03-01T09:30:00Z")
    return text


Text = Annotated[str, Field(min_length=1)]


class Record(Strict):
    """One entry of L.

    ``field``, ``old`` and ``new`` are null where nothing was changed. ``when`` is ISO 8601 UTC.
    """

    schema_: Literal["ssp.log/1"] = Field("ssp.log/1", alias="schema")
    kind: EntryKind
    when: Annotated[str, AfterValidator(_utc)]
    who: Text
    subject: Text = Field(description="what it is about: event, task, site or recording, by name")
    version: str | None = Field(None, description="content hash of the subject before the entry")
    field: str | None = None
    old: Any = None
    new: Any = None
    reason: Text
    details: dict[str, Any] = Field(default_factory=dict)

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


# Two machines' clocks may differ by as much when an entry's time is typed from the other's.
_AHEAD_S = 60
# Kinds of files that a log stands beside: NAME.event.yaml and so on.
_KINDS = (".event", ".candidate", ".labels", ".site")


def log_path(subject: str | Path) -> Path:
    """Return the default path of the log of a K*, a candidate or a labels file."""
    path = Path(subject)
    stem = path.stem
    for kind in _KINDS:
        stem = stem.removesuffix(kind)
    if stem == "event":  # the copy of K* in a compiled folder
        return path.with_name(LOG_FILE)
    return path.with_name(f"{stem}.log.jsonl")


def utc_now() -> str:
    """Return the wall clock as records write it; command lines hand it to the cores."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def check_not_ahead(when: str, now: str) -> str:
    """Check that a time that was typed for an entry lies at most a minute ahead.

    Args:
        when: ISO 8601, UTC.
        now: likewise, the wall clock.

    Returns:
        ``when``. What is no time is left to the model of entries to refuse.

    Raises:
        InputError: it lies in the future.
    """
    try:
        ahead = datetime.fromisoformat(when) - datetime.fromisoformat(now)
    except (ValueError, TypeError):  # no time, or one without a zone
        return when
    if ahead > timedelta(seconds=_AHEAD_S):
        raise InputError(
            "lies in the future", field="when", value=when, remedy=f"by this clock it is {now}"
        )
    return when


def record_line(record: Record) -> str:
    """Write one line of L, without its newline: keys in the model's order.

    Raises:
        ValueError: a value holds a NaN or an infinity, which pydantic's JSON mode would turn into
            null.
    """
    value = record.model_dump(by_alias=True)
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def append_record(path: str | Path, record: Record) -> None:
    """Append one record; it is on the disk when this returns.

    Raises:
        InputError: the file can't be written, or its last line is not whole (a machine that died
            while it was written to), so that a further record would be lost with it.
    """
    append_records(path, [record])


def append_records(path: str | Path, records: Iterable[Record]) -> None:
    """Append several records that belong together, as append_record does one."""
    path = Path(path)
    data = "".join(record_line(record) + "\n" for record in records).encode()
    make_folder(path.parent)
    try:
        with open(path, "a+b") as stream:
            fcntl.flock(stream, fcntl.LOCK_EX)
            end = stream.seek(0, os.SEEK_END)
            if end:
                stream.seek(end - 1)
                if stream.read(1) != b"\n":
                    raise InputError(
                        "ends in the middle of a record",
                        file=path,
                        remedy="complete or remove its last line by hand",
                    )
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
    except OSError as error:
        raise InputError(
            f"can't be written: {error.strerror}", file=path, remedy="get permission, or make room"
        ) from error


def read_log(path: str | Path) -> list[Record]:
    """Read all records of a log, in the order in which they were appended; empty if it is missing.

    Raises:
        InputError: the file can't be read, or a line is no record; with the line's number.
    """
    if not os.path.lexists(path):
        return []
    return parse_log(read_text(path), path)


def parse_log(text: str, file: str | Path) -> list[Record]:
    """Read the records of a log's text, as read_log does; for one that lies in a bag.

    Raises:
        InputError: a line is no record; with the line's number.
    """
    records = []
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            value = parse_strict(line)
            check_characters(value, line)
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"is no JSON: {error}",
                file=file,
                line=number,
                remedy="put the log back as it was written",
            ) from error
        try:
            records.append(parse_model(Record, value, file))
        except InputError as error:
            raise error.in_line(number) from error
    return records


def refusal(records: Iterable[Record], name: str) -> Record | None:
    """Return the gate's refusal of the clip that an event was taken from, None where it stands.

    A refusal is about the clip, so it holds for every version of the event, until a later
    ``source`` record says that the event is taken from another clip or crop.
    """
    refused: Record | None = None
    clip: object = None
    for record in records:
        if record.subject != name:
            continue
        if record.kind == "source":
            now = (record.details.get("sha256"), record.details.get("crop"))
            if now != clip:
                refused = None
            clip = now
        elif record.kind == "gate":
            refused = record
    return refused


def check_not_refused(event_path: str | Path, name: str, log: str | Path | None = None) -> None:
    """Refuse, with an InputError, an event whose source clip the gate refused.

    Args:
        event_path: file of the event.
        name: of the event.
        log: the event's log; None: the one beside it.
    """
    record = refusal(read_log(log_path(event_path) if log is None else log), name)
    if record is not None:
        raise InputError(
            f"its source clip was refused by {record.who} on {record.when}: {record.reason}",
            file=event_path,
            remedy="extract the event from another clip (METHOD 1, source gate)",
        )
