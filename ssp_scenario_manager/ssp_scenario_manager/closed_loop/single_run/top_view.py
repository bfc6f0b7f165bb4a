"""One driven run from above and over time: planned, effective, driven, the object, the contact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.files.writing import write_text
from ssp_core.motion.encounter import encounter
from ssp_core.motion.reference import PLAN, Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.latency import parse_latency
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ElapsedTime
from ssp_core.run_file.values import Point
from ssp_core.templates import templates
from ssp_core.world.driver import DriveMode
from ssp_core.world.plant import StepReport
from ssp_core.world.road_drawing import RoadView, drawing_of
from ssp_scenario_manager.closed_loop.answers import KeptAnswers
from ssp_scenario_manager.closed_loop.contact import Contact, until
from ssp_scenario_manager.closed_loop.single_run.before import Before
from ssp_scenario_manager.closed_loop.single_run.single import driven_run_summary
from ssp_scenario_manager.closed_loop.starts.start import path_of
from ssp_scenario_manager.compile.task import EVENT_FILE, TASK_FOLDER
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.run.in_process import InProcessResult, Record

VIEW_FILE = "top_view.svg"
_CHART_PX, _LEFT_PX, _BOTTOM_PX, _KEY_PX = 190.0, 46.0, 34.0, 34.0
# Outlines of the moving bodies are drawn so often.
_OUTLINE_S = 1.0
_GAP_POINTS, _GAP_PX = 12, 40.0
_PLAN_S = 2.0  # of a plan, as much as each must have (METHOD 8.4)
_PLAN_STEPS = 5  # from one drawn point of a plan to the next


@dataclass(frozen=True, slots=True)
class Line:
    """A line or outline of the picture, with the points as SVG has them."""

    kind: str
    points: str


@dataclass(frozen=True, slots=True)
class Gap:
    """The gap at which a trigger fired, along the VUT's lane, beside the interval of K*'s box."""

    points: str
    x: float
    y: float
    words: str


@dataclass(frozen=True, slots=True)
class Mark:
    """An instant of the chain on the time axis."""

    name: str
    x: float
    row: int


def summary_with_view(
    folder: Path,
    model_answers: KeptAnswers | None,
    before: Before | None,
    run: RunSpec,
    result: InProcessResult,
    record: Record,
) -> tuple[dict[str, Any], str]:
    """Return what ``result.json`` says of who drove, and leave the view from above in a folder.

    Beside it stands why the run isn't the one that it must be; empty: it is.

    Args:
        folder: takes a model's answers too.
        model_answers: answers of the run before, which the driver repeats; None: it was asked.
        before: what the run was, where it is driven again; None: it is held against nothing.
        run: as it was driven.
        result: of the run.
        record: of the run.
    """
    summary, contact = driven_run_summary(
        run, result, record, folder=folder, model_answers=model_answers
    )
    if not summary:
        return {}, ""
    driven, why = (summary["driven"], "") if before is None else before.judge(summary["driven"])
    leave_view(folder, run, record, driven, contact)
    return summary | {"driven": driven}, why


def leave_view(
    folder: Path, run: RunSpec, record: Record, summary: dict[str, Any], contact: Contact | None
) -> None:
    """Write the view from above into the folder of a run; its task there has the distances.

    Args:
        folder: of the run.
        run: as for ``top_view``.
        record: as for ``top_view``.
        summary: as for ``top_view``.
        contact: as for ``top_view``.
    """
    task = folder / TASK_FOLDER / EVENT_FILE
    event = load_event(str(task))[0] if task.is_file() else None
    write_text(folder / VIEW_FILE, top_view(run, record, summary, contact, event))


def _latency(summary: dict[str, Any]) -> str:
    if summary["measured"] is None:
        return parse_latency(summary["latency"]).words
    half_s = summary["measured"]["p50_s"]
    return "L measured, " + ("nothing asked" if half_s is None else f"median {half_s:.2f} s")


def top_view(
    run: RunSpec,
    record: Record,
    summary: dict[str, Any],
    contact: Contact | None,
    event: Event | None = None,
) -> str:
    """Return the picture of a driven run as SVG.

    Args:
        run: as it was driven.
        record: of the run.
        summary: what ``result.json`` says under ``driven``.
        contact: of the run's outcome.
        event: K*; None: no distance of its box is drawn.
    """
    if run.driven is None:
        raise ValueError("the run has no driver of its VUT")
    end_s = min(run.driven.end_s, float(summary["outcome_s"]) + 1.0)
    led = until(record.reports, run.driven.hand_over_s, end_s)
    plans = [
        r.drive.effective for r in led if r.drive is not None and r.drive.effective is not None
    ]
    paths = {i: [s for r in led for s in r.truths if s.object_id == i] for i in run.object_ids}
    points = [(s.x_m, s.y_m) for states in paths.values() for s in states]
    view = RoadView(run.road, points)
    drawing = drawing_of(run)
    lines = [Line(f"road {one.kind}", view.svg(one.points)) for one in drawing.road_lines]
    lines += [Line("planned", view.svg(_places(plan))) for plan in plans if plan.purpose == PLAN]
    lines += [Line("effective", view.svg(part)) for part in _effective(plans, end_s)]
    for object_id, states in paths.items():
        kind = "driven" if object_id == run.vut.id else "object"
        lines.append(Line(kind, view.svg([(s.x_m, s.y_m) for s in states])))
        lines += [
            Line(f"body {kind}", view.svg(state.box.corners())) for state in _each_second(states)
        ]
    if contact is not None:
        at_ns = contact.stamp_ns
        touching = [s for states in paths.values() for s in states if s.stamp_ns == at_ns]
        lines += [
            Line("contact", view.svg(state.box.corners()))
            for state in touching
            if state.object_id in (run.vut.id, contact.other)
        ]
    chart = _Chart(run.driven.hand_over_s, end_s, paths, view.height_px + _KEY_PX)
    return (
        templates(Path(__file__).parent)
        .get_template("top_view.svg.j2")
        .render(
            title=f"{run.scenario}: {summary['driver']}, {_latency(summary)}: "
            f"{summary['outcome']} at {summary['outcome_s']:.2f} s, {summary['why']}",
            width=view.width_px,
            height=view.height_px + _KEY_PX + _CHART_PX + _BOTTOM_PX,
            view_height=view.height_px,
            lines=lines,
            gap=None if event is None else _gap_of(run, event, led, view),
            chart=chart,
            speeds=[
                Line("driven" if i == run.vut.id else "object", chart.speed(states))
                for i, states in paths.items()
            ]
            + [Line("planned", chart.planned(plan)) for plan in plans if plan.purpose == PLAN],
            unled=chart.spans(
                [r.now_ns for r in led if r.drive is not None and _is_unled(r.drive.mode)],
                run.step_s,
            ),
            marks=chart.marks({**summary["chain"], "outcome_s": summary["outcome_s"]}),
        )
    )


def _gap_of(run: RunSpec, event: Event, led: Sequence[StepReport], view: RoadView) -> Gap | None:
    """Return the gap of K*'s trigger at its time; None where it is of another quantity, or closed.

    The time is the twin's, so that the gap of a VUT that does as its twin lies in K*'s interval.
    """
    condition, trigger = run.triggers[0].condition, event.constraints.trigger
    if trigger.quantity != "relative_distance" or not isinstance(condition, ElapsedTime):
        return None
    at_ns = seconds_to_ns(condition.after_s)
    truths = next((r.truths for r in led if r.now_ns >= at_ns), ())
    by_id = {state.object_id: state for state in truths}
    vut, other = by_id.get(run.vut.id), by_id.get(run.triggers[0].object_id)
    if vut is None or other is None:
        return None
    path = path_of(run)
    gap_m = encounter(vut, other, path).gap_m
    if not 0.0 <= gap_m < math.inf:
        return None
    front_m = path.project_beyond(vut.x_m, vut.y_m)[0] + vut.size.front_m
    x, y = path.places(np.linspace(front_m, front_m + gap_m, _GAP_POINTS))
    # Beside the bodies, which would cover it.
    places = [
        (px, py + _GAP_PX) for px, py in view.points(list(zip(x.tolist(), y.tolist(), strict=True)))
    ]
    middle = places[len(places) // 2]
    words = f"gap at the trigger {gap_m:.1f} m"
    if isinstance(trigger.below, Interval):
        span = trigger.below.si
        words += f", K* {span.low:g} to {span.high:g} m"
    return Gap(" ".join(f"{px:.1f},{py:.1f}" for px, py in places), *middle, words)


def _is_unled(mode: DriveMode) -> bool:
    return mode in (DriveMode.STALE, DriveMode.FALLBACK)


def _places(plan: Reference) -> list[Point]:
    t, x, y = plan.columns[:3]
    indices = np.flatnonzero(t <= _PLAN_S)[::_PLAN_STEPS]
    return list(zip(x[indices].tolist(), y[indices].tolist(), strict=True))


def _effective(plans: Sequence[Reference], end_s: float) -> list[list[Point]]:
    """Return of each plan the part that was tracked: from its dispatch until the next one's."""
    parts: list[list[Point]] = []
    if not plans:
        return parts
    ends_ns = [plan.dispatched_ns for plan in plans[1:]] + [seconds_to_ns(end_s)]
    for plan, end_ns in zip(plans, ends_ns, strict=True):
        t, x, y = plan.columns[:3]
        since = ns_to_seconds(plan.dispatched_ns - plan.execute_at_ns)
        upto = ns_to_seconds(end_ns - plan.execute_at_ns)
        times = np.linspace(since, max(upto, since), 12)
        places = zip(np.interp(times, t, x).tolist(), np.interp(times, t, y).tolist(), strict=True)
        parts.append(list(places))
    return parts


def _each_second(states: Sequence[ObjectState]) -> list[ObjectState]:
    if not states:
        return []
    first_ns, samples, due_s = states[0].stamp_ns, [], 0.0
    for state in states:
        if ns_to_seconds(state.stamp_ns - first_ns) >= due_s - 1e-9:
            samples.append(state)
            due_s += _OUTLINE_S
    return samples


class _Chart:
    """Speeds over session time, below the view from above; px of the whole picture."""

    def __init__(
        self,
        begin_s: float,
        end_s: float,
        paths: dict[str, list[ObjectState]],
        top_px: float,
    ) -> None:
        self._begin_s, self._end_s = begin_s, end_s
        fastest = max((s.speed_mps for states in paths.values() for s in states), default=1.0)
        self._most_mps = max(5.0, 5.0 * np.ceil(fastest / 5.0 + 0.2))
        self.left, self.right = _LEFT_PX, RoadView.width_px - 24.0
        self.top, self.bottom = top_px, top_px + _CHART_PX

    def _x(self, at_s: float) -> float:
        share = (at_s - self._begin_s) / max(self._end_s - self._begin_s, 1e-9)
        return self.left + share * (self.right - self.left)

    def _y(self, speed_mps: float) -> float:
        return self.bottom - speed_mps / float(self._most_mps) * (self.bottom - self.top)

    def _line(self, pairs: Sequence[tuple[float, float]]) -> str:
        return " ".join(f"{self._x(t):.1f},{self._y(v):.1f}" for t, v in pairs)

    def speed(self, states: Sequence[ObjectState]) -> str:
        """Return the speeds of an object."""
        return self._line([(ns_to_seconds(s.stamp_ns), s.speed_mps) for s in states[::5]])

    def planned(self, plan: Reference) -> str:
        """Return the speeds of a plan, as far as each must reach."""
        t, v = plan.columns[0], plan.columns[4]
        begin_s = ns_to_seconds(plan.execute_at_ns)
        inside = (t <= _PLAN_S) & (begin_s + t <= self._end_s) & (begin_s + t >= self._begin_s)
        pairs = zip((begin_s + t[inside]).tolist(), v[inside].tolist(), strict=True)
        return self._line(list(pairs)[::_PLAN_STEPS])

    def spans(self, stamps_ns: Sequence[int], step_s: float) -> list[tuple[float, float]]:
        """Return left end and width of the spans that these steps make."""
        spans_s: list[list[float]] = []
        for stamp_ns in stamps_ns:
            at_s = ns_to_seconds(stamp_ns)
            if spans_s and at_s - spans_s[-1][1] <= 1.5 * step_s:
                spans_s[-1][1] = at_s
            else:
                spans_s.append([at_s, at_s])
        return [(self._x(a), self._x(b + step_s) - self._x(a)) for a, b in spans_s]

    def marks(self, instants: dict[str, float | None]) -> list[Mark]:
        """Return the instants of the chain, in rows so that their names don't cover each other."""
        names = {"observable_s": "T_obs"}
        there = [(s, k) for k, s in instants.items() if s is not None and s >= self._begin_s]
        return [
            Mark(names.get(key, key.removesuffix("_s")), self._x(min(at_s, self._end_s)), k % 3)
            for k, (at_s, key) in enumerate(sorted(there))
        ]

    @property
    def times(self) -> list[tuple[str, float]]:
        """Ticks of the time axis."""
        first = int(np.ceil(self._begin_s))
        return [(f"{t}", self._x(t)) for t in range(first, int(self._end_s) + 1)]

    @property
    def speeds(self) -> list[tuple[str, float]]:
        """Ticks of the speed axis."""
        return [(f"{v}", self._y(v)) for v in range(0, int(self._most_mps) + 1, 5)]
