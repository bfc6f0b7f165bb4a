"""What the page shows of one label time: picture, text, slots, plan and verdicts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.hashing import sha256_file
from ssp_eval.analysis.curvature import Curve, curves
from ssp_eval.analysis.failure_table import STAGE_NAMES
from ssp_eval.evaluate.cell_file import frame_path
from ssp_eval.labels.model import Label
from ssp_eval.records import SLOT_NAMES, BehaviourRecord
from ssp_eval.report.load import CellData
from ssp_eval.report.projection import overlay
from ssp_eval.report.spans import Segment, segments
from ssp_eval.report.topview import top_view
from ssp_eval.report.walk import Walks, WalkStep
from ssp_eval.score import Judgement
from ssp_eval.score.semantics import SlotScore
from ssp_eval.score.show import NULL

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
        anchor: in the page.
        label: what is true.
        t_s: clip time of the record, None where there is none.
        frame: hash of the newest frame sent, None where nothing was sent.
        frames_sent: how many frames were.
        missing: kind and reason of there being no answer, empty where there is one.
        text: pieces with their evidence.
        slots: four semantic slots.
        actions: longitudinal and lateral.
        feasible: yes, no, or – where there is no valid trajectory.
        notes: of the adapter, and why a trajectory is invalid.
        failure: name of the first failing stage, empty if none.
        stage: its key, ``none`` if none.
        response: this record begins the risk response.
        candidate: it counts for the risk response.
        overlay: SVG over the picture.
        plan: SVG of the plan.
        picture: path of that newest frame in the campaign folder, empty where it wasn't kept
            or is another one.
        walk: from the score back to K*.
        curve: how much of the recorded lateral shift follows from the road's curve, in words.
        curve_reads: the lateral action that the curve alone would be taken for, empty where that
            is none or not known; it changes no score.
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
    curve: str
    curve_reads: str


def record_views(cell: CellData) -> list[RecordView]:
    """The views of a scored cell, one per label."""
    if cell.score is None:
        return []
    details = cell.score.details
    walks = Walks(cell)
    requests = cell.requests
    by_time = {curve.label_t_s: curve for curve in curves(requests)}
    return [
        _view(
            cell,
            index,
            label,
            judgement,
            _request(requests, label.t_s),
            walks.of(index, judgement),
            by_time.get(label.t_s, Curve(label.t_s)),
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
    curve: Curve,
) -> RecordView:
    response = None if cell.score is None else cell.score.details.response_record
    record = None if judgement.record is None else cell.records[judgement.record]
    frames: Sequence[dict[str, Any]] = request.get("frames", [])
    valid = record is not None and judgement.trajectory_valid
    trajectory = record.trajectory if record is not None and valid else None
    clip = cell.facts.clip
    drawn = ""
    if trajectory is not None:
        drawn = overlay(
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
        overlay=drawn,
        plan=top_view(trajectory, request.get("history", [])),
        picture=_picture(cell, frames),
        walk=walk,
        curve=curve_words(curve),
        curve_reads="" if curve.reads_as in (None, STRAIGHT) else str(curve.reads_as),
    )


def curve_words(curve: Curve) -> str:
    """The curvature diagnostic of the path that the recorded vehicle drove, not of the model's."""
    if curve.shift_m is None:
        return "not known here: the recorded path doesn't reach 1 s ahead"
    moved = f"the recorded path leads {_sideways(curve.shift_m)} within 1 s"
    if curve.curve_m is None or curve.curvature_per_m is None:
        return f"{moved}; its curvature isn't known: it doesn't begin 1 s before"
    return (
        f"{moved}; {_sideways(curve.curve_m)} follows from its curvature of "
        f"{curve.curvature_per_m:+z.4f} 1/m"
    )


def _sideways(shift_m: float) -> str:
    side = "to the left" if shift_m > 0 else "to the right"
    return f"{abs(shift_m):.2f} m {side}" if round(abs(shift_m), 2) else "0.00 m aside"


def _request(requests: Sequence[dict[str, Any]], label_t_s: float) -> dict[str, Any]:
    return next((r for r in requests if r.get("label_t_s") == label_t_s), {})


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
    """What the adapter noted of a cell's answers, and of how many; the commonest first."""
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
    def mark(given: str | None) -> str:
        if given is None:
            return MISSING
        return HIT if given in allowed else MISS

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
