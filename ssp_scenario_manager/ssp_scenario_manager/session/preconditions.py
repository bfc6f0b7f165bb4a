"""What a session needs before each command, and whether everything is known to stand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import box_distance
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.fence import box_excess_m
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.session.link_quality import LinkEstimate
from ssp_scenario_manager.session.state_machine import SessionEvent

FRESH_S = 1.0
# What an object must report before a command.
_CONTROL = {
    SessionEvent.ARM: (ControlState.DISARMED, ControlState.ARMED),
    SessionEvent.START: (ControlState.ARMED,),
}
# How a refused command names a limit that is passed: whose, measured value, limit.
_WORDS = {
    SafetyCode.STATE_STALE: "the state of {who} is {value:.2f} s old, limit {limit:g} s",
    SafetyCode.LOCALISATION: "the position of {who} is uncertain by {value:.2f} m, "
    "limit {limit:g} m",
    SafetyCode.OUTSIDE_GEOFENCE: "{who} is outside the geofence by {value:.2f} m, limit 0 m",
    SafetyCode.CLOCK_OFFSET: "the clock of {who} is off by {value:.3f} s, limit {limit:g} s",
    SafetyCode.LINK_DELAY: "the link to {who} takes {value:.3f} s there and back, "
    "limit {limit:g} s",
}


@dataclass(frozen=True, slots=True)
class Facts:
    """What the node knows beside the states. Ages on the steady clock, s; inf is never.

    ``vut_refused`` is why no state is made of what the VUT's receiver says now; empty: one is, or
    nobody says.
    """

    recorder_ready: bool = False
    recorder_missing: tuple[str, ...] = ()
    recorder_lost: int = 0
    recorder_age_s: float = math.inf
    camera_age_s: float = math.inf
    vut_age_s: float = math.inf
    vut_refused: str = ""
    target_age_s: Mapping[str, float] = field(default_factory=dict)
    links: Mapping[str, LinkEstimate] = field(default_factory=dict)
    other_managers: int = 0
    foreign: str = ""

    @staticmethod
    def of_one_process(spec: RunSpec) -> Facts:
        """Of a session whose parts share one process: no links, one clock, nobody else."""
        ids = [target.id for target in spec.targets]
        return Facts(
            recorder_ready=True,
            recorder_age_s=0.0,
            camera_age_s=0.0,
            vut_age_s=0.0,
            target_age_s=dict.fromkeys(ids, 0.0),
            links=dict.fromkeys(ids, LinkEstimate(0.0, 0.0, 0.0)),
        )


def trigger_age_s(spec: RunSpec) -> float:
    """Triggers are judged on no state of the VUT that is older than this, s: two periods, unless
    the site has links that are slower than that."""
    given = spec.limits.trigger_age_s
    return 2.0 * spec.step_s if given is None else given


def missing_for(
    event: SessionEvent,
    spec: RunSpec,
    facts: Facts,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
) -> list[str]:
    """Everything that a command lacks, each with object, measured value and limit.

    Connecting needs a fresh state of everybody. Arming and starting need besides that everything is
    measured, recorded and in place; an object is DISARMED or ARMED for the one, ARMED for the
    other. The other commands need nothing of this.
    """
    if event is not SessionEvent.CONNECT and event not in _CONTROL:
        return []
    missing = []
    heard = [("the VUT", vut, facts.vut_age_s)]
    heard += [
        (t.id, targets.get(t.id), facts.target_age_s.get(t.id, math.inf)) for t in spec.targets
    ]
    for name, known, age_s in heard:
        if known is None or math.isinf(age_s):
            missing.append(f"no state of {name} arrives")
        elif not age_s <= FRESH_S:
            late = f"none for {age_s:.2f} s, limit {FRESH_S:g} s"
            missing.append(f"no state of {name} arrives: {late}")
    if facts.vut_refused:
        missing.append(f"the VUT's GNSS/INS gives no state: {facts.vut_refused}")
    if event is SessionEvent.CONNECT:
        return missing
    if facts.other_managers:
        who = f": {facts.foreign}" if facts.foreign else ""
        missing.append(f"{facts.other_managers} other managers, limit 0{who}")
    missing += _unrecorded(spec, facts)
    present = [(spec.vut, vut)] if vut is not None else []
    for target in spec.targets:
        missing += _unmeasured(target.id, facts.links.get(target.id, LinkEstimate()), spec.limits)
        if target.id in targets:
            present.append((target, targets[target.id]))
    for participant, state in present:
        wanted = _CONTROL[event]
        if participant is not spec.vut and state.control_state not in wanted:
            names = " or ".join(control.name for control in wanted)
            missing.append(f"{participant.id} is {state.control_state.name}, not {names}")
        missing += _not_in_place(participant, state, spec, now_ns)
    if vut is not None and spec.mode == "live":
        # The newest state may lie here for a period before the next one comes.
        age_s, limit_s = ns_to_seconds(now_ns - vut.stamp_ns) - spec.step_s, trigger_age_s(spec)
        if not age_s <= limit_s:
            missing.append(
                f"states of {spec.vut.id} are {age_s:.3f} s old when they come, limit for triggers "
                f"{limit_s:g} s (limits.trigger_age_s)"
            )
    return missing + _too_close([state for _, state in present], spec.limits)


def _said(who: str, *passed: LimitViolation | None) -> list[str]:
    return [
        _WORDS[one.code].format(who=who, value=one.measured, limit=one.limit)
        for one in passed
        if one is not None
    ]


def _unrecorded(spec: RunSpec, facts: Facts) -> list[str]:
    missing = []
    if not facts.recorder_age_s <= judge.RECORDER_SILENT_S:
        missing.append("the recorder is silent")
    elif not facts.recorder_ready:
        topics = ", ".join(facts.recorder_missing) or "its file is not open"
        missing.append(f"the recorder is not ready: {topics}")
    elif facts.recorder_lost:
        missing.append(f"the recorder has lost {facts.recorder_lost} messages, limit 0")
    if spec.camera is not None and not facts.camera_age_s <= judge.CAMERA_SILENT_S:
        missing.append("no camera frame arrives")
    return missing


def _unmeasured(object_id: str, link: LinkEstimate, limits: Limits) -> list[str]:
    """What is wrong with the link to an object."""
    if not link.age_s <= FRESH_S:
        return [
            f"clock offset and link delay of {object_id} are not measured: no answer to heartbeats"
            + (f" for {link.age_s:.2f} s, limit {FRESH_S:g} s" if math.isfinite(link.age_s) else "")
        ]
    offset = judge.clock_offset(link.offset_s, limits)
    return _said(object_id, offset, judge.link_delay(link.delay_s, limits))


def _not_in_place(
    participant: ParticipantSpec, state: ObjectState, spec: RunSpec, now_ns: int
) -> list[str]:
    """What is wrong with one object: its values, their age, its place, its motion."""
    name, limits, start = participant.id, spec.limits, participant.start
    if not state.is_finite:
        return [f"{name} has a state with a value that is no number"]
    age_s = ns_to_seconds(now_ns - state.stamp_ns)
    problems = _said(name, judge.state_stale(age_s, limits))
    if (ahead := judge.stamp_ahead(age_s, limits)) is not None:
        problems.append(
            f"the state of {name} is stamped {-age_s:.3f} s ahead of time, limit {ahead.limit:g} s"
        )
    problems += _said(name, judge.localisation(state, limits))
    away_m = math.hypot(state.x_m - start.x_m, state.y_m - start.y_m)
    if not away_m <= limits.start_region_m:
        problems.append(
            f"{name} is {away_m:.2f} m from its start, limit {limits.start_region_m:g} m"
        )
    if not abs(state.speed_mps) <= judge.STANDSTILL_MPS:
        problems.append(
            f"{name} moves at {state.speed_mps:.2f} m/s, limit {judge.STANDSTILL_MPS:g} m/s"
        )
    return problems + _said(name, judge.outside_geofence(box_excess_m(state.box, spec.geofence)))


def _too_close(everyone: list[ObjectState], limits: Limits) -> list[str]:
    """Pairs that would break the separation limit as soon as the run starts."""
    return [
        f"{state.object_id} is {box_distance(other.box, state.box):.2f} m from {other.object_id}, "
        f"limit {limits.separation_m:g} m"
        for i, state in enumerate(everyone)
        for other in everyone[:i]
        if state.is_finite and other.is_finite
        if judge.separation(other, state, limits) is not None
    ]


# Who is PRE_RUNNING has heard the start, and drives off next.
_MOVING = (ControlState.PRE_RUNNING, ControlState.RUNNING, ControlState.REMOTE_CONTROLLED)
# Whoever is armed hasn't heard of the abort yet, and would drive off if it were told to.
_NOT_ABORTED = (
    *_MOVING,
    ControlState.PRE_ARMING,
    ControlState.ARMED,
)


def stands(state: ObjectState, now_ns: int, aborting: bool = False) -> bool:
    """True when a fresh state says that the object stands and is not on the move.

    A stamp far ahead of the session's time is no fresh one either.

    Args:
        aborting: the session aborts, and the object must have heard it.
    """
    return (
        abs(state.speed_mps) <= judge.STANDSTILL_MPS
        and abs(ns_to_seconds(now_ns - state.stamp_ns)) <= FRESH_S
        and state.control_state not in (_NOT_ABORTED if aborting else _MOVING)
    )


def moving(
    spec: RunSpec,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
    *,
    armed: bool,
    aborting: bool = False,
    without: Sequence[str] = (),
) -> list[str]:
    """Who isn't known to stand, by id.

    Args:
        armed: the session has armed its objects. Before that, what was never heard need not prove
            that it stands.
        aborting: the session aborts; every object must have heard it.
        without: objects that are not asked, because nothing can be heard of them.
    """
    known = {spec.vut.id: vut}
    known |= {t.id: targets.get(t.id) for t in spec.targets if t.id not in without}
    return [
        object_id
        for object_id, state in known.items()
        if (armed if state is None else not stands(state, now_ns, aborting))
    ]
