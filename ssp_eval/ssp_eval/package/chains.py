"""From each score of a cell to its record, its question, its raw answer and the frames sent."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_bytes
from ssp_eval.evaluate.cell_file import LABELS_FILE, RECORDS_FILE, SCORE_FILE
from ssp_eval.evaluate.interpret import record_of
from ssp_eval.evaluate.store import RAW_FILE, REQUESTS_FILE, asked_again
from ssp_eval.extract import extractor_hash
from ssp_eval.labels.model import Labels, parse_labels
from ssp_eval.package.index import Index, Problem
from ssp_eval.package.model import Chain, FileEntry, LineRef, Link, SentFrame
from ssp_eval.records import BehaviourRecord, parse_records, record_to_json
from ssp_eval.score import DEFAULT, score_cell
from ssp_eval.score.thresholds_file import thresholds_of
from ssp_vla_bridge.messages import Response, response_from_json

Lines = list[tuple[LineRef, dict[str, Any]]]


class Chains:
    """Works out the chains of scored cells, scoring anew what can be.

    Args:
        index: of the package.
    """

    def __init__(self, index: Index) -> None:
        self._index = index
        self._contents = index.contents
        self.found: list[Chain] = []
        self.links: list[Link] = []
        self.problems: list[Problem] = []
        self.notes: list[str] = []

    def add(self, cell: str, facts: Mapping[str, Any]) -> None:
        """The chains of one cell; a refused or failed one has none.

        Args:
            cell: path of its cell.json.
            facts: what stands there.
        """
        if facts.get("status") != "ok":
            return
        try:
            self._add(cell, facts)
        except InputError as error:
            place = error.file or cell
            self.problems.append(Problem(place, _where(error), error.problem))

    def _add(self, cell: str, facts: Mapping[str, Any]) -> None:
        labels_file = self._file(cell, LABELS_FILE)
        labels = parse_labels(self._contents.mapping(labels_file), labels_file.path)
        records_file = self._file(cell, RECORDS_FILE)
        text = self._contents.text(records_file)
        records = parse_records(text, records_file.path)
        record_lines = _numbered(text)
        requests_file, raw_file = self._file(cell, REQUESTS_FILE), self._file(cell, RAW_FILE)
        requests = self._lines(requests_file)
        raw = {str(value.get("request_id")): (ref, value) for ref, value in self._lines(raw_file)}
        self._check_asked(raw_file, raw, requests)
        if len(requests) != len(labels.labels):
            text = f"holds {len(requests)} lines for {len(labels.labels)} labels"
            raise InputError(text, file=requests_file.path)
        matches = self._score(cell, facts, labels, records)
        at_time = {request.get("t_s"): (ref, request) for ref, request in requests}
        sent = self._frames(requests_file, requests, facts)
        for number, label in enumerate(labels.labels):
            match = matches[number]
            ref, request = requests[number]
            if request.get("label_t_s") != label.t_s:
                text = f"is {request.get('label_t_s')}, and the label is at {label.t_s} s"
                self._problem(requests_file, f"{ref.line}:label_t_s", text)
            record_ref = None
            if match is not None:
                line, content = record_lines[match]
                record_ref = LineRef(line=line, sha256=sha256_bytes(content.encode()))
                ref, request = at_time.get(records[match].t_s, (ref, request))
            answer = raw.get(str(request.get("request_id")))
            if match is not None and record_ref is not None:
                self._made_from(
                    facts, records_file, record_ref, records[match], answer, request, raw
                )
            missing = str(request.get("missing", ""))
            self.found.append(
                Chain(
                    cell=cell,
                    label=number,
                    t_s=label.t_s,
                    record=record_ref,
                    request=ref,
                    raw=None if answer is None else answer[0],
                    frames=sent[ref.line],
                    missing="" if record_ref is not None else missing or "no record is near enough",
                )
            )

    def _file(self, cell: str, name: str) -> FileEntry:
        entry = self._contents.beside(cell, name)
        if entry is None:
            raise InputError(f"has no {name} beside it", file=cell)
        return entry

    def _problem(self, entry: FileEntry, field: str, text: str) -> None:
        self.problems.append(Problem(entry.path, field, text))

    def _lines(self, entry: FileEntry) -> Lines:
        found = []
        for number, line in _numbered(self._contents.text(entry)):
            try:
                value = json.loads(line)
            except (ValueError, RecursionError) as error:
                raise InputError(f"is no JSON: {error}", file=entry.path, line=number) from error
            if not isinstance(value, dict):
                raise InputError("must be a JSON object", file=entry.path, line=number)
            found.append((LineRef(line=number, sha256=sha256_bytes(line.encode())), value))
        return found

    def _check_asked(
        self, raw_file: FileEntry, raw: Mapping[str, tuple[LineRef, Any]], requests: Lines
    ) -> None:
        asked = {str(request.get("request_id")) for _, request in requests}
        for name, (ref, _) in raw.items():
            if name not in asked:
                self._problem(raw_file, f"{ref.line}:request_id", f"{name} was never asked")

    def _score(
        self,
        cell: str,
        facts: Mapping[str, Any],
        labels: Labels,
        records: tuple[BehaviourRecord, ...],
    ) -> list[int | None]:
        """Index of each label's record; the stored score is compared with what these give."""
        stored = self._file(cell, SCORE_FILE)
        given = facts.get("thresholds")
        thresholds = DEFAULT if given is None else thresholds_of(given, cell)
        score = score_cell(labels, records, thresholds)
        if facts["hashes"].get("thresholds") != thresholds.sha256:
            self.notes.append(f"{stored.path}: made with other thresholds, not scored again")
        elif self._contents.mapping(stored) != score.to_json():
            self._problem(stored, "", "is not what its records and labels give")
        return [judgement.record for judgement in score.details.judgements]

    def _made_from(
        self,
        facts: Mapping[str, Any],
        records_file: FileEntry,
        place: LineRef,
        record: BehaviourRecord,
        answer: tuple[LineRef, dict[str, Any]] | None,
        request: Mapping[str, Any],
        raw: Mapping[str, tuple[LineRef, dict[str, Any]]],
    ) -> None:
        """Compares a record with what its raw answer gives."""
        if answer is None:
            self._problem(records_file, f"{place.line}", "has no raw answer")
            return
        raw_path = str(PurePosixPath(records_file.path).with_name(RAW_FILE))
        response = _response(answer, raw_path)
        if facts["hashes"].get("extractor") != extractor_hash():
            note = f"{records_file.path}: made by another extractor, not extracted again"
            if note not in self.notes:
                self.notes.append(note)
            return
        before = raw.get(str((request.get("previous") or {}).get("request_id")))
        asked = asked_again(request, None if before is None else _response(before, raw_path))
        again = record_of(
            record.t_s,
            response,
            str(facts.get("adapter")),
            asked,
            str(request.get("no_previous", "")),
        )
        if record_to_json(again) != record_to_json(record):
            self._problem(records_file, f"{place.line}", "is not what its raw answer gives")

    def _frames(
        self, entry: FileEntry, requests: Lines, facts: Mapping[str, Any]
    ) -> dict[int, list[SentFrame]]:
        """The frames of each request, by its line, each found in the recording."""
        recording = self._index.recordings.get(str(facts["hashes"].get("bag")))
        if facts.get("condition"):
            # Blackened frames are in no recording, and shuffled ones stand at other stamps.
            self.notes.append(f"{entry.path}: a control, its frames are {facts['condition']}")
            recording = None
        found: dict[int, list[SentFrame]] = {}
        for ref, request in requests:
            frames = found[ref.line] = []
            for number, frame in enumerate(_frames_of(request, entry, ref)):
                frames.append(frame)
                at = f"{ref.line}:frames[{number}].sha256"
                if recording is not None and recording.frames.get(frame.stamp_ns) != frame.sha256:
                    text = f"is {frame.sha256}, and {recording.entry.path} has another frame there"
                    self._problem(entry, at, text)
                kept = self._contents.with_hash(frame.sha256, entry.path, "frame")
                if kept is not None:
                    self.links.append(
                        Link(
                            kind="frame",
                            source=entry.path,
                            at=at,
                            target=kept.path,
                            hash=frame.sha256,
                        )
                    )
        return found


def _response(answer: tuple[LineRef, dict[str, Any]], path: str) -> Response:
    return response_from_json(answer[1], file=path, line=answer[0].line)


def _numbered(text: str) -> list[tuple[int, str]]:
    return [(n, line) for n, line in enumerate(text.split("\n"), start=1) if line.strip()]


def _frames_of(request: Mapping[str, Any], entry: FileEntry, ref: LineRef) -> list[SentFrame]:
    frames = request.get("frames", [])
    try:
        return [SentFrame(stamp_ns=f["stamp_ns"], sha256=f["sha256"]) for f in frames]
    except (TypeError, KeyError, ValueError) as error:
        raise InputError(
            "must list stamps and hashes", file=entry.path, line=ref.line, field="frames"
        ) from error


def _where(error: InputError) -> str:
    return ":".join(str(part) for part in (error.line, error.field) if part)
