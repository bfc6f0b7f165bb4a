"""Who names whom by a content hash: the links of a package, worked out from its files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import parse_model
from ssp_core.hashing import sha256_bytes
from ssp_eval.audit.model import Audit, RecordingEntry
from ssp_eval.evaluate.admission import said_of
from ssp_eval.evaluate.cell_file import (
    CELL_SCHEMA,
    LABELS_FILE,
    RECORDS_FILE,
    SCORE_FILE,
    SEAL,
    sealed,
)
from ssp_eval.evaluate.store import RAW_FILE, REQUESTS_FILE
from ssp_eval.package.contents import nearest
from ssp_eval.package.index import Index, Problem, Recording
from ssp_eval.package.model import FileEntry, Kind, Link, Role
from ssp_eval.recordings.import_record import IMPORT_ATTACHMENT
from ssp_eval.recordings.observation import Observation
from ssp_eval.recordings.observation_file import check_seal
from ssp_eval.recordings.provenance import RUN_ATTACHMENT
from ssp_scenario_manager.compile.targets.folder import TASK_FOLDER
from ssp_scenario_manager.compile.task import EVENT_FILE, SITE_FILE, TASK_FILE, Task
from ssp_scenario_manager.event_spec.log import LOG_FILE, parse_log

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
    """Works out the links, and keeps what doesn't hold.

    Args:
        index: of the package.
    """

    def __init__(self, index: Index) -> None:
        self._index = index
        self._contents = index.contents
        self.found: list[Link] = []
        self.problems: list[Problem] = []
        self.cells: dict[str, dict[str, Any]] = {}

    def derive(self) -> list[Link]:
        """All links, in order."""
        for entry in self._contents.of("cell"):
            self._guard(entry, self._cell)
        for entry in self._contents.of("audit"):
            self._guard(entry, self._audit)
        for entry in self._contents.of("labels"):
            self._guard(entry, self._labels)
        for entry in self._contents.of("observation"):
            self._guard(entry, self._observation)
        for entry in self._contents.of("proposal"):
            self._guard(entry, self._proposal)
        for entry in self._contents.of("log"):
            self._guard(entry, self._shortlists)
        for path, task in self._index.seals.items():
            self._task(path, task)
        for path, named in self._index.sources.items():
            video = self._contents.with_hash(named, path)
            if video is not None:  # else it is a part that is missing: a clip may be kept private
                self._add("source_video", path, "source.sha256", video, named, "source video")
        used = {link.hash for link in self.found if link.kind == "bag"}
        for digest, recording in self._index.recordings.items():
            if digest in used:
                self._recording(recording)
        self.found.sort(key=lambda link: (link.source, link.at, link.target))
        return self.found

    def _shortlists(self, entry: FileEntry) -> None:
        """The lists that the events of a log were candidates of."""
        for place, record in enumerate(parse_log(self._contents.text(entry), entry.path), start=1):
            if record.kind == "shortlist":
                named = record.details.get("sha256")
                target = self._contents.with_hash(str(named), entry.path, "shortlist")
                self._add("shortlist", entry.path, f"{place}:details.sha256", target, named, "list")

    def _guard(self, entry: FileEntry, read: Any) -> None:
        try:
            read(entry)
        except InputError as error:
            self.problems.append(Problem(entry.path, error.field or "", error.problem))

    def _add(
        self, kind: Kind, source: str, at: str, target: FileEntry | None, named: object, what: str
    ) -> None:
        """A link, or the problem that nothing has the hash that is named."""
        if not isinstance(named, str) or not named.startswith("sha256:"):
            self.problems.append(Problem(source, at, f"names no {what}"))
        elif target is None:
            text = f"names {_a(what)} that is not in the package ({named})"
            self.problems.append(Problem(source, at, text))
        else:
            self.found.append(Link(kind=kind, source=source, at=at, target=target.path, hash=named))

    def _version(self, kind: Kind, source: str, at: str, named: object, what: str) -> None:
        versions: Mapping[str, Sequence[FileEntry]] = {
            "event_version": self._index.events,
            "site_version": self._index.sites,
            "task_version": self._index.tasks,
        }[kind]
        self._add(kind, source, at, nearest(versions.get(str(named), ()), source), named, what)

    def _bag(self, source: str, at: str, named: object) -> None:
        recording = self._index.recordings.get(str(named))
        self._add("bag", source, at, recording.entry if recording else None, named, "recording")

    # -- who names whom ------------------------------------------------------------------------

    def _cell(self, entry: FileEntry) -> None:
        facts = self._contents.mapping(entry)
        hashes = facts.get("hashes")
        if facts.get("schema") != CELL_SCHEMA or not isinstance(hashes, dict):
            raise InputError("is no cell of an evaluation", field="schema")
        self.cells[entry.path] = facts
        if sealed(facts)["hashes"][SEAL] != hashes.get(SEAL):
            text = "isn't the hash of what the file says: it was changed since it was written"
            self.problems.append(Problem(entry.path, f"hashes.{SEAL}", text))
        for kind, name in _CELL_FILES:
            file = self._contents.beside(entry.path, name)
            named = hashes.get(kind)
            if named is None and file is None and kind != "labels":
                continue
            at = f"hashes.{kind}"
            if file is not None and file.sha256 != named:
                text = f"names {named}, and {name} beside it has {file.sha256}"
                self.problems.append(Problem(entry.path, at, text))
            else:
                self._add(kind, entry.path, at, file, named, f"file {name}")
        self._bag(entry.path, "hashes.bag", hashes.get("bag"))
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
        """The runner's word that a cell was evaluated with; only a refused one may be without."""
        named = facts["hashes"].get("verdict")
        copies = self._index.copies[recording.sha256]
        beside = [e for e in map(self._index.verdict_beside, copies) if e is not None]
        if named is None and not beside and facts.get("status") == "refused":
            return
        file = nearest([e for e in beside if e.sha256 == named], path)
        self._add("verdict", path, "hashes.verdict", file, named, "verdict")

    def _admission(self, entry: FileEntry, facts: Mapping[str, Any], bag: str) -> None:
        """The audit that a cell goes by, and whether it says so; none where it is unaudited."""
        admission = facts.get("admission")
        named = admission.get("audit_sha256") if isinstance(admission, dict) else None
        if not isinstance(admission, dict) or named is None:
            return
        at = "admission.audit_sha256"
        file = self._contents.with_hash(str(named), entry.path, "audit")
        self._add("audit", entry.path, at, file, named, "audit")
        if file is None:
            return
        audit = parse_model(Audit, self._contents.mapping(file), file.path)
        told = said_of(audit, bag, facts["hashes"].get("verdict"))
        if told != {admission.get("status")}:
            text = (
                f"is {admission.get('status')}, and by {file.path} it is "
                f"{', '.join(sorted(told)) or 'not known'}"
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
        """What an audit read outside the MCAP file: the runner's verdict, and observations."""
        place = self._index.place_of(audited)
        if place is None:
            return
        if (named := audited.verdict_sha256) is not None:
            file = self._index.verdict_beside(place)
            file = file if file is not None and file.sha256 == named else None
            self._add("verdict", path, f"{at}.verdict_sha256", file, named, "verdict")
        seen = {} if audited.observations is None else audited.observations.files
        for name, digest in seen.items():
            file = self._contents.with_hash(digest, place.path, "observation")
            field = f"{at}.observations.files.{name}"
            self._add("observation", path, field, file, digest, "observation")

    def _labels(self, entry: FileEntry) -> None:
        version = self._contents.mapping(entry).get("event_version")
        self._version("event_version", entry.path, "event_version", version, "K*")

    def _observation(self, entry: FileEntry) -> None:
        """The recording that was looked at; a draft counts for nothing and names no seal."""
        value = self._contents.mapping(entry)
        if value.get("seal") is None:
            return
        found = parse_model(Observation, value, entry.path)
        check_seal(found, entry.path)
        self._bag(entry.path, "bag_sha256", found.bag_sha256)

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
            found = self._contents.with_hash(task.place.sha256, path)
            self._add("map", path, "place.sha256", found, task.place.sha256, "map")
        if task.validated_by is not None:
            checked = task.validated_by
            self._bag(path, "validated_by.bag_sha256", checked.bag_sha256)
            version = checked.task_version
            self._version("task_version", path, "validated_by.task_version", version, "task")

    def _recording(self, recording: Recording) -> None:
        path = recording.entry.path
        if recording.video is not None:
            named = recording.video.source.get("sha256")
            video = self._contents.with_hash(str(named), path)
            at = f"{IMPORT_ATTACHMENT}:source.sha256"
            self._add("source_video", path, at, video, named, "source video")
            at = f"{IMPORT_ATTACHMENT}:event_version"
            self._version("event_version", path, at, recording.video.event_version, "K*")
        run = recording.run
        if run is None:
            return
        for name, role in _ATTACHED:
            data = recording.attachments.get(name)
            if data is None and name == SITE_FILE:
                continue  # compiled for a map
            named = None if data is None else sha256_bytes(data)
            file = None if named is None else self._contents.with_hash(named, path, role)
            own = self._own(path, name)
            if own is not None and named is not None and own.sha256 != named:
                text = f"is not what lies in {own.path}"
                self.problems.append(Problem(path, name, text))
            else:
                self._add("attachment", path, name, own or file, named, f"attached {name}")
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
        """The file that a run's attachment was made from, where the run's folder is whole."""
        run = PurePosixPath(path).parent.parent
        place = run / name if name == RUN_ATTACHMENT else run / TASK_FOLDER / name
        return self._contents.by_path.get(str(place))

    def _log(self, recording: Recording) -> None:
        """The log in a bag is the beginning of the log beside it: entries may have come later."""
        data = recording.attachments.get(LOG_FILE)
        if data is None:
            return
        path = recording.entry.path
        named = sha256_bytes(data)
        own = self._own(path, LOG_FILE)
        logs = [
            entry
            for entry in ([own] if own is not None else self._contents.of("log"))
            if entry.bytes >= len(data) and self._contents.data(entry).startswith(data)
        ]
        self._add("log", path, LOG_FILE, nearest(logs, path), named, f"attached {LOG_FILE}")


def _a(what: str) -> str:
    return f"{'an' if what[0] in 'aeiou' else 'a'} {what}"
