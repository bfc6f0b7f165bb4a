"""The outcome of a driven run, exactly one, by the earliest deciding fact (METHOD 8.5)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import Verdict
from ssp_core.world.driver import DriveMode, GivenAnswer, RecordedAnswer, sees_frames
from ssp_core.world.plant import StepReport
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.closed_loop.answers import answers_of
from ssp_scenario_manager.closed_loop.contact import (
    Contact,
    contact_words,
    first_contact,
    first_touch,
    until,
)
from ssp_scenario_manager.closed_loop.outcomes.evaded import Twin, evaded
from ssp_scenario_manager.closed_loop.starts.start import path_of
from ssp_scenario_manager.closed_loop.values import EPSILON_S, LIMITS
from ssp_scenario_manager.run.in_process import InProcessResult, Record
from ssp_scenario_manager.run.kept_session import KeptSession
from ssp_scenario_manager.run.result import rounded

# In the order that decides between facts of one step.
HARNESS = "harness"
DECIDED = (HARNESS, "died", "collision", "struck", "left_road", "fence")
AT_THE_END = ("fallback", "evaded", "avoided")
OUTCOMES = (*DECIDED, *AT_THE_END)
# Instants of a run, in session time: T_obs, the first frame after it, the question about that frame
# or a later one, its answer, the step at which that is effective, the response.
CHAIN = ("observable_s", "frame_s", "asked_s", "answered_s", "effective_s", "response_s")
# Of measured latencies, and of their parts.
_FIGURES = ("p50_s", "p99_s", "encoding_p50_s", "transport_and_inference_p50_s", "parsing_p50_s")
_UNLED = (DriveMode.FALLBACK, DriveMode.STALE)


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of one run, and what it was decided by.

    Args:
        kind: of OUTCOMES.
        at_s: session time of the deciding fact; T_end where none came before it.
        why: the fact, with its values.
        contact: the first one, with scenery only where it decides; None: there was none.
        response_s: first step after T_obs from which the VUT departs from its twin.
        unled_s: fallback and stale plans between T_obs and T_end less 5 s.
        starved: the plans ended before 2L plus a frame period.
    """

    kind: str
    at_s: float
    why: str
    contact: Contact | None
    response_s: float | None
    unled_s: float
    starved: bool


@dataclass(frozen=True, slots=True)
class DriverRun:
    """One drive of a driver on a start.

    Args:
        session: what it recorded; None: it wasn't kept.
    """

    run: RunSpec
    driven: Driven
    result: InProcessResult
    record: Record
    outcome: Outcome
    session: KeptSession | None = None

    @property
    def answers(self) -> tuple[RecordedAnswer, ...]:
        """Answers of a model, with which it is driven again."""
        return answers_of(self.driven, self.record)


def outcome_of(
    run: RunSpec, driven: Driven, result: InProcessResult, record: Record, twin: Twin
) -> Outcome:
    """Return the outcome of a driven run.

    Args:
        run: as it was driven.
        driven: its driver.
        result: of the run.
        record: of the run.
        twin: true states of the twin's VUT by stamp, ns.
    """
    led = until(record.reports, driven.hand_over_s, driven.end_s)
    contact = first_touch(run, led)
    response_s = first_response_s(run, driven, record, twin)
    unled_s = _unled_s(run, driven, led)
    facts = [
        fact
        for fact in (
            _harness(run, driven, result, record, twin),
            _died(record),
            _touched(run, led, contact),
            left_road(run, led),
            _fence(result),
        )
        if fact is not None and fact[0] <= driven.end_s + EPSILON_S
    ]
    # What is known of a question that is open at T_end, and would be known to all later.
    if not facts and (dies := _dies(led)):
        facts.append((driven.end_s, "died", dies))
    last_s = ns_to_seconds(led[-1].now_ns) if led else driven.hand_over_s
    if not facts and last_s < driven.end_s - run.step_s - EPSILON_S:
        facts.append((last_s, HARNESS, f"the run ended at {last_s:.2f} s, before T_end"))
    if facts:
        at_s, kind, why = min(facts, key=lambda fact: (fact[0], DECIDED.index(fact[1])))
    else:
        at_s = driven.end_s
        kind, why = _at_the_end(run, driven, record, twin, response_s, unled_s)
    if kind not in ("collision", "struck"):
        # What a VUT touches beside the road once it has left it says nothing about the event.
        contact = first_contact(led, run.vut.id)
    return Outcome(kind, at_s, why, contact, response_s, unled_s, is_starved(driven, record))


Fact = tuple[float, str, str]


def _harness(
    run: RunSpec, driven: Driven, result: InProcessResult, record: Record, twin: Twin
) -> Fact | None:
    at_ns = seconds_to_ns(driven.hand_over_s)
    vut = next((s for s in record.truths(run.vut.id) if s.stamp_ns == at_ns), None)
    twin_state = twin.get(at_ns)
    if vut is None or twin_state is None:
        reason = "; ".join(result.reasons) or "the run ended before the hand-over"
        return driven.hand_over_s, HARNESS, reason
    off_mps = abs(vut.speed_mps - twin_state.speed_mps)
    off_m = math.hypot(vut.x_m - twin_state.x_m, vut.y_m - twin_state.y_m)
    if not (off_mps <= LIMITS.handed_mps and off_m <= LIMITS.handed_m):
        why = f"at the hand-over {off_mps:.2f} m/s and {off_m:.2f} m off the twin"
        return driven.hand_over_s, HARNESS, why
    broken = result.verdict is Verdict.INVALID_HARNESS and _died(record) is None
    if not broken:
        return None
    at_s = result.session_s if result.aborted_ns is None else ns_to_seconds(result.aborted_ns)
    return min(at_s, driven.end_s), HARNESS, "; ".join(result.reasons)


def _died(record: Record) -> Fact | None:
    for report in record.reports:
        if report.drive is not None and report.drive.died:
            return ns_to_seconds(report.now_ns), "died", report.drive.died
    return None


def _dies(led: Sequence[StepReport]) -> str:
    """Return why the driver ends with the question that is open at the end of the run."""
    last = led[-1].drive if led else None
    return "" if last is None else last.dies


def _touched(run: RunSpec, led: Sequence[StepReport], contact: Contact | None) -> Fact | None:
    if contact is None:
        return None
    kind = "collision" if contact.vut_mps > LIMITS.standing_mps else "struck"
    return contact.at_s, kind, contact_words(run, led, contact)


def _fence(result: InProcessResult) -> Fact | None:
    ended = (Verdict.FAILED_SAFETY, Verdict.ABORTED)
    if result.aborted_ns is None or result.verdict not in ended:
        return None
    return ns_to_seconds(result.aborted_ns), "fence", "; ".join(result.reasons)


# -- the carriageway -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Carriageway:
    """Lateral bounds in the road's frame: of all lanes, and of those of opposite direction."""

    right_m: float
    left_m: float
    opposite: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, road: Road, own_m: float) -> _Carriageway:
        own = min(road.lanes, key=lambda lane: abs(lane.y_m - own_m)).direction
        opposite = sorted(
            (lane.y_m - lane.width_m / 2, lane.y_m + lane.width_m / 2)
            for lane in road.lanes
            if lane.direction != own
        )
        joined: list[tuple[float, float]] = []
        for low, high in opposite:
            if joined and low <= joined[-1][1] + 1e-6:
                joined[-1] = joined[-1][0], high
            else:
                joined.append((low, high))
        return cls(road.right_edge_m, road.left_edge_m, tuple(joined))

    def holds(self, offset_m: float) -> bool:
        """Tell whether a place is on the carriageway; NaN, where the road has none, isn't."""
        return self.right_m - 1e-9 <= offset_m <= self.left_m + 1e-9

    def words_beside(self, offsets: Sequence[float]) -> str:
        """Say how far the farthest of some places is beside."""
        outside_m = max(self.right_m - min(offsets), max(offsets) - self.left_m)
        if not all(map(math.isfinite, offsets)):
            return "a corner where the road has no coordinates"
        return f"a corner {outside_m:.2f} m beside the carriageway"

    def depth_m(self, offset_m: float) -> float:
        """Return how deep a place lies in lanes of opposite direction, 0 outside."""
        depths = (min(offset_m - low, high - offset_m) for low, high in self.opposite)
        return max([0.0, *depths])


# The outline of a connecting road leaves its true edges by less than this.
_EDGE_ERROR_M = 0.01
# What connecting roads enclose is paved, unless a circle of this radius has room in it: an island.
_ISLAND_M = 1.5


@dataclass(frozen=True, slots=True)
class _Surface:
    """The junction's own surface, for a route that turns: the union of its connecting roads.

    Such a route has its own lane alone, and a body's corners swing out of it.
    """

    outline: Any

    @classmethod
    def of(cls, road: Road) -> _Surface:
        import shapely  # type: ignore[import-untyped]  # slow to import, no types

        turns = len(road.lanes) == 1
        strips = []
        for one in road.junction if turns else ():
            if one.junction_at == "both":
                right_m, left_m = one.right_edge_m, one.left_edge_m
                line = ReferenceLine.of_road(one)
                middle = line.path(0.0, one.length_m, 0.5 * (right_m + left_m), _EDGE_ERROR_M)
                half_m = 0.5 * (left_m - right_m) + _EDGE_ERROR_M
                strips.append(shapely.LineString(middle).buffer(half_m, cap_style="flat"))
        union = shapely.union_all(strips)
        rings = [ring for part in shapely.get_parts(union) for ring in part.interiors]
        holes = [shapely.Polygon(ring) for ring in rings]
        paved = [hole for hole in holes if hole.buffer(-_ISLAND_M).is_empty]
        return cls(shapely.union_all([union, *paved]))

    def holds(self, vut: ObjectState, way: _Carriageway, offsets: Sequence[float]) -> bool:
        """Tell whether all corners that are beside the carriageway are in the junction."""
        import shapely  # slow to import

        beside = [
            corner
            for corner, offset_m in zip(vut.box.corners(), offsets, strict=True)
            if not way.holds(offset_m)
        ]
        return bool(shapely.covers(self.outline, shapely.MultiPoint(beside)))


def left_road(run: RunSpec, led: Sequence[StepReport]) -> Fact | None:
    """Find the first step in which the VUT has left the road, or gone back.

    Args:
        run: has road and path.
        led: reports from the hand-over on.
    """
    line = ReferenceLine.of_road(run.road)
    start = run.vut.start
    way = _Carriageway.of(run.road, line.to_local(start.x_m, start.y_m)[1])
    path = path_of(run)
    surface: _Surface | None = None
    first_m: float | None = None
    wrong_since_s: float | None = None
    for at_s, vut in _states(led, run.vut.id):
        offsets = line.to_local_many(np.array(vut.box.corners()))[:, 1].tolist()
        if not all(map(way.holds, offsets)):
            surface = surface or _Surface.of(run.road)
            if not surface.holds(vut, way, offsets):
                return at_s, "left_road", way.words_beside(offsets)
        depth_m = max(way.depth_m(offset) for offset in offsets)
        if depth_m > LIMITS.opposite_m:
            wrong_since_s = at_s if wrong_since_s is None else wrong_since_s
            if at_s - wrong_since_s > LIMITS.opposite_s + EPSILON_S:
                return at_s, "left_road", f"{depth_m:.2f} m in a lane of opposite direction"
        else:
            wrong_since_s = None
        station_m, _ = path.project_beyond(vut.x_m, vut.y_m)
        first_m = station_m if first_m is None else first_m
        if station_m - first_m < -LIMITS.back_m:
            return at_s, "left_road", f"{first_m - station_m:.2f} m backwards"
    return None


def _states(reports: Sequence[StepReport], vut_id: str) -> Iterator[tuple[float, ObjectState]]:
    for report in reports:
        yield (
            ns_to_seconds(report.now_ns),
            next(s for s in report.truths if s.object_id == vut_id),
        )


# -- against the twin ------------------------------------------------------------------------------


def first_response_s(run: RunSpec, driven: Driven, record: Record, twin: Twin) -> float | None:
    """Return the first step after T_obs from which the VUT departs from its twin for 0.3 s.

    It is looked for up to the twin's contact or resolution.
    """
    if driven.observable_s is None:
        return None
    path, since_s = path_of(run), None
    for vut in record.truths(run.vut.id):
        at_s, twin_state = ns_to_seconds(vut.stamp_ns), twin.get(vut.stamp_ns)
        if at_s <= driven.observable_s + EPSILON_S or twin_state is None:
            continue
        # Behind its contact or resolution the twin is braked by its session.
        if at_s > driven.end_s - LIMITS.after_s + EPSILON_S:
            break
        if not _departs(path, vut, twin_state):
            since_s = None
            continue
        since_s = at_s if since_s is None else since_s
        if at_s - since_s >= LIMITS.response_s - EPSILON_S:
            return since_s
    return None


def _departs(path: Polyline, vut: ObjectState, twin_state: ObjectState) -> bool:
    if abs(vut.speed_mps - twin_state.speed_mps) > LIMITS.response_mps:
        return True
    (_, own_m), (_, its_m) = path.project_all_beyond(
        [(vut.x_m, vut.y_m), (twin_state.x_m, twin_state.y_m)]
    )
    return abs(own_m - its_m) > LIMITS.response_m


def _unled_s(run: RunSpec, driven: Driven, led: Sequence[StepReport]) -> float:
    if driven.observable_s is None:
        return 0.0
    end_s = driven.end_s - LIMITS.after_s
    steps = [
        report
        for report in until(led, driven.observable_s, end_s)
        if report.drive is not None and report.drive.mode in _UNLED
    ]
    return len(steps) * run.step_s


def _at_the_end(
    run: RunSpec,
    driven: Driven,
    record: Record,
    twin: Twin,
    response_s: float | None,
    unled_s: float,
) -> tuple[str, str]:
    if unled_s > LIMITS.fallback_s:
        return "fallback", f"no plan of its own for {unled_s:.2f} s"
    mode = _mode_at(record, response_s)
    if mode in _UNLED:
        return "fallback", f"the first response, at {response_s:.2f} s, lies in {mode.value}"
    if why := evaded(run, driven, record, twin):
        return "evaded", why
    return "avoided", "no contact until T_end"


def _mode_at(record: Record, at_s: float | None) -> DriveMode | None:
    for report in record.reports:
        if at_s is not None and abs(ns_to_seconds(report.now_ns) - at_s) < EPSILON_S:
            return None if report.drive is None else report.drive.mode
    return None


def is_starved(driven: Driven, record: Record) -> bool:
    """Tell whether a plan ended before the next one could be effective: 2L and a frame period."""
    for report in record.reports:
        answered = None if report.drive is None else report.drive.effective_answer
        if answered is None or answered.refused or answered.answer.trajectory is None:
            continue
        needed_s = 2.0 * answered.latency_s + driven.frame_period_s
        if answered.answer.trajectory.t_s[-1] < needed_s - EPSILON_S:
            return True
    return False


# -- what result.json says -------------------------------------------------------------------------


def chain_of(driven: Driven, record: Record, outcome: Outcome) -> dict[str, float | None]:
    """Return the chain from T_obs to the first response, in session time, by CHAIN's names.

    The frame is asked about later than it is there while another question is open. Without a
    question after T_obs there is neither frame nor answer.
    """
    chain: dict[str, float | None] = dict.fromkeys(CHAIN)
    chain["observable_s"], chain["response_s"] = driven.observable_s, outcome.response_s
    number = 0
    for report in record.reports:
        drive, at_s = report.drive, ns_to_seconds(report.now_ns)
        if drive is None or driven.observable_s is None:
            continue
        question, answered = drive.question, drive.effective_answer
        if not number and question is not None and at_s >= driven.observable_s - EPSILON_S:
            number, chain["asked_s"] = question.number, at_s
            periods = math.ceil(driven.observable_s / driven.frame_period_s - 1e-6)
            chain["frame_s"] = periods * driven.frame_period_s
        if number and answered is not None and answered.number == number:
            chain["answered_s"] = ns_to_seconds(answered.stamp_ns) + answered.latency_s
            chain["effective_s"] = at_s
    return {name: rounded(value) for name, value in chain.items()}


def severity_of(outcome: Outcome, v_r_mps: float | None) -> float | None:
    """Return 5 if avoided, 4 max(0, 1 - v_i / v_r) for a collision, else None (METHOD 8.8)."""
    if v_r_mps is None:
        return None
    if outcome.kind == "avoided":
        return 5.0
    if outcome.kind != "collision" or outcome.contact is None:
        return None
    return 4.0 * max(0.0, 1.0 - outcome.contact.relative_mps / v_r_mps)


def measured_of(driven: Driven, record: Record) -> dict[str, Any] | None:
    """Return the measured latencies of a run and their parts, medians in s; None: L was given."""
    if not driven.latency.measured:
        return None
    drives = [report.drive for report in record.reports if report.drive is not None]
    answers = [drive.answer for drive in drives if drive.answer is not None]
    return figures_of(answers, driven.latency.seconds)


def figures_of(answers: Sequence[GivenAnswer], bound_s: float) -> dict[str, Any]:
    """Return the number of measured latencies, and their quantiles and medians of parts, s.

    All but the number are None where nothing was asked.

    Args:
        answers: of drivers, and how these ended.
        bound_s: that was declared.
    """
    # A driver that can't be loaded isn't asked.
    latencies = [one.latency for one in answers if one.latency.total_ns or not one.ended]
    if not latencies:
        figures = dict.fromkeys(_FIGURES)
        return {"answers": 0, "bound_s": bound_s, **figures, "over_bound": 0}
    parts = [(p.total_ns, p.encoding_ns, p.inference_ns, p.parsing_ns) for p in latencies]
    seconds = np.array(parts, dtype=np.float64) / 1e9
    total, *rest = (round(float(value), 6) for value in np.median(seconds, axis=0))
    p99_s = round(float(np.quantile(seconds[:, 0], 0.99)), 6)
    return {
        "answers": len(latencies),
        "bound_s": bound_s,
        **dict(zip(_FIGURES, (total, p99_s, *rest), strict=True)),
        "over_bound": int((seconds[:, 0] > bound_s).sum()),
    }


def driven_summary(
    driven: Driven, record: Record, outcome: Outcome, v_r_mps: float | None
) -> dict[str, Any]:
    """Return what ``result.json`` says of a driven run."""
    drives = [report.drive for report in record.reports if report.drive is not None]
    answered = [drive.effective_answer for drive in drives if drive.effective_answer is not None]
    refused = [one for one in answered if one.refused]
    return {
        "driver": driven.driver,
        "options": driven.options,
        "latency": str(driven.latency),
        "measured": measured_of(driven, record),
        "frames": sees_frames(driven.driver),
        "start": driven.start,
        "left_out": driven.left_out,
        "hand_over_s": driven.hand_over_s,
        "end_s": driven.end_s,
        "outcome": outcome.kind,
        "outcome_s": rounded(outcome.at_s),
        "why": outcome.why,
        "v_i_mps": None if outcome.contact is None else rounded(outcome.contact.relative_mps),
        "v_r_mps": rounded(v_r_mps),
        "severity": rounded(severity_of(outcome, v_r_mps)),
        "chain": chain_of(driven, record, outcome),
        "states_sha256": record.sha256,
        "unled_s": rounded(outcome.unled_s),
        "starved": outcome.starved,
        "questions": sum(drive.question is not None for drive in drives),
        "answers": len(answered),
        "refused": [
            {"stamp_s": ns_to_seconds(one.stamp_ns), "why": one.refused} for one in refused[:20]
        ],
        "refused_count": len(refused),
    }
