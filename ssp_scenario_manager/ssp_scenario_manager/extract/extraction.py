"""One extraction from beginning to end: clip, interview, candidate, log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ssp_core.chat.client import Chat
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json
from ssp_scenario_manager.checks.base import Failure
from ssp_scenario_manager.checks.check import UndecidedField, contradictions, undecided
from ssp_scenario_manager.event_spec.load import event_version, write_event
from ssp_scenario_manager.event_spec.log import Record, append_records, log_path, read_log, refusal
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.extract.candidate import Origin, make_candidate
from ssp_scenario_manager.extract.clip import Clip, Crop, load_annotation, sample
from ssp_scenario_manager.extract.interview import Interview, Interviewer, Store
from ssp_scenario_manager.extract.questions import DEFINITION_SHA256, GATE_REASONS

WHO = "ssp spec extract"
DECISIONS_FILE = "decisions.json"


@dataclass(frozen=True)
class Order:
    """A request to extract an event.

    Args:
        annotation: EMM-AU file, None: there is none.
        server: address, for the log.
    """

    video: Path
    crop: Crop
    origin: Origin
    out: Path
    annotation: Path | None = None
    show_annotation: bool = False
    use_schema: bool = True
    server: str = ""
    force: bool = False

    @property
    def candidate(self) -> Path:
        return self.out / f"{self.origin.name}.candidate.yaml"

    @property
    def store(self) -> Path:
        return self.out / f"{self.origin.name}.extraction"


@dataclass(frozen=True)
class GateFinding:
    """The model's answer about one of the gate's reasons; a person refuses, not the model."""

    reason: str
    answer: str
    confidence: float
    frames: tuple[int, ...]


@dataclass(frozen=True)
class ExtractedEvent:
    """A candidate, and all that a person must look at."""

    event: Event
    version: str
    clip: Clip
    undecided: list[UndecidedField]
    failures: list[Failure]
    gate: list[GateFinding]
    notes: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        return {
            "version": self.version,
            "undecided": [asdict(item) for item in self.undecided],
            "failures": [asdict(failure) for failure in self.failures],
            "gate": [asdict(finding) for finding in self.gate],
        }


def extract(
    order: Order,
    chat: Chat,
    now: Callable[[], str],
    advance: Callable[[int, int], None] = lambda *_: None,
) -> ExtractedEvent:
    """Ask the model about the clip and write candidate, log and decisions.

    Args:
        order: clip, annotation, model and output.
        chat: sends a request to the model.
        now: gives the time of each entry, ISO 8601.
        advance: called with (questions answered, questions in all).

    Raises:
        InputError: video, annotation or output are not usable, the clip was refused before, or it
            shows no event. Answers are kept; no candidate is written.
        PeerError: the model gives no usable answer; what was answered is kept.
    """
    name = order.origin.name
    notes = []
    annotation: dict[str, Any] | None = None
    annotation_text = None
    if order.annotation is not None:
        source_annotation, digest = load_annotation(order.annotation)
        annotation = {
            "file": order.annotation.name,
            "sha256": digest,
            "content": source_annotation.model_dump(mode="json"),
            "shown_to_model": order.show_annotation,
        }
        annotation_text = source_annotation.text if order.show_annotation else None
        if source_annotation.video_id != order.video.stem:
            notes.append(
                f"the annotation is about video {source_annotation.video_id!r}, the file is "
                f"{order.video.name}"
            )
    if order.candidate.exists() and not order.force:
        raise InputError(
            "exists already",
            file=order.candidate,
            remedy="review it, or give another --name, or --force to replace it",
        )
    clip = sample(order.video, order.crop)
    log = log_path(order.candidate)
    source = _source_record(order, clip, now())
    refused = refusal([*read_log(log), source], name)
    if refused is not None:
        raise InputError(
            f"was refused by {refused.who} on {refused.when}: {refused.reason}",
            file=order.video,
            remedy=f"extract another clip or crop, or another --name (log: {log})",
        )
    store = Store(make_folder(order.out) / order.store.name)
    interviewer = Interviewer(
        clip, chat, store, use_schema=order.use_schema, annotation=annotation_text, advance=advance
    )
    interview = interviewer.run()
    gate = gate_findings(interview, clip)
    details = {
        "model": chat.model,
        "server": order.server,
        "questions_sha256": DEFINITION_SHA256,
        "store": store.folder.name,
        "requests": store.describe(interview.keys),
        "annotation": annotation,
        "stated_type": order.origin.kind,
        "gate": [asdict(finding) for finding in gate],
    }
    try:
        event = make_candidate(interview, clip, order.origin, chat.model)
    except InputError as error:
        nothing = _record("extraction", name, now(), error.problem, {**details, "version": None})
        append_records(log, [source, nothing])
        raise
    version = event_version(event)
    result = ExtractedEvent(
        event, version, clip, undecided(event), contradictions(event), gate, notes
    )
    write_json(store.folder / DECISIONS_FILE, result.as_dict())
    write_event(order.candidate, event)
    record = _record(
        "extraction", name, now(), "candidate of a model", {**details, "version": version}
    )
    append_records(log, [source, record])
    return result


def gate_findings(interview: Interview, clip: Clip) -> list[GateFinding]:
    """List the model's answers about the gate's reasons (METHOD 1), in their order."""
    return [
        GateFinding(
            reason=GATE_REASONS[key],
            answer=finding.value,
            confidence=finding.confidence,
            frames=tuple(clip.shots[i - 1].number for i in finding.frames),
        )
        for key, finding in interview.gate.items()
    ]


def _source_record(order: Order, clip: Clip, when: str) -> Record:
    details = {
        "file": order.video.name,
        "sha256": clip.sha256,
        "generator": order.origin.generator,
        "original": order.origin.original,
        "crop": {
            "start_s": clip.start_s,
            "end_s": clip.end_s,
            "first_frame": clip.first_frame,
        },
        "rate_hz": clip.rate_hz,
    }
    return _record("source", order.origin.name, when, "source clip of the event", details)


def _record(kind: Any, subject: str, when: str, reason: str, details: dict[str, Any]) -> Record:
    return Record(kind=kind, when=when, who=WHO, subject=subject, reason=reason, details=details)
