"""The time at which a cell's fault strikes, and the comparison of its run with the matrix. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ssp_core.errors import InputError
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.safety.stopping import BRAKE_LAG_S, MARGIN_M, Stopping, stopping_of
from ssp_core.vocabulary import ControlState, Phase, SessionPhase
from ssp_scenario_manager.faults.evidence import Evidence, Stop, stop_of, touch
from ssp_scenario_manager.faults.matrix import OT, ExpectedOutcome, Row, Stage, Within
from ssp_scenario_manager.run.faults import RUNNER_KINDS

# A stamp before the fault by rounding alone.
_ROUNDING_S = 1e-6
# The answer may be heard before the fault, which comes on another topic.
_OTHER_TOPIC_S = 0.1
_ENDING = (SessionPhase.ABORTING, SessionPhase.ABORTED)


@dataclass(frozen=True, slots=True)
class Reaction:
    """The delay with which a fault was answered.

    Args:
        seconds: from the fault, or the motion that shows it, to the first sign of an answer; None
            when there was none.
        bound_s: that it may be at most.
        clock: session time, or the wall's.
        sign: what the answer was, for people.
    """

    seconds: float | None
    bound_s: float
    clock: Literal["session", "wall"]
    sign: str

    @property
    def is_within_bound(self) -> bool:
        return self.seconds is not None and self.seconds <= self.bound_s + _ROUNDING_S


@dataclass(frozen=True, slots=True)
class CellJudgement:
    """The outcome of a cell.

    Args:
        verdict: of the run.
        primary: its first reason, empty without one.
        reaction: None where there is nothing to react to.
        stops: of VUT and OTs by id; those that had to stop.
        findings: everything that is not as expected, as sentences; none when all is.
    """

    verdict: str
    primary: str
    reaction: Reaction | None
    stops: dict[str, Stop]
    findings: tuple[str, ...]

    @property
    def ok(self) -> bool:
        return not self.findings


def judge(
    expected: ExpectedOutcome,
    evidence: Evidence,
    index: int,
    leftovers: Sequence[str] = (),
) -> CellJudgement:
    """Judge one run.

    Args:
        expected: of the matrix's row.
        evidence: that the run left.
        index: of the cell's fault in the run file.
        leftovers: processes that outlived the run.
    """
    primary = evidence.reasons[0] if evidence.reasons else ""
    missed = missed_its_run(evidence, index)
    if missed:
        return CellJudgement(evidence.verdict, primary, None, {}, (missed, *leftovers))
    findings = [*evidence.problems, *leftovers]
    findings += _of_verdict(expected, evidence)
    findings += _of_names(expected, evidence)
    fault = evidence.spec.faults[index]
    instant = _Instant.of(expected, evidence, fault, index)
    reaction = _reaction(expected, evidence, instant)
    if reaction is not None and not reaction.is_within_bound:
        took = "never" if reaction.seconds is None else f"after {reaction.seconds:.3f} s"
        findings.append(f"reaction {took}, bound {reaction.bound_s:.3f} s ({reaction.clock})")
    stops = _stops(expected, evidence, instant)
    for object_id, stop in stops.items():
        if not stop.is_within_bound:
            findings.append(_text(object_id, stop))
    findings += _of_end(evidence)
    if evidence.lost and not expected.loses:
        findings.append(f"the recorder lost {evidence.lost} messages")
    if not expected.starts and evidence.time_of_phase(SessionPhase.RUNNING) is not None:
        findings.append("the session started")
    return CellJudgement(evidence.verdict, primary, reaction, stops, tuple(findings))


def missed_its_run(evidence: Evidence, index: int) -> str:
    """Describe a fault of the runner that didn't begin before its run was complete.

    A machine that keeps the runner waiting lets a session in lockstep end meanwhile. Such a run
    shows nothing of the fault.

    Returns:
        Empty for a fault that fell into the run, and for one that nodes or the recipe inject.
    """
    fault = evidence.spec.faults[index]
    ended_s = _phase_time_s(evidence, SessionPhase.STOPPING)
    if fault.kind not in RUNNER_KINDS - {"trigger_never"} or ended_s is None:
        return ""
    begun = next((n.t_s for n in evidence.faults if n.index == index and n.active), None)
    if begun is not None and begun < ended_s:
        return ""
    when = "never came" if begun is None else f"came at {begun:.2f} s"
    return f"not injected: {fault.kind} {when}, the run was complete at {ended_s:.2f} s"


def _text(object_id: str, stop: Stop) -> str:
    if stop.standstill_s is None:
        return f"{object_id} doesn't come to a standstill"
    return (
        f"{object_id} drives {stop.distance_m:.2f} m from {stop.speed_mps:.1f} m/s, bound "
        f"{stop.bound_m:.2f} m"
    )


def _of_verdict(expected: ExpectedOutcome, evidence: Evidence) -> list[str]:
    findings = []
    if evidence.verdict not in expected.verdicts:
        findings.append(f"verdict {evidence.verdict}, not {' or '.join(sorted(expected.verdicts))}")
    primary = evidence.reasons[0] if evidence.reasons else ""
    if evidence.verdict == "valid":
        findings += [f"a valid run has a reason: {primary}"] if primary else []
    elif not any(primary.startswith(beginning) for beginning in expected.primary):
        findings.append(f"first reason is {primary.splitlines()[0] if primary else 'missing'!r}")
    return findings


def _of_names(expected: ExpectedOutcome, evidence: Evidence) -> list[str]:
    """Return reasons and safety events that aren't expected."""
    explained = (*expected.primary, *expected.also)
    if not expected.starts:
        # Nor does a session that couldn't start end in order.
        explained = (*explained, "the recording ends while the session is")
    findings = [
        f"unexpected reason: {reason.splitlines()[0]}"
        for reason in evidence.reasons[1:]
        if not any(reason.startswith(beginning) for beginning in explained)
    ]
    limits = {beginning.partition(":")[0] for beginning in explained}
    for note in evidence.safety:
        if note.limit_name not in limits:
            text = f"unexpected safety event: {note.limit_name} {note.object_id} at {note.t_s:.2f}"
            findings.append(f"{text} s, seen by {note.source}")
    return findings


def _of_end(evidence: Evidence) -> list[str]:
    findings = []
    sizes = {p.id: p.size for p in (evidence.spec.vut, *evidence.spec.targets)}
    for object_id, track in sorted(evidence.truth.items()):
        if not track.stands_at_the_end():
            findings.append(f"{object_id} moves at the end, {track.speed_mps[-1]:.2f} m/s")
        outside = track.farthest_outside_m(sizes[object_id], evidence.spec.geofence)
        if outside > 0.0:
            findings.append(f"{object_id} was {outside:.2f} m outside the geofence")
    tracks = sorted(evidence.truth.items())
    for i, (a, ours) in enumerate(tracks):
        findings += [
            f"{a} and {b} touch"
            for b, theirs in tracks[i + 1 :]
            if touch(ours, sizes[a], theirs, sizes[b])
        ]
    return findings


@dataclass(frozen=True, slots=True)
class _Instant:
    """The instant from which time and distance are counted.

    Args:
        t_s: session time, None where it isn't known.
        wall_s: the runner's, None where it isn't known.
    """

    t_s: float | None
    wall_s: float | None

    @classmethod
    def of(
        cls, expected: ExpectedOutcome, evidence: Evidence, fault: Fault, index: int
    ) -> _Instant:
        begun = next((n for n in evidence.faults if n.index == index and n.active), None)
        wall_s = begun.wall_s if begun is not None else None
        if wall_s is None:
            word = f"{index} {fault.kind}"
            wall_s = next((h.wall_s for h in evidence.runner_events if h.name == word), None)
        t_s = begun.t_s if begun is not None else None
        if fault.kind == "kill":
            last = evidence.last_state_s or {}
            if fault.target == "scenario_manager":
                t_s = evidence.last_heartbeat_s
            elif fault.target == "object_target" and last:
                t_s = min(last.values())
        elif fault.kind == "trigger_never":
            t_s = evidence.time_of_phase(SessionPhase.RUNNING)
        if expected.since == "motion" and t_s is not None:
            track = evidence.truth.get(fault.target)
            t_s = track.first_motion_s(t_s) if track is not None else None
        elif expected.since == "trigger" and t_s is not None:
            t_s = max(t_s, evidence.triggers[0]) if evidence.triggers else None
        return cls(t_s, wall_s)


def _phase_time_s(evidence: Evidence, phase: SessionPhase) -> float | None:
    """Return when the session came to a phase, by the bag, or as the runner heard it."""
    bag_time_s = evidence.time_of_phase(phase)
    if bag_time_s is not None:
        return bag_time_s
    runner_events = evidence.runner_events
    return next(
        (h.t_s for h in runner_events if h.kind == "session" and h.name == phase.name), None
    )


def _signs(evidence: Evidence, since_s: float, limits: Sequence[str]) -> list[tuple[float, str]]:
    """Return (session time, what) of everything that answers a fault."""
    signs = [
        (note.t_s, f"{note.limit_name} seen by {note.source}")
        for note in evidence.safety
        if note.t_s >= since_s - _ROUNDING_S and (not limits or note.limit_name in limits)
    ]
    if limits:
        return signs
    signs += [(t, f"session {s.name}") for t, s in evidence.session if s in _ENDING]
    if not any(fault.kind == "clock_step" for fault in evidence.spec.faults):
        signs += [
            (t, f"{object_id} ABORTING")
            for t, object_id, state in evidence.own_states
            if state is ControlState.ABORTING
        ]
    return [sign for sign in signs if sign[0] >= since_s - _ROUNDING_S]


def _reaction(expected: ExpectedOutcome, evidence: Evidence, instant: _Instant) -> Reaction | None:
    bound = expected.bound(evidence.spec.mode)
    if bound is None or (bound.clock == "wall" and not evidence.has_wall):
        return None
    bound_s = bound.seconds(evidence.spec)
    if bound.clock == "wall":
        if instant.wall_s is None:
            return Reaction(None, bound_s, "wall", "")
        words = {s.name for s in _ENDING} if not expected.signs else set()
        answers = [
            (h.wall_s, f"session {h.name}" if h.kind == "session" else f"{h.name} by {h.detail}")
            for h in evidence.runner_events
            if h.wall_s >= instant.wall_s - _OTHER_TOPIC_S
            and (h.name in words or (h.kind == "safety" and _counts(h.name, expected)))
        ]
        start: float | None = instant.wall_s
    else:
        start = instant.t_s
        answers = _signs(evidence, start, expected.signs) if start is not None else []
    if not answers and expected.may_end_first and _is_complete(evidence):
        return None
    if not answers or start is None:
        return Reaction(None, bound_s, bound.clock, "")
    when, what = min(answers)
    return Reaction(max(when - start, 0.0), bound_s, bound.clock, what)


def _is_complete(evidence: Evidence) -> bool:
    """Tell whether the run was complete, by any of its records."""
    return _phase_time_s(evidence, SessionPhase.FINISHED) is not None


def _counts(limit_name: str, expected: ExpectedOutcome) -> bool:
    return not expected.signs or limit_name in expected.signs


def _stops(expected: ExpectedOutcome, evidence: Evidence, instant: _Instant) -> dict[str, Stop]:
    run = evidence.spec
    if not expected.stops or evidence.time_of_phase(SessionPhase.RUNNING) is None:
        return {}
    if expected.since == "abort":
        start, blind_s = _phase_time_s(evidence, SessionPhase.ABORTING), 0.0
    else:
        start, blind_s = instant.t_s, _blind_s(expected, run)
    if start is None:
        return {}
    return {
        object_id: stop_of(track, start, blind_s, _stopping(run, object_id))
        for object_id, track in sorted(evidence.truth.items())
    }


def _blind_s(expected: ExpectedOutcome, run: RunSpec) -> float:
    blind: Within | None = expected.blind or expected.bound(run.mode)
    if blind is None or blind.clock == "wall":
        return 0.0
    return blind.seconds(run)


def _stopping(run: RunSpec, object_id: str) -> Stopping:
    """Return how an object stops: targets as they declare, the simulated VUT as its driver does."""
    for target in run.targets:
        if target.id == object_id:
            return stopping_of(target.cls, run.limits, run.step_s)
    return Stopping(
        2.0 * run.step_s + BRAKE_LAG_S[run.vut.cls],
        run.driver.comfortable_deceleration_mps2,
        MARGIN_M,
    )


BEFORE_TRIGGER_S = 1.0
INTO_CONFLICT_S = 0.3
_MOVES_MPS = 0.1


@dataclass(frozen=True, slots=True)
class Nominal:
    """The undisturbed run.

    Args:
        trigger_s: dispatch of the manoeuvre.
        conflict_s: start of the conflict.
        end_s: the session begins to stop.
        moves: whether the initiator moves at each stage's instant; armed: with the start.
    """

    trigger_s: float
    conflict_s: float
    end_s: float
    moves: dict[Stage, bool]


def nominal_of(evidence: Evidence) -> Nominal:
    """Return times of a run without faults.

    Raises:
        InputError: it wasn't valid, so that its times mean nothing.
    """
    conflict = evidence.phase_at(Phase.CONFLICT)
    end = evidence.time_of_phase(SessionPhase.STOPPING)
    if evidence.verdict != "valid" or not evidence.triggers or conflict is None or end is None:
        why = evidence.reasons[0] if evidence.reasons else "a phase is missing"
        raise InputError(
            f"is {evidence.verdict} without any fault: {why}",
            field="nominal run",
            remedy="`ssp run` the scenario until it is valid",
        )
    trigger = evidence.triggers[0]
    times = Nominal(trigger, conflict, end, {})
    track = evidence.truth[evidence.spec.initiator_id]
    step_s = evidence.spec.step_s
    target = next(t for t in evidence.spec.targets if t.id == evidence.spec.initiator_id)
    moves = {Stage.ARMED: target.approach is not None}
    for stage in (Stage.BEFORE, Stage.AFTER, Stage.CONFLICT):
        moves[stage] = track.speed_at(at_s(stage, times, step_s) or 0.0) > _MOVES_MPS
    return Nominal(trigger, conflict, end, moves)


def at_s(stage: Stage, nominal: Nominal, step_s: float) -> float | None:
    """Return session time at which a fault of a stage strikes, on a step; None: armed."""
    if stage is Stage.ARMED:
        return None
    if stage is Stage.BEFORE:
        at = nominal.trigger_s - BEFORE_TRIGGER_S
    elif stage is Stage.AFTER:
        halfway = 0.5 * (nominal.trigger_s + nominal.conflict_s)
        at = max(halfway, nominal.trigger_s + step_s)
    else:
        at = min(nominal.conflict_s + INTO_CONFLICT_S, nominal.end_s - step_s)
    return round(max(at, step_s) / step_s) * step_s


def fault_of(row: Row, stage: Stage, nominal: Nominal, run: RunSpec) -> Fault:
    """Return the fault of one cell."""
    when = at_s(stage, nominal, run.step_s)
    return Fault(
        kind=row.kind,
        target=run.initiator_id if row.target == OT else row.target,
        at_s=None if when is None else round(when, 6),
        duration_s=row.duration_s,
        value=row.value,
    )
