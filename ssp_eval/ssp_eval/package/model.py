"""``ssp.package/1``: the table of contents of an evidence package (METHOD 4).

A package is a folder of ``package.json`` and ``objects/<sha256>``. A file is known by its path,
which says where it lay, and by its hash, which says where it lies now. The table is written in
one form only, and its ``id`` is the hash of everything else in it, so that a changed table shows
as surely as a changed file.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.folders import check_folder
from ssp_core.files.reading import parse_model
from ssp_core.hashing import sha256_json
from ssp_core.run_file.values import Strict

SCHEMA: Literal["ssp.package/1"] = "ssp.package/1"
TABLE_FILE = "package.json"
OBJECTS = "objects"
MAX_TABLE_BYTES = 256 << 20

Hash = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]


def _inside(path: str) -> str:
    if any(part in ("", ".", "..") or "\0" in part for part in path.split("/")):
        raise ValueError("must be a relative path with no way out of its folder")
    return path


LogicalPath = Annotated[str, AfterValidator(_inside)]

Role = Literal[
    "event",  # K*
    "site",
    "map",
    "shortlist",  # which events went on to the track
    "task",  # a sealed compiled event
    "run",  # what was to be executed
    "log",  # a part of log L
    "log_merged",  # all of log L, in order, each entry with its origins
    "video",  # a source clip
    "truth",  # what the maker of a clip says of it
    "recording",  # an MCAP file
    "bag_metadata",
    "verdict",
    "declaration",  # a person's word on what took part
    "result",
    "labels",
    "proposal",
    "observation",  # what a person saw in a recording
    "audit",
    "cell",
    "raw",  # answers as they came
    "requests",  # what was asked, frames by hash
    "records",
    "score",
    "frame",
    "page",  # for people
    "other",
]

Kind = Literal[
    "event_version",  # to the K* of that content hash
    "site_version",  # to the site of that content hash
    "task_version",  # to the task of that seal
    "attachment",  # of a bag, to the file with the same bytes
    "bag",  # to the recording
    "source_video",
    "truth",
    "labels",
    "raw",
    "requests",
    "records",
    "score",
    "frame",
    "audit",
    "map",
    "log",  # of a bag, to the log that begins with these bytes
    "observation",  # of an audit, to what a person saw in the recording
    "verdict",  # of an audit, to the runner's word that it read
    "declaration",  # of an audit, to a person's word that it read
    "shortlist",  # of a task's log, to the list that the event was a candidate of
]


class FileEntry(Strict):
    """One file of the package."""

    path: LogicalPath
    role: Role
    sha256: Hash
    bytes: Annotated[int, Field(ge=0)]


class Link(Strict):
    """``source`` names ``target`` by a content hash, which stands in its field ``at``."""

    kind: Kind
    source: LogicalPath
    at: str
    target: LogicalPath
    hash: Hash = Field(description="of the target's bytes, or of its content for a version")


class LineRef(Strict):
    """A line of a JSON Lines file, from 1, and the hash of its bytes without line end."""

    line: Annotated[int, Field(ge=1)]
    sha256: Hash


class SentFrame(Strict):
    """A frame that was sent: its stamp, and the hash of its bytes in the recording."""

    stamp_ns: int
    sha256: Hash


class Chain(Strict):
    """One score of one cell: label → record with its evidence → request → raw answer → frames.

    A label without an answer has neither record nor raw answer, and says why.
    """

    cell: LogicalPath = Field(description="its cell.json")
    label: Annotated[int, Field(ge=0)]
    t_s: float
    record: LineRef | None
    request: LineRef | None
    raw: LineRef | None
    frames: list[SentFrame]
    missing: str = ""


class Package(Strict):
    """The table of contents."""

    schema_: Literal["ssp.package/1"] = Field(SCHEMA, alias="schema")
    id: str = Field("", description="hash of everything else here")
    software: str
    files: Annotated[list[FileEntry], Field(min_length=1)]
    links: list[Link]
    chains: list[Chain]
    missing: list[str] = Field(description="what a whole package of METHOD 4 would also hold")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


@dataclass(frozen=True)
class Progress:
    """Receives how far the making or verifying of a package has come.

    Args:
        total: once, how many bytes there are.
        bytes: how many more of them were read.
        step: what is done afterwards, where it takes some seconds.
    """

    total: Callable[[int], None] = lambda _: None
    bytes: Callable[[int], None] = lambda _: None
    step: Callable[[str], None] = lambda _: None


UNSEEN = Progress()


def content_id(package: Package) -> str:
    """Hash of everything but the id itself."""
    value: dict[str, Any] = package.model_dump(mode="json", by_alias=True)
    value.pop("id")
    return sha256_json(value)


def sealed(package: Package) -> Package:
    """Return the table with its id in it."""
    return package.model_copy(update={"id": content_id(package)})


def table_bytes(package: Package) -> bytes:
    """Return the one form in which a table is written."""
    value = package.model_dump(mode="json", by_alias=True)
    return (json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()


def load_table(folder: Path) -> Package:
    """Return the table of a package, with its id and its form checked.

    Raises:
        InputError: it isn't there, is no table, or was changed after it was made.
    """
    path, remedy = folder / TABLE_FILE, "name a folder of `ssp package make`"
    check_folder(folder, remedy)
    if path.is_symlink() or not path.is_file():
        raise InputError(f"holds no {TABLE_FILE}", file=folder, remedy=remedy)
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_TABLE_BYTES + 1)
    except OSError as error:
        raise InputError(
            f"can't be read: {error.strerror}", file=path, remedy="get the package anew"
        ) from error
    if len(data) > MAX_TABLE_BYTES:
        raise InputError(
            f"is larger than {MAX_TABLE_BYTES >> 20} MiB", file=path, remedy="get the package anew"
        )
    try:
        value = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"was changed: it is no JSON: {error}", file=path, remedy="get the package anew"
        ) from error
    package = parse_model(Package, value, path)
    actual_id = content_id(package)
    if actual_id != package.id or table_bytes(package) != data:
        raise InputError(
            "was changed after the package was made",
            file=path,
            field="id",
            value=package.id,
            remedy=f"its content has {actual_id}; get the package anew",
        )
    _check_paths(package, path)
    return package


def _check_paths(package: Package, file: Path) -> None:
    """Refuse links and chains between files that the table doesn't list."""
    paths = {entry.path for entry in package.files}
    fields_by_path = {
        **{link.source: "links" for link in package.links},
        **{link.target: "links" for link in package.links},
        **{chain.cell: "chains" for chain in package.chains},
    }
    for path, field in fields_by_path.items():
        if path not in paths:
            raise InputError(
                "names a file that is not listed",
                file=file,
                field=field,
                value=path,
                remedy="get the package anew",
            )


def object_path(folder: Path, sha256: str) -> Path:
    """Return the path of a file's bytes."""
    return folder / OBJECTS / sha256.removeprefix("sha256:")
