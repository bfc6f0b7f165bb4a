"""The inputs of an audit, read from a bag and from beside it, with changes on site."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from pathlib import Path

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns, stamp_ns
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.event import TOLERANCE_S
from ssp_core.motion.state_series import (
    Packed,
    Series,
    StateSeries,
    between,
    copied,
    times_of,
)
from ssp_core.names import CAMERA_IMAGE, PHASE_EVENT, SAFETY_EVENT, absolute
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.vocabulary import Phase
from ssp_eval.audit.evidence.measure import RoadFacts
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.data.audit import ChangeEntry
from ssp_eval.data.labels import Labels, load_labels
from ssp_eval.data.provenance import (
    ImportedSite,
    Provenance,
    bag_folder,
    find_bag,
    find_labels,
    read_provenance,
)
from ssp_eval.observations.agreement import Agreement, agree
from ssp_eval.observations.files import Footage, load_observations
from ssp_eval.recordings.clip import BagFiles, Clip
from ssp_eval.recordings.event import Crop
from ssp_eval.recordings.sight import Moments, Optics
from ssp_eval.recordings.states import (
    STATE_AGE_S,
    Sighting,
    attached,
    clip_zero_ns,
    read_states,
)
from ssp_scenario_manager.compile.changes import differences, explained
from ssp_scenario_manager.compile.task import (
    EVENT_FILE,
    SITE_FILE,
    TASK_FILE,
    TASK_FOLDER,
    Task,
    content_hash,
)
from ssp_scenario_manager.event_spec.load import event_version
from ssp_scenario_manager.event_spec.log import LOG_FILE, Record, parse_log, read_log
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event
from ssp_scenario_manager.maps.site import Site, SiteBlock, site_version


@dataclass(frozen=True)
class BagAttachments:
    """The attachments of a bag by the recorder, as far as they could be read.

    Args:
        task: None: there is none, or none that is valid.
        site: None also for a run that was placed on a map.
        later: entered into the log beside the recording after the run.
    """

    task: Task | None
    event: Event | None
    site: Site | None
    records: tuple[Record, ...]
    later: tuple[Record, ...]
    findings: tuple[Finding, ...]


def read_attached(bag: BagReader) -> BagAttachments:
    """Read task, K*, site and log of a recording; what is wrong with them becomes findings."""
    findings: list[Finding] = []
    task = event = site = None
    records: tuple[Record, ...] = ()
    later: tuple[Record, ...] = ()
    try:
        task = attached(bag, TASK_FILE, Task)
        if task is None:
            findings.append(Finding("not_compiled", f"the bag has no attachment {TASK_FILE}"))
        event = attached(bag, EVENT_FILE, Event)
        site = attached(bag, SITE_FILE, Site)
        if (log_bytes := bag.attachment(LOG_FILE)) is not None:
            text = log_bytes.decode("utf-8", errors="replace")
            records = tuple(parse_log(text, f"{bag.path}:{LOG_FILE}"))
            later = _later(bag_folder(bag.path).parent / TASK_FOLDER / LOG_FILE, records)
    except InputError as error:
        findings.append(Finding("seal_broken", _error_text(error, bag)))
    findings += _seals(task, event, site)
    return BagAttachments(task, event, site, records, later, tuple(findings))


def _error_text(error: InputError, bag: BagReader) -> str:
    """Describe an error in the same words wherever the recording lies.

    An audit can so be repeated.
    """
    folder = bag_folder(bag.path)
    text = str(error).replace(str(bag.path), folder.name)
    return text.replace(f"{folder.parent}/", "")


def _later(beside: Path, recorded: tuple[Record, ...]) -> tuple[Record, ...]:
    """Return the entries of the log beside a recording that came after those in it.

    Raises:
        InputError: it doesn't begin with what was recorded: somebody rewrote it.
    """
    entries = tuple(read_log(beside))
    if entries and entries[: len(recorded)] != recorded:
        raise InputError(
            "does not begin with the log in the bag",
            file=beside,
            remedy="a log is appended to and never rewritten",
        )
    return entries[len(recorded) :]


def _seals(task: Task | None, event: Event | None, site: Site | None) -> list[Finding]:
    if task is None:
        return []
    findings = []
    content = content_hash(task)
    if content != task.version:
        findings.append(
            Finding("seal_broken", f"{TASK_FILE} says {task.version}, its content is {content}")
        )
    if event is None:
        findings.append(Finding("not_compiled", f"the bag has no attachment {EVENT_FILE}"))
    elif event_version(event) != task.event.version:
        findings.append(
            Finding(
                "seal_broken",
                f"{EVENT_FILE} has {event_version(event)}, the task was made from "
                f"{task.event.version}",
            )
        )
    if task.place.kind == "site":
        if site is None:
            findings.append(Finding("not_compiled", f"the bag has no attachment {SITE_FILE}"))
        elif site_version(site) != task.place.sha256:
            findings.append(
                Finding(
                    "seal_broken",
                    f"{SITE_FILE} has {site_version(site)}, the task was placed on "
                    f"{task.place.sha256}",
                )
            )
    return findings


def site_changes(
    attached: BagAttachments, executed: RunSpec
) -> tuple[list[ChangeEntry], list[Finding]]:
    """Return every difference between the compiled run and the one that ran, and who logged it.

    Returns:
        The changes, logged ones first, and a finding for changes that aren't logged.
    """
    if attached.task is None:
        return [], []
    compiled = attached.task.run
    findings, believed = [], compiled
    entries = []
    for later, records in ((False, attached.records), (True, attached.later)):
        for record in records:
            if record.kind != "site_change":
                continue
            try:
                believed = explained(believed, [record], LOG_FILE)
            except InputError as error:
                findings.append(Finding("unlogged_change", f"a record doesn't fit: {error}"))
                continue
            entries.append(
                ChangeEntry(
                    field=record.field or "",
                    old=record.old,
                    new=record.new,
                    logged=True,
                    later=later,
                    who=record.who,
                    when=record.when,
                    reason=record.reason,
                )
            )
    unlogged = differences(believed, executed)
    entries += [
        ChangeEntry(field=d.field, old=d.compiled, new=d.executed, logged=False) for d in unlogged
    ]
    if unlogged:
        changes_text = ", ".join(
            f"{d.field}: {d.compiled!r} to {d.executed!r}" for d in unlogged[:4]
        )
        more = f" and {len(unlogged) - 4} more" if len(unlogged) > 4 else ""
        findings.append(Finding("unlogged_change", changes_text + more))
    return entries, findings


def disclosed(attached: BagAttachments) -> dict[str, str]:
    """Return what the log discloses, by field or subject; and changes that were entered late."""
    disclosures = {
        record.field or record.subject: record.reason
        for record in attached.records
        if record.kind == "disclosure"
    }
    for record in attached.later:
        if record.kind == "site_change":
            disclosures[record.field or record.subject] = (
                f"changed on site, entered after the run by {record.who}: {record.reason}"
            )
    return disclosures


# So much beside its clip is kept of a recording that was examined (see audit.doubles).
BESIDE_S = 10.0
_IMAGE = absolute(CAMERA_IMAGE)
ROAD_WORDS = ("road_type", "left_boundary", "right_boundary")


@dataclass(frozen=True)
class SafetyRecord:
    """A recorded safety event: clip time, number and words."""

    t_s: float
    code: int
    text: str


@dataclass(frozen=True)
class Recording:
    """One recording, read.

    Args:
        files: as they were when its seal was checked.
        start_s: clip time of its beginning, None: it never began.
        end_s: clip time of its last frame, or of its last state where there are no frames.
        frames_s: clip times of the frames from start to end.
        digests: of each of these frames, the same for the same picture.
        series: (clip time, states by id) from start to end; empty where there are no states.
        sightings: every recorded state from the start on, for identities.
        tracking_m: per OT the largest longitudinal and lateral tracking error that it reported.
        phase_events: clip times of the phases as the run announced them.
        optics: None: the camera isn't known.
        labels: beside the bag, None where there are none; they are counted and decide nothing.
        agreement: what those who looked at it wrote down, sealed and bound to it; None: none.
    """

    path: Path
    files: BagFiles
    provenance: Provenance
    start_s: float | None
    end_s: float | None
    frames_s: tuple[float, ...]
    digests: tuple[bytes, ...]
    series: Series
    source: str
    sightings: Sequence[Sighting]
    tracking_m: Mapping[str, tuple[float, float]]
    phase_events: Mapping[str, float]
    safety: tuple[SafetyRecord, ...]
    optics: Optics | None
    attached: BagAttachments
    labels: Labels | None
    agreement: Agreement | None = None
    observation_files: tuple[Path, ...] = ()

    @property
    def road(self) -> RoadFacts | None:
        """The road that is bound to the recording, with road type and boundaries where known."""
        road = self.provenance.road
        if road is None:
            return None
        imported = self.provenance.imported
        about: ImportedSite | SiteBlock | None = None if imported is None else imported.site
        if self.attached.site is not None and self.attached.task is not None:
            block_id = self.attached.task.block.id
            about = next((b for b in self.attached.site.blocks if b.id == block_id), None)
        if about is None:
            return RoadFacts(road)
        words = {name: str(getattr(about, name)) for name in ROAD_WORDS}
        return RoadFacts(road, {name: word for name, word in words.items() if word != UNRESOLVED})

    def within(self, crop: Crop) -> Recording:
        """Return the recording as if it had been cut to its clip."""
        frames = zip(self.frames_s, self.digests, strict=True)
        clip_frames = [(t_s, digest) for t_s, digest in frames if crop.holds(t_s)]
        return replace(
            self,
            frames_s=tuple(t_s for t_s, _ in clip_frames),
            digests=tuple(digest for _, digest in clip_frames),
            series=copied(self.series, crop.start_s - TOLERANCE_S, crop.end_s + TOLERANCE_S),
            sightings=self._sightings_where(crop.holds),
        )

    def near(self, crop: Crop) -> Recording:
        """Return the recording with only the states within its clip and BESIDE_S beside it.

        An hour of states takes 75 MB, and an audit holds three recordings. A clip that is all of
        its recording shares them.
        """
        first_s, last_s = crop.start_s - BESIDE_S, crop.end_s + BESIDE_S
        return replace(
            self,
            series=copied(self.series, first_s, last_s),
            sightings=self._sightings_where(lambda t_s: first_s <= t_s <= last_s),
        )

    def _sightings_where(self, holds: Callable[[float], bool]) -> Sequence[Sighting]:
        """Return the sightings at times that hold; the recording's own sequence where all do."""
        sightings = Packed(Sighting, (one for one in self.sightings if holds(one.t_s)))
        return self.sightings if len(sightings) == len(self.sightings) else sightings

    def moments(self) -> Moments:
        """Return the states at each frame, extrapolated from the newest ones."""
        times = times_of(self.series)
        series = StateSeries()
        for t_s in self.frames_s:
            i = bisect_right(times, t_s + 1e-9) - 1
            if i < 0 or t_s - times[i] > STATE_AGE_S:
                series.append(t_s, ())
                continue
            ahead_ns = seconds_to_ns(t_s - times[i])
            states = self.series[i][1].values()
            series.append(t_s, (one.extrapolated(one.stamp_ns + ahead_ns) for one in states))
        return Moments(series)


@dataclass(frozen=True)
class Head:
    """A recording without its frames and states.

    Args:
        files: as they were before its seal was checked.
    """

    path: Path
    files: BagFiles
    provenance: Provenance
    attached: BagAttachments


def read_head(path: str | Path) -> Head:
    """Read the head of a recording: its origin, with its seal, and its attachments.

    Args:
        path: bag directory, or a run folder that holds ``bag/``.

    Raises:
        InputError: it is no recording of this project, or is damaged.
    """
    bag_path = find_bag(Path(path))
    with BagReader(bag_path) as bag:
        files = BagFiles(bag)
        with files.watched():
            return Head(bag_path, files, read_provenance(bag), read_attached(bag))


def read_recording(path: str | Path, head: Head | None = None) -> Recording:
    """Read a recording, and the observation files beside it.

    Args:
        path: bag directory, or a run folder that holds ``bag/``.
        head: of it, as it was read before; None: it is read here.

    Raises:
        InputError: it is no recording of this project, is damaged, or was changed since its seal
            was checked; an observation file isn't of it, or was changed since it was sealed.
    """
    head = head or read_head(path)
    with head.files.watched():
        return _recording(head)


def _recording(head: Head) -> Recording:
    bag_path, provenance = head.path, head.provenance
    with BagReader(bag_path) as bag:
        images = sorted((peek_stamp_ns(m.data), _digest(m.data)) for m in bag.messages([_IMAGE]))
        frames_ns = [stamp_ns for stamp_ns, _ in images]
        start_ns = clip_zero_ns(provenance, frames_ns)
        states = read_states(bag, provenance, start_ns)
        phase_events = _phase_events(bag, start_ns)
        safety = _safety_events(bag, start_ns)
    frames = [ns_to_seconds(ns - start_ns) for ns in frames_ns] if start_ns is not None else []
    first_s = last_s = None
    if start_ns is not None:
        ends = frames or times_of(states.series)
        first_s = max(0.0, ends[0]) if ends else None
        last_s = ends[-1] if ends else None
    inside = [
        (t_s, digest)
        for t_s, (_, digest) in zip(frames, images, strict=False)
        if first_s is not None and last_s is not None and first_s <= t_s <= last_s
    ]
    optics = None
    if frames_ns:
        with Clip(bag_path) as clip:
            optics = clip.optics
    labels_file = find_labels(bag_path)
    footage = Footage(provenance.bag_sha256, tuple(frames))
    observed = load_observations(bag_path, footage)
    observations = [observation for _, observation in observed]
    return Recording(
        path=bag_path,
        files=head.files,
        provenance=provenance,
        start_s=first_s,
        end_s=last_s,
        frames_s=tuple(t_s for t_s, _ in inside),
        digests=tuple(digest for _, digest in inside),
        series=() if first_s is None or last_s is None else between(states.series, first_s, last_s),
        source=states.source,
        sightings=states.sightings,
        tracking_m=states.tracking_m,
        phase_events=phase_events,
        safety=tuple(safety),
        optics=optics,
        attached=head.attached,
        labels=None if labels_file is None else load_labels(labels_file),
        agreement=agree(observations, footage.period_s) if observations else None,
        observation_files=tuple(file for file, _ in observed),
    )


# Of a picture's message, counted from its end, where no stamp stands.
_DIGESTED_BYTES = 2048


def _digest(message: bytes) -> bytes:
    return blake2b(message[-_DIGESTED_BYTES:], digest_size=12).digest()


def _phase_events(bag: BagReader, start_ns: int | None) -> dict[str, float]:
    times_s: dict[str, float] = {}
    if start_ns is None:
        return times_s
    for message in bag.messages([absolute(PHASE_EVENT)]):
        event = bag.decode(message)
        word = Phase(event.phase).name.lower()
        times_s.setdefault(word, ns_to_seconds(stamp_ns(event.header.stamp) - start_ns))
    return times_s


def _safety_events(bag: BagReader, start_ns: int | None) -> list[SafetyRecord]:
    records = []
    for message in bag.messages([absolute(SAFETY_EVENT)]):
        event = bag.decode(message)
        t_s = ns_to_seconds(stamp_ns(event.header.stamp) - (start_ns or 0))
        who = f" of {event.object_id}" if event.object_id else ""
        meaning = MEANINGS.get(SafetyCode(event.code)) if event.code in set(SafetyCode) else None
        words = meaning.text if meaning is not None else "a limit was passed"
        records.append(
            SafetyRecord(
                t_s,
                int(event.code),
                f"{event.limit_name}{who} at {t_s:.2f} s: {event.measured:.3g} against "
                f"{event.limit:.3g} {event.unit}".rstrip()
                + f" ({words})",
            )
        )
    return records
