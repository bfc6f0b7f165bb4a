"""The page's view of one label time: picture, text, plan, verdicts, the way back to K*."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from ssp_core.hashing import sha256_bytes, sha256_file
from ssp_eval.data.labels import Label
from ssp_eval.data.records import SLOT_NAMES, BehaviourRecord, parse_line
from ssp_eval.evaluate.store.cell_file import CELLS, RECORDS_FILE, SCORE_FILE, frame_path
from ssp_eval.evaluate.store.requests import RAW_FILE, REQUESTS_FILE
from ssp_eval.evaluate.store.results import CellData
from ssp_eval.figures.projection import overlay, top_view
from ssp_eval.score.cell import Judgement, SlotScore
from ssp_eval.score.cli import NULL
from ssp_eval.statistics.tables.statistics import STAGE_NAMES


@dataclass(frozen=True)
class Segment:
    """A piece of text and the slots that it is evidence for."""

    text: str
    slots: tuple[str, ...]


def segments(text: str, evidence: Mapping[str, Sequence[tuple[int, int]]]) -> tuple[Segment, ...]:
    """Cut a text where evidence begins and ends; spans may overlap, and may lie outside.

    Returns:
        Pieces whose texts put together are the text.
    """
    inside = {
        slot: [(max(0, a), min(len(text), b)) for a, b in spans if max(0, a) < min(len(text), b)]
        for slot, spans in evidence.items()
    }
    cuts = sorted({0, len(text), *(cut for spans in inside.values() for s in spans for cut in s)})
    return tuple(
        Segment(
            text[start:end],
            tuple(slot for slot, spans in inside.items() if any(a <= start < b for a, b in spans)),
        )
        for start, end in pairwise(cuts)
    )


_NO_RECORD = "no record"
_ATTACHED = "attached to the recording"
# Characters of a raw answer that a page shows; the file has them all.
_MOST_SHOWN = 20_000


@dataclass(frozen=True)
class WalkStep:
    """One link of the way.

    Args:
        what: score, evidence, raw output and so on.
        sha256: of the file, the line or the content; empty where there is nothing.
        path: from the campaign folder, empty where it isn't in it.
        content: the line, where reading it in the page helps; of a very long one its beginning.
    """

    what: str
    sha256: str
    path: str = ""
    says: str = ""
    content: str = ""


@dataclass(frozen=True)
class _Line:
    number: int
    text: str

    @property
    def sha256(self) -> str:
        """Return the hash by which an evidence package names it."""
        return sha256_bytes(self.text.encode())


class _Answer(BaseModel):
    """The part of a line of raw.jsonl that is read here."""

    request_id: str = ""


class Walks:
    """The ways back of one cell's records; its files are read once.

    Raises:
        InputError: a raw answer is damaged.
    """

    def __init__(self, cell: CellData) -> None:
        self._cell = cell
        self._request_facts = cell.requests
        self._place = f"{CELLS}/{cell.id}"
        self._records = _lines(cell.folder / RECORDS_FILE)
        self._requests = _lines(cell.folder / REQUESTS_FILE)
        raw = cell.folder / RAW_FILE
        self._raw = {
            parse_line(_Answer, line.text, raw, line.number).request_id: line
            for line in _lines(raw)
        }

    def of(self, index: int, judgement: Judgement) -> tuple[WalkStep, ...]:
        """Return the way back of one label time."""
        return tuple(self._steps(index, judgement))

    def _steps(self, index: int, judgement: Judgement) -> Iterator[WalkStep]:
        hashes, facts = self._cell.facts.hashes, self._cell.facts
        says = f"label {index}, in {SCORE_FILE}"
        yield WalkStep("score", hashes.get("score") or "", f"{self._place}/{SCORE_FILE}", says)
        if judgement.record is None:
            yield WalkStep("evidence", "", f"{self._place}/{RECORDS_FILE}", _NO_RECORD)
        else:
            line = self._records[judgement.record]
            yield self._line("evidence", RECORDS_FILE, line)
        yield from self._question_steps(index, judgement)
        yield WalkStep("recording", hashes.get("bag") or "", says=facts.clip.origin)
        # Sessions carry what they were made from; an imported video was made from nothing of ours.
        says = _ATTACHED if facts.clip.verdict is not None else ""
        if facts.task_version is not None:
            yield WalkStep("compiled task", facts.task_version, says=says)
        yield WalkStep("K*", facts.event_version, says=says or "as declared for this video")

    def _question_steps(self, index: int, judgement: Judgement) -> Iterator[WalkStep]:
        """Yield the raw output, request and frames: of the request that the record came from."""
        requests = self._request_facts
        if judgement.record is not None:
            at = (k for k, r in enumerate(requests) if r.get("t_s") == judgement.record_t_s)
            index = next(at, index)
        if index >= len(requests):
            return
        request = requests[index]
        raw = self._raw.get(str(request.get("request_id")))
        if raw is not None:
            yield self._line("raw output", RAW_FILE, raw, whole=True)
        frames = request.get("frames", [])
        if frames:
            yield self._line("request", REQUESTS_FILE, self._requests[index])
        for frame in frames:
            digest = str(frame["sha256"])
            path = frame_path(self._cell.folder.parents[1], digest)
            there = f"{path.parent.name}/{path.name}" if path.is_file() else ""
            says = f"stamp {frame.get('stamp_ns')} ns{'' if there else ', in the recording'}"
            yield WalkStep("frame sent", digest, there, says)

    def _line(self, what: str, file: str, line: _Line, whole: bool = False) -> WalkStep:
        content = _excerpt(line.text) if whole else ""
        place = f"{self._place}/{file}"
        return WalkStep(what, line.sha256, place, f"line {line.number} of {file}", content)


def _excerpt(text: str) -> str:
    more = len(text) - _MOST_SHOWN
    return text if more <= 0 else f"{text[:_MOST_SHOWN]}… and {more} more characters in the file"


def _lines(file: Path) -> list[_Line]:
    """Return a JSON Lines file's filled lines, numbered from 1; none without a file."""
    text = file.read_text("utf-8") if file.is_file() else ""
    return [_Line(k, line) for k, line in enumerate(text.split("\n"), start=1) if line.strip()]


STRAIGHT = "straight"
HIT, SOFT, MISS, MISSING, MASKED = "hit", "near", "miss", "missing", "masked"


@dataclass(frozen=True)
class SlotRow:
    """One slot: what the model said, what is true, and how that counts."""

    name: str
    answer: str
    truth: str
    mark: str


@dataclass(frozen=True)
class ActionRow:
    """One axis of action: text, trajectory, and what is admissible."""

    name: str
    text: str
    text_mark: str
    trajectory: str
    trajectory_mark: str
    allowed: str


@dataclass(frozen=True)
class RecordView:
    """One label time of one cell.

    Args:
        t_s: clip time of the record, None where there is none.
        frame: hash of the newest frame sent, None where nothing was sent.
        missing: kind and reason of there being no answer, empty where there is one.
        feasible: yes, no, or – where there is no valid trajectory.
        notes: of the adapter, and why a trajectory is invalid.
        failure: name of the first failing stage, empty if none.
        stage: its key, ``none`` if none.
        picture: path of that newest frame in the campaign folder, empty where it wasn't kept
            or is another one.
    """

    anchor: str
    label: Label
    t_s: float | None
    frame: str | None
    frames_sent: int
    missing: str
    text: tuple[Segment, ...]
    slots: tuple[SlotRow, ...]
    actions: tuple[ActionRow, ...]
    feasible: str
    notes: tuple[str, ...]
    failure: str
    stage: str
    response: bool
    candidate: bool
    overlay: str
    plan: str
    picture: str
    walk: tuple[WalkStep, ...]


def record_views(cell: CellData) -> list[RecordView]:
    """Return the views of a scored cell, one per label."""
    if cell.score is None:
        return []
    details = cell.score.details
    walks = Walks(cell)
    requests = cell.requests_by_label()
    return [
        _view(
            cell,
            index,
            label,
            judgement,
            requests.get(label.t_s, {}),
            walks.of(index, judgement),
        )
        for index, (label, judgement) in enumerate(
            zip(cell.labels.labels, details.judgements, strict=True)
        )
    ]


def _view(
    cell: CellData,
    index: int,
    label: Label,
    judgement: Judgement,
    request: dict[str, Any],
    walk: tuple[WalkStep, ...],
) -> RecordView:
    response = None if cell.score is None else cell.score.details.response_record
    record = None if judgement.record is None else cell.records[judgement.record]
    frames: Sequence[dict[str, Any]] = request.get("frames", [])
    valid = record is not None and judgement.trajectory_valid
    trajectory = record.trajectory if record is not None and valid else None
    clip = cell.facts.clip
    overlay_svg = ""
    if trajectory is not None:
        overlay_svg = overlay(
            trajectory,
            None if clip.geometry is None else clip.geometry.model_dump(),
            clip.mount_forward_m,
            (clip.mount_left_m, clip.mount_yaw_left_rad, clip.mount_roll_right_rad),
        )
    stage = judgement.first_failure
    return RecordView(
        anchor=f"{cell.id}-{index}",
        label=label,
        t_s=judgement.record_t_s,
        frame=frames[-1]["sha256"] if frames else None,
        frames_sent=len(frames),
        missing=_missing(request),
        text=_text(record),
        slots=tuple(_slot(name, score) for name, score in judgement.slots.items()),
        actions=(
            _action(
                "longitudinal", judgement.text_lon, judgement.trajectory_lon, label.lon_actions
            ),
            _action("lateral", judgement.text_lat, judgement.trajectory_lat, label.lat_actions),
        ),
        feasible={True: "yes", False: "no", None: NULL}[judgement.feasible],
        notes=_notes(record),
        failure=STAGE_NAMES[stage] if stage else "",
        stage=stage or "none",
        response=response is not None and judgement.record == response,
        candidate=judgement.candidate,
        overlay=overlay_svg,
        plan=top_view(trajectory, request.get("history", [])),
        picture=_picture(cell, frames),
        walk=walk,
    )


def _picture(cell: CellData, frames: Sequence[dict[str, Any]]) -> str:
    out = cell.folder.parents[1]
    if not frames:
        return ""
    path = frame_path(out, frames[-1]["sha256"])
    is_it = path.is_file() and sha256_file(path) == frames[-1]["sha256"]
    return path.relative_to(out).as_posix() if is_it else ""


def _missing(request: Mapping[str, Any]) -> str:
    kind, reason = request.get("kind"), str(request.get("missing", ""))
    # A reason that begins with its kind says it once.
    return f"{kind}: {reason}" if kind and not reason.startswith(str(kind)) else reason


def tolerated(cell: CellData) -> list[tuple[str, int]]:
    """Count the adapter's notes on a cell's answers; the commonest first."""
    notes = Counter(
        note
        for record in cell.records
        if record.adapter is not None
        for note in dict.fromkeys(record.adapter["notes"])
    )
    return sorted(notes.items(), key=lambda one: (-one[1], one[0]))


def _text(record: BehaviourRecord | None) -> tuple[Segment, ...]:
    if record is None or not record.text:
        return ()
    evidence = {
        name: slot.evidence
        for name in SLOT_NAMES
        if (slot := getattr(record.slots, name)) is not None
    }
    return segments(record.text, evidence)


def _words(value: str | tuple[str, ...] | None) -> str:
    if value is None:
        return NULL
    if isinstance(value, str):
        return value
    return ", ".join(value) or "nobody"


def _slot(name: str, score: SlotScore) -> SlotRow:
    if not score.evaluable:
        mark = MASKED
    elif not score.given:
        mark = MISSING
    elif score.h == 1.0:
        mark = HIT
    elif score.s:
        mark = SOFT
    else:
        mark = MISS
    return SlotRow(name, _words(score.answer), _words(score.truth), mark)


def _action(
    name: str, text: str | None, trajectory: str | None, allowed: Sequence[str]
) -> ActionRow:
    def mark(action: str | None) -> str:
        if action is None:
            return MISSING
        return HIT if action in allowed else MISS

    return ActionRow(
        name, _words(text), mark(text), _words(trajectory), mark(trajectory), " / ".join(allowed)
    )


def _notes(record: BehaviourRecord | None) -> tuple[str, ...]:
    if record is None:
        return ()
    notes = [f"trajectory invalid: {reason}" for reason in record.invalid]
    if record.adapter is not None:
        if record.adapter["origin_added"]:
            notes.append("the frame's origin was added as the point at t = 0")
        notes += record.adapter["notes"]
    return tuple(notes)
