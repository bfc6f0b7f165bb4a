"""The content of a model's forest plot: effects with their intervals, the control beside."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

from ssp_eval.causes.answers import REASONING, Cause
from ssp_eval.causes.effects import TRAJECTORY, Effect, Verdict, largest

# Effects of shares lie within −1 and 1; most of the room is for those above 0.
_LEAST_SHARE = -0.25
_LEAST_M = 0.5


@dataclass(frozen=True)
class Mark:
    """One effect on the scale of its panel, from 0 at the left to 1 at the right.

    Args:
        low, high: ends of the interval; where the effect is, where there is none.
        noise: what the irrelevant change does by itself, or the repeated question where that
            does more; None: there is no control.
        look: moved, seen or none.
    """

    at: float
    low: float
    high: float
    noise: float | None
    look: str
    tip: str


@dataclass(frozen=True)
class Row:
    """One cause: of the text the slot that it moves most.

    Args:
        note: that slot, or why there is none.
    """

    name: str
    path: Mark | None
    text: Mark | None
    note: str


@dataclass(frozen=True)
class Panel:
    """A scale: where 0 lies, and its ticks with their words."""

    zero: float
    ticks: tuple[tuple[float, str], ...]


@dataclass(frozen=True)
class Forest:
    """The plot of one model."""

    model: str
    rows: tuple[Row, ...]
    path: Panel
    text: Panel


_LOOKS = {Verdict.MOVED: "moved", Verdict.UNTESTED: "seen"}


def forests(effects: Iterable[Effect]) -> list[Forest]:
    """Return one forest plot per model."""
    return [_forest(model, [*of]) for model, of in groupby(effects, lambda e: e.model)]


def _forest(model: str, effects: Sequence[Effect]) -> Forest:
    paths = [e for e in effects if e.output == TRAJECTORY and e.size is not None]
    # Ends that are as good as 0 need no room of their own.
    reach = [
        round(v, 2)
        for e in paths
        for v in (e.size, e.interval.low, e.interval.high)
        if v is not None
    ]
    step_m = _step(max([_LEAST_M, *reach]) - min([0.0, *reach]))
    low_m, high_m = _ends([0.0, _LEAST_M, *reach], step_m)
    count = round((high_m - low_m) / step_m)

    def of_path(value: float) -> float:
        return (value - low_m) / (high_m - low_m)

    def of_text(value: float) -> float:
        return (max(value, _LEAST_SHARE) - _LEAST_SHARE) / (1.0 - _LEAST_SHARE)

    rows = []
    for _, group in groupby(effects, lambda e: e.cause):
        those = [*group]
        path = next((e for e in those if e.output == TRAJECTORY and e.size is not None), None)
        slot_effects = [
            e for e in those if e.output != TRAJECTORY and e.coverage and e.size is not None
        ]
        text = largest(slot_effects)
        rows.append(
            Row(
                those[0].cause.words,
                None if path is None else _mark(path, of_path),
                None if text is None else _mark(text, of_text),
                _text_label(those[0].cause, text),
            )
        )
    ticks_m = tuple(
        (of_path(low_m + k * step_m), f"{low_m + k * step_m:g}") for k in range(count + 1)
    )
    ticks = tuple((of_text(v), f"{v:g}") for v in (0.0, 0.25, 0.5, 0.75, 1.0))
    return Forest(model, tuple(rows), Panel(of_path(0.0), ticks_m), Panel(of_text(0.0), ticks))


def _text_label(cause: Cause, text: Effect | None) -> str:
    if text is not None:
        return text.output.replace("_", " ") if text.changed else ""
    return "given back" if cause.family == REASONING else "says nothing"


def _step(span: float) -> float:
    """Return a round step that divides a span into no more than six parts."""
    step = 0.1
    for factor in (2.0, 2.5, 2.0) * 6:
        if span / step <= 6.0:
            break
        step *= factor
    return step


def _ends(values: Sequence[float], step: float) -> tuple[float, float]:
    """Return whole steps around some values."""
    return step * (min(values) // step), -step * (-max(values) // step)


def _mark(effect: Effect, scale: Callable[[float], float]) -> Mark:
    size = effect.size or 0.0
    low = size if effect.interval.low is None else effect.interval.low
    high = size if effect.interval.high is None else effect.interval.high
    unit = " m" if effect.output == TRAJECTORY else " of label times"
    control, repeat = effect.changed_by_control, effect.changed_by_repeat
    beside = "no control" if control is None else f"the control by itself {control:.2f}{unit}"
    beside += "" if repeat is None else f", the question asked again {repeat:.2f}{unit}"
    noise = None if control is None else max(control, repeat or 0.0)
    return Mark(
        scale(size),
        scale(low),
        scale(high),
        None if noise is None else scale(noise),
        _LOOKS.get(effect.verdict, "none"),
        f"{effect.cause.words}, {effect.output.replace('_', ' ')}: {size:+.2f}{unit} "
        f"[{low:+.2f}, {high:+.2f}], {effect.verdict.value}; {beside}",
    )
