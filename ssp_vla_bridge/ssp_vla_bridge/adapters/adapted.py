"""The result of every adapter, the detection of cut answers, and paths from speed and curvature."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ssp_core.chat.answer_text import Ending, ending, split_answer
from ssp_vla_bridge.messages import Response
from ssp_vla_bridge.trajectory import Trajectory


@dataclass(frozen=True)
class AdapterInfo:
    """The way in which a response was read; goes into the behaviour record (METHOD 5.3).

    Args:
        origin_added: True when the frame's origin was put in as the point at t = 0 (METHOD 5.4).
        notes: what a reader of the scores should know, one clause each.
    """

    name: str
    mode: str
    origin_added: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class AdaptedResponse:
    """Text and trajectory of one response.

    Args:
        trajectory: None when the native output is missing or invalid.
        invalid: why it is None, reasons of METHOD 5.3.
    """

    text: str
    trajectory: Trajectory | None
    invalid: tuple[str, ...]
    info: AdapterInfo


def without_trajectory(
    response: Response, info: AdapterInfo, reason: str, note: str = ""
) -> AdaptedResponse:
    """Make the result of an adapter that can't read a trajectory.

    Args:
        response: as it came; if it has an error, the error replaces the note.
        info: the adapter's so far; the note is added to its notes.
        reason: an invalid reason, such as ``missing`` or ``shape``.
        note: what is wrong, for people.
    """
    if response.error_code:
        note = f"error {response.error_code} instead of an answer"
    return AdaptedResponse(response.text, None, (reason,), replace(info, notes=(*info.notes, note)))


def answer_part(response: Response) -> tuple[Response, tuple[str, ...]]:
    """Reduce a response's text to the answer, stage by stage (METHOD 5.4b).

    Returns:
        The response whose text is the answer, with the stages' spans in that text; and a note for
        each thing that was left out.
    """
    stages = response.decoding.get("stages")
    spans = _spans(stages, len(response.text))
    if not spans:
        part = split_answer(response.text)
        return replace(response, text=part.text), part.notes
    pieces: list[str] = []
    moved: list[Any] = []
    notes: list[str] = []
    end, length = 0, 0
    for stage, (start, stop) in zip(stages or (), spans, strict=True):
        part = split_answer(response.text[start:stop])
        pieces += [response.text[end:start], part.text]
        length += start - end
        moved.append({**stage, "start": length, "end": length + len(part.text)})
        length += len(part.text)
        end = stop
        notes += [f"{stage.get('name', 'a stage')}: {note}" for note in part.notes]
    text = "".join(pieces) + response.text[end:]
    return replace(response, text=text, decoding={**response.decoding, "stages": moved}), tuple(
        notes
    )


def _spans(stages: object, length: int) -> list[tuple[int, int]]:
    """Return the stages' spans of a text, in order; empty where they aren't all sound."""
    spans: list[tuple[int, int]] = []
    for stage in stages if isinstance(stages, list) else ():
        if not isinstance(stage, Mapping):
            return []
        start, end = stage.get("start"), stage.get("end")
        if not (type(start) is int and type(end) is int):
            return []
        if not (spans[-1][1] if spans else 0) <= start <= end <= length:
            return []
        spans.append((start, end))
    return spans


MOTION = "motion"
_WHOLE = "answer"
_NAME_LENGTH = 40


def cut_parts(response: Response) -> tuple[str, ...]:
    """Name the stages that were cut off; ``answer`` where decoding says it of the whole.

    Args:
        response: of any model; ``finish_reason`` is looked for in its ``decoding`` and in each
            of ``decoding["stages"]``.
    """
    stages = response.decoding.get("stages")
    part_names = []
    for stage in stages if isinstance(stages, list) else ():
        if isinstance(stage, Mapping) and _is_limit(stage.get("finish_reason")):
            name = stage.get("name")
            part_names.append(name[:_NAME_LENGTH] if isinstance(name, str) else "a stage")
    if _is_limit(response.decoding.get("finish_reason")):
        part_names.append(_WHOLE)
    return tuple(dict.fromkeys(part_names))


def _is_limit(reason: object) -> bool:
    return isinstance(reason, str) and ending(reason) is Ending.LIMIT


def motion_is_cut(response: Response) -> bool:
    """Tell whether the text that holds the motion ends where the tokens did."""
    return not {MOTION, _WHOLE}.isdisjoint(cut_parts(response))


def arcs(steps: Iterable[tuple[float, float]], step_s: float) -> Trajectory:
    """Hold each speed (m/s) and curvature (1/m, + is left) for one step: a circular arc.

    Its length is d = v Δt and it turns by κ d. With θ_0 = 0 and c = sin(κ d / 2) / (κ d / 2),
    which is 1 for a straight step:
    x_k = x_(k−1) + d c cos(θ_(k−1) + κ d / 2), y_k = y_(k−1) + d c sin(θ_(k−1) + κ d / 2),
    θ_k = θ_(k−1) + κ d. The points lie at 0, Δt, 2 Δt, …, the first one is the origin.
    Numbers that are too large give points that aren't finite; check_trajectory tells.
    """
    xs, ys, heading_rad = [0.0], [0.0], 0.0
    for speed_mps, curvature_pm in steps:
        length_m = speed_mps * step_s
        half_rad = curvature_pm * length_m / 2
        chord_m = length_m * (sine(half_rad) / half_rad if abs(half_rad) > 1e-9 else 1.0)
        xs.append(xs[-1] + chord_m * cosine(heading_rad + half_rad))
        ys.append(ys[-1] + chord_m * sine(heading_rad + half_rad))
        heading_rad += 2 * half_rad
    return at_steps(xs, ys, step_s)


def at_steps(xs_m: Sequence[float], ys_m: Sequence[float], step_s: float) -> Trajectory:
    """Return points (x forward, y to the left) at 0, Δt, 2 Δt, … as a trajectory."""
    times = tuple(k * step_s for k in range(len(xs_m)))
    return Trajectory(times, tuple(xs_m), tuple(ys_m))


def sine(angle_rad: float) -> float:
    """Return the sine, or NaN for an angle that isn't finite, where math.sin raises."""
    return math.sin(angle_rad) if math.isfinite(angle_rad) else math.nan


def cosine(angle_rad: float) -> float:
    """Return the cosine, or NaN for an angle that isn't finite, where math.cos raises."""
    return math.cos(angle_rad) if math.isfinite(angle_rad) else math.nan
