"""The references by content hash, and the way from each score to its record, answer and frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import PurePosixPath
from typing import Any

from ssp_core.bag.seals.declaration import DECLARATION_FILE
from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model
from ssp_core.files.strict_json import parse_json_line
from ssp_core.hashing import sha256_bytes
from ssp_eval.data.audit import Audit, RecordingEntry
from ssp_eval.data.labels import Labels, parse_labels
from ssp_eval.data.provenance import IMPORT_ATTACHMENT, RUN_ATTACHMENT
from ssp_eval.data.records import BehaviourRecord, parse_records, record_to_json
from ssp_eval.evaluate.clients.models import BLIND, REASONING, REPEAT
from ssp_eval.evaluate.store.admission import audit_statuses
from ssp_eval.evaluate.store.answer_records import record_of
from ssp_eval.evaluate.store.cell_file import (
    CELL_SCHEMA,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    SEAL,
    sealed,
)
from ssp_eval.evaluate.store.requests import RAW_FILE, REQUESTS_FILE, rebuild_request
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.observations.files import check_seal
from ssp_eval.observations.model import Observation
from ssp_eval.package.contents import Index, Problem, Recording, nearest
from ssp_eval.package.model import Chain, FileEntry, Kind, LineRef, Link, Role, SentFrame
from ssp_eval.score.cell import score_cell
from ssp_eval.score.score_file import check_score
from ssp_eval.score.thresholds import DEFAULT, thresholds_of
from ssp_scenario_manager.compile.task import EVENT_FILE, SITE_FILE, TASK_FILE, TASK_FOLDER, Task
from ssp_scenario_manager.event_spec.log import LOG_FILE, parse_log
from ssp_vla_bridge.messages import Response, response_from_json

# Files beside a cell.json, and the keys under which it names them.
_CELL_FILES: tuple[tuple[Kind, str], ...] = (
    ("labels", LABELS_FILE),
    ("raw", RAW_FILE),
    ("requests", REQUESTS_FILE),
    ("records", RECORDS_FILE),
    ("score", SCORE_FILE),
)
_ATTACHED: tuple[tuple[str, Role], ...] = (
    (RUN_ATTACHMENT, "run"),
    (TASK_FILE, "task"),
    (EVENT_FILE, "event"),
    (SITE_FILE, "site"),
)


class Links:
    """Works out the links, and keeps what doesn't hold."""

    def __init__(self, index: Index) -> None:
        self._index = index
        self._contents = index.contents
        self.links: list[Link] = []
        self.problems: list[Problem] = []
        self.cells: dict[str, dict[str, Any]] = {}

    def derive(self) -> list[Link]:
        """Return all links, in order."""
        readers: dict[Role, Callable[[FileEntry], None]] = {
            "cell": self._cell,
            "audit": self._audit,
            "labels": self._labels,
            "observation": self._observation,
            "proposal": self._proposal,
            "log": self._shortlists,
        }
        for role, read in readers.items():
            for entry in self._contents.of(role):
                try:
                    read(entry)
                except InputError as error:
                    self.problems.append(Problem(entry.path, error.field or "", error.problem))
        for path, task in self._index.seals.items():
            self._task(path, task)
        for path, sha256 in self._index.sources.items():
            video = self._contents.with_hash(sha256, path)
            if video is not None:  # else it is a part that is missing: a clip may be kept private
                self._add("source_video", path, "source.sha256", video, sha256, "source video")
        used = {link.hash for link in self.links if link.kind == "bag"}
        for digest, recording in self._index.recordings.items():
            if digest in used:
                self._recording(recording)
        self.links.sort(key=lambda link: (link.source, link.at, link.target))
        return self.links

    def _shortlists(self, entry: FileEntry) -> None:
        """Link the shortlists that the events of a log were candidates of."""
        for place, record in enumerate(parse_log(self._contents.text(entry), entry.path), start=1):
            if record.kind == "shortlist":
                sha256 = record.details.get("sha256")
                target = self._contents.with_hash(str(sha256), entry.path, "shortlist")
                self._add(
                    "shortlist", entry.path, f"{place}:details.sha256", target, sha256, "list"
                )

    def _add(
        self, kind: Kind, source: str, at: str, target: FileEntry | None, sha256: object, what: str
    ) -> None:
        """Add a link, or the problem that no file has the hash that is named."""
        if not isinstance(sha256, str) or not sha256.startswith("sha256:"):
            self.problems.append(Problem(source, at, f"names no {what}"))
        elif target is None:
            text = f"names {_a(what)} that is not in the package ({sha256})"
            self.problems.append(Problem(source, at, text))
        else:
            self.links.append(
                Link(kind=kind, source=source, at=at, target=target.path, hash=sha256)
            )

    def _version(self, kind: Kind, source: str, at: str, version: object, what: str) -> None:
        versions: Mapping[str, Sequence[FileEntry]] = {
            "event_version": self._index.events,
            "site_version": self._index.sites,
            "task_version": self._index.tasks,
        }[kind]
        self._add(kind, source, at, nearest(versions.get(str(version), ()), source), version, what)

    def _bag(self, source: str, at: str, sha256: object) -> None:
        recording = self._index.recordings.get(str(sha256))
        self._add("bag", source, at, recording.entry if recording else None, sha256, "recording")

    # -- who names whom ------------------------------------------------------------------------

    def _cell(self, entry: FileEntry) -> None:
        facts = self._contents.mapping(entry)
        hashes = facts.get("hashes")
        if facts.get("schema") != CELL_SCHEMA or not isinstance(hashes, dict):
            raise InputError(
                "is no cell of an evaluation",
                field="schema",
                remedy="give the --out folder of `ssp evaluate`",
            )
        self.cells[entry.path] = facts
        try:
            seal = sealed(facts)["hashes"][SEAL]
        except ValueError:  # it holds an infinity or half of a surrogate pair
            seal = None
        if seal is None or seal != hashes.get(SEAL):
            text = "isn't the hash of what the file says: it was changed since it was written"
            self.problems.append(Problem(entry.path, f"hashes.{SEAL}", text))
        for kind, name in _CELL_FILES:
            file = self._contents.beside(entry.path, name)
            sha256 = hashes.get(kind)
            if sha256 is None and file is None and kind != "labels":
                continue
            at = f"hashes.{kind}"
            if file is not None and file.sha256 != sha256:
                text = f"names {sha256}, and {name} beside it has {file.sha256}"
                self.problems.append(Problem(entry.path, at, text))
            else:
                self._add(kind, entry.path, at, file, sha256, f"file {name}")
        self._bag(entry.path, "hashes.bag", hashes.get("bag"))
        if "twin" in hashes:
            self._bag(entry.path, "hashes.twin", hashes["twin"])
        self._version(
            "event_version", entry.path, "event_version", facts.get("event_version"), "K*"
        )
        recording = self._index.recordings.get(str(hashes.get("bag")))
        if recording is not None and recording.video is None:
            version = facts.get("task_version")
            self._version("task_version", entry.path, "task_version", version, "compiled task")
        if recording is not None and recording.run is not None:
            self._verdict(entry.path, recording, facts)
        self._admission(entry, facts, str(hashes.get("bag")))

    def _verdict(self, path: str, recording: Recording, facts: Mapping[str, Any]) -> None:
        """Link the runner's verdict that a cell was evaluated with; a refused cell may lack it."""
        sha256 = facts["hashes"].get("verdict")
        copies = self._index.copies[recording.sha256]
        beside = [e for e in map(self._index.verdict_beside, copies) if e is not None]
        if sha256 is None and not beside and facts.get("status") == "refused":
            return
        file = nearest([e for e in beside if e.sha256 == sha256], path)
        self._add("verdict", path, "hashes.verdict", file, sha256, "verdict")

    def _admission(self, entry: FileEntry, facts: Mapping[str, Any], bag: str) -> None:
        """Link the audit that a cell goes by, and compare its admission; skip an unaudited cell."""
        admission = facts.get("admission")
        audit_sha256 = admission.get("audit_sha256") if isinstance(admission, dict) else None
        if not isinstance(admission, dict) or audit_sha256 is None:
            return
        at = "admission.audit_sha256"
        file = self._contents.with_hash(str(audit_sha256), entry.path, "audit")
        self._add("audit", entry.path, at, file, audit_sha256, "audit")
        if file is None:
            return
        audit = parse_model(Audit, self._contents.mapping(file), file.path)
        statuses = audit_statuses(audit, bag, facts["hashes"].get("verdict"))
        if statuses != {admission.get("status")}:
            text = (
                f"is {admission.get('status')}, and by {file.path} it is "
                f"{', '.join(sorted(statuses)) or 'not known'}"
            )
            self.problems.append(Problem(entry.path, "admission.status", text))

    def _audit(self, entry: FileEntry) -> None:
        audit = parse_model(Audit, self._contents.mapping(entry), entry.path)
        for number, recording in enumerate(audit.recordings):
            at = f"recordings[{number}]"
            self._bag(entry.path, f"{at}.bag_sha256", recording.bag_sha256)
            self._beside(entry.path, at, recording)
        if audit.event_version is not None:
            self._version("event_version", entry.path, "event_version", audit.event_version, "K*")

    def _beside(self, path: str, at: str, audited: RecordingEntry) -> None:
        """Link the files that an audit read outside the MCAP file: verdict and observations."""
        place = self._index.place_of(audited)
        if place is None:
            return
        if (sha256 := audited.verdict_sha256) is not None:
            file = self._index.verdict_beside(place)
            file = file if file is not None and file.sha256 == sha256 else None
            self._add("verdict", path, f"{at}.verdict_sha256", file, sha256, "verdict")
        if (sha256 := audited.declaration_sha256) is not None:
            file = self._contents.beside(place.path, DECLARATION_FILE)
            file = file if file is not None and file.sha256 == sha256 else None
            self._add("declaration", path, f"{at}.declaration_sha256", file, sha256, "declaration")
        observation_hashes = {} if audited.observations is None else audited.observations.files
        for name, digest in observation_hashes.items():
            file = self._contents.with_hash(digest, place.path, "observation")
            field = f"{at}.observations.files.{name}"
            self._add("observation", path, field, file, digest, "observation")

    def _labels(self, entry: FileEntry) -> None:
        version = self._contents.mapping(entry).get("event_version")
        self._version("event_version", entry.path, "event_version", version, "K*")

    def _observation(self, entry: FileEntry) -> None:
        """Link the observed recording; a draft counts for nothing and names no seal."""
        value = self._contents.mapping(entry)
        if value.get("seal") is None:
            return
        observation = parse_model(Observation, value, entry.path)
        check_seal(observation, entry.path)
        self._bag(entry.path, "bag_sha256", observation.bag_sha256)

    def _proposal(self, entry: FileEntry) -> None:
        value = self._contents.mapping(entry)
        proposed = str(value.get("labels_sha256"))
        labels = self._contents.with_hash(proposed, entry.path, "labels")
        if labels is not None:  # edited labels are no longer what was proposed
            self._add("labels", entry.path, "labels_sha256", labels, proposed, "labels file")
        source = str(value.get("source"))
        truth = self._contents.with_hash(source, entry.path, "truth")
        if truth is not None:
            self._add("truth", entry.path, "source", truth, source, "truth file")
        elif source.startswith("sha256:"):
            self._bag(entry.path, "source", source)

    def _task(self, path: str, task: Task) -> None:
        self._version("event_version", path, "event.version", task.event.version, "K*")
        if task.place.kind == "site":
            self._version("site_version", path, "place.sha256", task.place.sha256, "site")
        else:
            map_file = self._contents.with_hash(task.place.sha256, path)
            self._add("map", path, "place.sha256", map_file, task.place.sha256, "map")
        if task.validated_by is not None:
            checked = task.validated_by
            self._bag(path, "validated_by.bag_sha256", checked.bag_sha256)
            version = checked.task_version
            self._version("task_version", path, "validated_by.task_version", version, "task")

    def _recording(self, recording: Recording) -> None:
        path = recording.entry.path
        if recording.video is not None:
            sha256 = recording.video.source.get("sha256")
            video = self._contents.with_hash(str(sha256), path)
            source = self._index.recordings.get(str(sha256))
            if video is None and source is not None:
                video = source.entry  # a bag of several files
            at = f"{IMPORT_ATTACHMENT}:source.sha256"
            self._add("source_video", path, at, video, sha256, "source video")
            at = f"{IMPORT_ATTACHMENT}:event_version"
            self._version("event_version", path, at, recording.video.event_version, "K*")
        run = recording.run
        if run is None:
            return
        for name, role in _ATTACHED:
            data = recording.attachments.get(name)
            if data is None and name == SITE_FILE:
                continue  # compiled for a map
            sha256 = None if data is None else sha256_bytes(data)
            file = None if sha256 is None else self._contents.with_hash(sha256, path, role)
            own = self._own(path, name)
            if own is not None and sha256 is not None and own.sha256 != sha256:
                text = f"is not what lies in {own.path}"
                self.problems.append(Problem(path, name, text))
            else:
                self._add("attachment", path, name, own or file, sha256, f"attached {name}")
        at = f"{RUN_ATTACHMENT}:event_version"
        self._version("event_version", path, at, run.event_version, "K*")
        at = f"{RUN_ATTACHMENT}:task_version"
        self._version("task_version", path, at, run.task_version, "compiled task")
        if recording.task is not None:
            has = {
                "event_version": recording.task.event.version,
                "task_version": recording.task.version,
            }
            for key, version in has.items():
                if getattr(run, key) != version:
                    text = f"is {getattr(run, key)}, and the {TASK_FILE} beside it has {version}"
                    self.problems.append(Problem(path, f"{RUN_ATTACHMENT}:{key}", text))
        self._log(recording)

    def _own(self, path: str, name: str) -> FileEntry | None:
        """Return the file that a run's attachment was made from; None in an incomplete folder."""
        run = PurePosixPath(path).parent.parent
        place = run / name if name == RUN_ATTACHMENT else run / TASK_FOLDER / name
        return self._contents.by_path.get(str(place))

    def _log(self, recording: Recording) -> None:
        """Link the log beside a bag that begins with the bag's: entries may have come later."""
        data = recording.attachments.get(LOG_FILE)
        if data is None:
            return
        path = recording.entry.path
        sha256 = sha256_bytes(data)
        own = self._own(path, LOG_FILE)
        logs = [
            entry
            for entry in ([own] if own is not None else self._contents.of("log"))
            if entry.bytes >= len(data) and self._contents.data(entry).startswith(data)
        ]
        self._add("log", path, LOG_FILE, nearest(logs, path), sha256, f"attached {LOG_FILE}")


def _a(what: str) -> str:
    return f"{'an' if what[0] in 'aeiou' else 'a'} {what}"


Lines = list[tuple[LineRef, dict[str, Any]]]


class Chains:
    """Works out the chains of scored cells, scoring anew what can be."""

    def __init__(self, index: Index) -> None:
        self._index = index
        self._contents = index.contents
        self.chains: list[Chain] = []
        self.links: list[Link] = []
        self.problems: list[Problem] = []
        self.notes: list[str] = []

    def add(self, cell: str, facts: Mapping[str, Any]) -> None:
        """Add the chains of one cell; a refused or failed one has none."""
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
        self._check_raw_requests(raw_file, raw, requests)
        if len(requests) != len(labels.labels):
            text = f"holds {len(requests)} lines for {len(labels.labels)} labels"
            raise InputError(
                text,
                file=requests_file.path,
                remedy="put the files of the cell back, or evaluate it again",
            )
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
                self._check_record(
                    facts, records_file, record_ref, records[match], answer, request, raw
                )
            missing = str(request.get("missing", ""))
            self.chains.append(
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
            raise InputError(
                f"has no {name} beside it",
                file=cell,
                remedy="put the files of the cell back, or evaluate it again",
            )
        return entry

    def _problem(self, entry: FileEntry, field: str, text: str) -> None:
        self.problems.append(Problem(entry.path, field, text))

    def _lines(self, entry: FileEntry) -> Lines:
        lines = []
        for number, line in _numbered(self._contents.text(entry)):
            value = parse_json_line(line, entry.path, number)
            if not isinstance(value, dict):
                raise InputError(
                    "must be a JSON object",
                    file=entry.path,
                    line=number,
                    remedy="put the file back, or evaluate the cell again",
                )
            lines.append((LineRef(line=number, sha256=sha256_bytes(line.encode())), value))
        return lines

    def _check_raw_requests(
        self, raw_file: FileEntry, raw: Mapping[str, tuple[LineRef, Any]], requests: Lines
    ) -> None:
        request_ids = {str(request.get("request_id")) for _, request in requests}
        for name, (ref, _) in raw.items():
            if name not in request_ids:
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
        stored_score = check_score(self._contents.mapping(stored), stored.path)
        threshold_values = facts.get("thresholds")
        thresholds = DEFAULT if threshold_values is None else thresholds_of(threshold_values, cell)
        score = score_cell(labels, records, thresholds)
        if facts["hashes"].get("thresholds") != thresholds.sha256:
            self.notes.append(f"{stored.path}: made with other thresholds, not scored again")
        elif stored_score != score.to_json():
            self._problem(stored, "", "is not what its records and labels give")
        return [judgement.record for judgement in score.details.judgements]

    def _check_record(
        self,
        facts: Mapping[str, Any],
        records_file: FileEntry,
        place: LineRef,
        record: BehaviourRecord,
        answer: tuple[LineRef, dict[str, Any]] | None,
        request: Mapping[str, Any],
        raw: Mapping[str, tuple[LineRef, dict[str, Any]]],
    ) -> None:
        """Compare a record with the one that its raw answer gives."""
        if answer is None:
            self._problem(records_file, f"{place.line}", "has no raw answer")
            return
        raw_path = str(PurePosixPath(records_file.path).with_name(RAW_FILE))
        response = _response(answer, raw_path)
        extractor = _extractors().get(facts["hashes"].get("extractor"))
        if extractor is None:
            note = f"{records_file.path}: made by another extractor, not extracted again"
            if note not in self.notes:
                self.notes.append(note)
            return
        before = raw.get(str((request.get("previous") or {}).get("request_id")))
        adapter_request = rebuild_request(
            request, None if before is None else _response(before, raw_path)
        )
        again = record_of(
            record.t_s,
            response,
            str(facts.get("adapter")),
            adapter_request,
            str(request.get("no_previous", "")),
            extractor,
        )
        if record_to_json(again) != record_to_json(record):
            self._problem(records_file, f"{place.line}", "is not what its raw answer gives")

    def _frames(
        self, entry: FileEntry, requests: Lines, facts: Mapping[str, Any]
    ) -> dict[int, list[SentFrame]]:
        """Return the frames of each request, by its line, each found in the recording."""
        hashes = facts["hashes"]
        recording = self._index.recordings.get(str(hashes.get("twin", hashes.get("bag"))))
        condition = str(facts.get("condition", ""))
        if condition == BLIND:
            self.notes.append(f"{entry.path}: a control, the frames of its requests weren't shown")
        elif (
            condition not in ("", REPEAT)
            and "twin" not in hashes
            and not condition.startswith(REASONING)
        ):
            # Blackened frames are in no recording, and shuffled ones stand at other stamps.
            self.notes.append(f"{entry.path}: a control, its frames are {condition}")
            recording = None
        frames_by_line: dict[int, list[SentFrame]] = {}
        for ref, request in requests:
            frames = frames_by_line[ref.line] = []
            for number, frame in enumerate(_frames_of(request, entry, ref)):
                frames.append(frame)
                at = f"{ref.line}:frames[{number}].sha256"
                if recording is not None and recording.frames.get(frame.stamp_ns) != frame.sha256:
                    text = f"is {frame.sha256}, and {recording.entry.path} has another frame there"
                    self._problem(entry, at, text)
                frame_file = self._contents.with_hash(frame.sha256, entry.path, "frame")
                if frame_file is not None:
                    self.links.append(
                        Link(
                            kind="frame",
                            source=entry.path,
                            at=at,
                            target=frame_file.path,
                            hash=frame.sha256,
                        )
                    )
        return frames_by_line


@cache
def _extractors() -> dict[str, Extractor]:
    """Return the extractors that need no LLM, by their hashes."""
    extractors = (Extractor(), Extractor(use_reader=False))
    return {extractor.sha256: extractor for extractor in extractors}


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
            "must list stamps and hashes",
            file=entry.path,
            line=ref.line,
            field="frames",
            remedy="put the file back, or evaluate the cell again",
        ) from error


def _where(error: InputError) -> str:
    return ":".join(str(part) for part in (error.line, error.field) if part)
