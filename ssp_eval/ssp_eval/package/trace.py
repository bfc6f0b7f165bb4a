"""Walking back from one score to K*, with the hash of every step (METHOD 4)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_bytes, sha256_file
from ssp_eval.data.provenance import read_provenance
from ssp_eval.data.records import SLOT_NAMES, BehaviourRecord, parse_records
from ssp_eval.package.contents import Contents
from ssp_eval.package.model import Chain, FileEntry, LineRef, Package
from ssp_vla_bridge.messages import response_from_json

_TEXT = 100


@dataclass(frozen=True, slots=True)
class Step:
    """One link of the walk.

    Args:
        what: score, evidence, raw output and so on.
        path: of the file, with the line where only a line is meant.
        sha256: of the file or the line; of the content where it is a version.
        says: what is to be known of it, one short line each.
    """

    what: str
    path: str
    sha256: str
    says: tuple[str, ...] = field(default=())


def find_cell(package: Package, name: str) -> FileEntry:
    """Return the cell of a folder name, such as ``cut_in__simulation__my_model``, or of its path.

    Raises:
        InputError: there is none, or several.
    """
    cells = [entry for entry in package.files if entry.role == "cell"]
    matches = [
        entry
        for entry in cells
        if name in (entry.path, *map(str, PurePosixPath(entry.path).parents))
        or PurePosixPath(entry.path).parent.name == name
    ]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise InputError(
            f"names {len(matches)} cells",
            value=name,
            remedy=f"give the path: {', '.join(entry.path for entry in matches)}",
        )
    cell_names = ", ".join(PurePosixPath(entry.path).parent.name for entry in cells) or "none"
    raise InputError("is no cell of the package", value=name, remedy=f"its cells are {cell_names}")


class Walker:
    """Reads only what the walk passes, and checks the bytes of it."""

    def __init__(self, contents: Contents, package: Package) -> None:
        self._contents = contents
        self._package = package
        self._checked: set[str] = set()

    def walk(self, cell: FileEntry, label: int) -> list[Step]:
        """Walk from a score of a cell back to K*.

        Raises:
            InputError: the cell has no such score, or a file on the way was changed.
        """
        chains = {c.label: c for c in self._package.chains if c.cell == cell.path}
        if label not in chains:
            facts = self._contents.mapping(self._sound(cell))
            raise InputError(
                f"has no score for label {label}",
                file=cell.path,
                remedy=f"it is {facts.get('status')} and has {len(chains)}",
            )
        return list(self._steps(cell, chains[label]))

    def _steps(self, cell: FileEntry, chain: Chain) -> Iterator[Step]:
        yield self._score(cell, chain)
        yield from self._evidence(cell, chain)
        raw = self._line(cell, "raw", chain.raw)
        if raw is not None:
            place, digest, value = raw
            answer = response_from_json(value, file=place)
            text = json.dumps(answer.text, ensure_ascii=False)
            yield Step("raw output", place, digest, (answer.model_id, _short(text)))
        yield from self._frames(cell, chain)
        bag = self._target(cell.path, "bag")
        yield Step("recording", bag.path, bag.sha256, self._remarks(cell, bag))
        for kind, what in (("source_video", "source video"), ("task_version", "compiled task")):
            yield from self._version(bag, kind, what)
        yield from self._version(bag, "event_version", "K*")
        for kind in ("labels", "audit"):
            entry = self._linked(cell.path, kind)
            if entry is not None:
                yield self._file(kind, entry)

    def _remarks(self, cell: FileEntry, bag: FileEntry) -> tuple[str, ...]:
        """List what must stand beside the domain of a cell's recording."""
        links = (one for one in self._package.links if one.source == cell.path)
        digest = next(one.hash for one in links if one.kind == "bag")
        with self._contents.bag(bag) as reader:
            remark = read_provenance(reader, digest).remark
        return (remark,) if remark else ()

    def _score(self, cell: FileEntry, chain: Chain) -> Step:
        entry = self._target(cell.path, "score")
        score = self._contents.mapping(entry)
        says = f"label {chain.label} at {chain.t_s:g} s; IVCS of the cell: {score.get('ivcs')}"
        return Step("score", entry.path, entry.sha256, (says,))

    def _evidence(self, cell: FileEntry, chain: Chain) -> Iterator[Step]:
        if chain.record is None:
            says = (f"no record: {chain.missing}",)
            entry = self._target(cell.path, "records")
            yield Step("evidence", entry.path, entry.sha256, says)
            return
        place, digest, value = self._line(cell, "records", chain.record) or ("", "", {})
        (record,) = parse_records(json.dumps(value), place)
        yield Step("evidence", place, digest, tuple(_spans(record)))

    def _frames(self, cell: FileEntry, chain: Chain) -> Iterator[Step]:
        request = self._line(cell, "requests", chain.request)
        if request is None:
            return
        place, digest, _ = request
        yield Step("request", place, digest, (f"{len(chain.frames)} frames",))
        bag = self._target(cell.path, "bag").path
        for frame in chain.frames:
            yield Step("frame sent", bag, frame.sha256, (f"stamp {frame.stamp_ns} ns",))

    def _version(self, source: FileEntry, kind: str, what: str) -> Iterator[Step]:
        for link in self._package.links:
            if link.source == source.path and link.kind == kind:
                entry = self._sound(self._contents.by_path[link.target])
                yield Step(what, entry.path, link.hash)

    def _file(self, what: str, entry: FileEntry) -> Step:
        return Step(what, entry.path, entry.sha256)

    def _line(
        self, cell: FileEntry, kind: str, ref: LineRef | None
    ) -> tuple[str, str, dict[str, Any]] | None:
        if ref is None:
            return None
        entry = self._target(cell.path, kind)
        place = f"{entry.path}:{ref.line}"
        lines = self._contents.text(entry).split("\n")
        line = lines[ref.line - 1] if ref.line <= len(lines) else ""
        if sha256_bytes(line.encode()) != ref.sha256:
            raise InputError(
                "is not the line that the package names", file=place, remedy="get the package anew"
            )
        return place, ref.sha256, json.loads(line)

    def _linked(self, source: str, kind: str) -> FileEntry | None:
        for link in self._package.links:
            if link.source == source and link.kind == kind:
                return self._sound(self._contents.by_path[link.target])
        return None

    def _target(self, source: str, kind: str) -> FileEntry:
        entry = self._linked(source, kind)
        if entry is None:
            raise InputError(
                f"has no link to its {kind}",
                file=source,
                remedy="make the package again, with that file",
            )
        return entry

    def _sound(self, entry: FileEntry) -> FileEntry:
        if entry.sha256 in self._checked:
            return entry
        path = self._contents.object(entry)
        try:
            sha256 = sha256_file(path)
        except OSError as error:
            raise InputError(
                f"can't be read: {error.strerror}", file=entry.path, remedy="get the package anew"
            ) from error
        if sha256 != entry.sha256:
            raise InputError(
                "was changed after the package was made",
                file=entry.path,
                value=sha256,
                remedy="`ssp package verify` names everything that was",
            )
        self._checked.add(entry.sha256)
        return entry


def _spans(record: BehaviourRecord) -> Iterator[str]:
    for name in SLOT_NAMES:
        slot = getattr(record.slots, name)
        if slot is None:
            yield f"{name}: –"
            continue
        value = slot.value if isinstance(slot.value, str) else ", ".join(slot.value) or "nobody"
        quotes = ", ".join(
            f"[{start}, {end}) {record.text[start:end]!r}" for start, end in slot.evidence
        )
        yield f"{name}: {value}, by {quotes}"
    trajectory = record.trajectory
    if trajectory is None:
        yield f"trajectory: none ({', '.join(record.invalid)})"
    else:
        yield f"trajectory: {len(trajectory.t_s)} points"


def _short(text: str) -> str:
    return text if len(text) <= _TEXT else text[: _TEXT - 1] + "…"
