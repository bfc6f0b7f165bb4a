"""Limits of a session: what the states of one instant pass. The caller makes an end of it.

The predicates are in ``supervisor`` and in ssp_core.safety.limits; here is whose states they are
asked about, and when.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.fence import box_excess_m
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.core import supervisor
from ssp_scenario_manager.core.run import Run
from ssp_scenario_manager.core.supervisor import Violation, of_object

OWN_REASON_S = 0.1


def limits_passed(
    run: Run,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
    *,
    running: bool,
) -> list[Violation]:
    """Everything that is wrong at this instant, in the order in which it is announced.

    Args:
        run: the run, armed or begun.
        vut: newest state of the VUT; None when there was none.
        targets: newest states by id.
        now_ns: session time.
        running: the session is RUNNING, and so must be its objects.
    """
    spec, limits = run.spec, run.spec.limits
    breaks = run.take_breaks()
    found: list[Violation | None] = []
    present: list[ObjectState] = []
    # Who was never heard has been silent since the start, and may be still before it.
    since_ns = run.started_ns if run.started_ns is not None else now_ns
    early_s = spec.step_s if spec.mode == "realtime" else 0.0
    if vut is None:
        age_s = ns_to_seconds(now_ns - since_ns)
        found.append(supervisor.vut_silent(age_s, limits, now_ns))
    else:
        found.append(supervisor.vut_silent(ns_to_seconds(now_ns - vut.stamp_ns), limits, now_ns))
        found.append(supervisor.stamp_ahead(vut, now_ns, early_s, limits))
        present.append(vut)
    # A stamp from the future makes its state a jump, or one that stands; it is the reason.
    found += breaks
    for target in spec.targets:
        state = targets.get(target.id)
        last_ns = state.stamp_ns if state is not None else since_ns
        age_s = ns_to_seconds(now_ns - last_ns)
        silent = supervisor.object_silent(target.id, age_s, limits, now_ns)
        found.append(silent)
        if state is not None and silent is None:
            found.append(supervisor.stamp_ahead(state, now_ns, early_s, limits))
            found.append(_own_abort(run, state, now_ns))
            if running:
                found.append(_left_the_run(run, state, now_ns))
            present.append(state if vut is None else _at(state, vut.stamp_ns))
    found += violations(present, spec)
    for reference in run.answers.due:
        found.append(
            supervisor.ack_missing(reference.object_id, reference.dispatched_ns, now_ns, limits)
        )
    if run.started_ns is not None:
        found.append(supervisor.duration(run.started_ns, now_ns, limits))
    return [violation for violation in found if violation is not None]


def violations(everyone: Sequence[ObjectState], spec: RunSpec) -> list[Violation]:
    """All limits that the states of one instant pass, the gravest first.

    Args:
        everyone: states at one stamp, that of the VUT first where there is one.
        spec: gives limits and fence.
    """
    broken = [state for state in everyone if not state.is_finite]
    found = [of_object(judge.state_not_finite(s), s.object_id, s.stamp_ns) for s in broken]
    sound = [state for state in everyone if state.is_finite]
    limits = spec.limits
    for i, k in judge.near_pairs(sound, limits.separation_m):
        found.append(supervisor.too_near(sound[i], sound[k], limits))
    for state in sound:
        checks = [
            judge.over_speed(state, limits),
            judge.outside_geofence(box_excess_m(state.box, spec.geofence)),
            judge.localisation(state, limits),
        ]
        if state.reference_id and state.control_state is ControlState.RUNNING:
            # Who brakes for another reason leaves its reference, and brakes harder than one asks.
            checks.append(judge.over_acceleration(state, limits))
        found += [of_object(passed, state.object_id, state.stamp_ns) for passed in checks]
        found.append(supervisor.tracking_error(state, limits))
    real = [violation for violation in found if violation is not None]
    return sorted(real, key=lambda v: v.code != SafetyCode.COLLISION)


def collisions(
    run: Run, vut: ObjectState | None, targets: Mapping[str, ObjectState]
) -> list[Violation]:
    """While everything brakes there is one thing left to see: that two of us touch."""
    everyone = [vut] if vut is not None and vut.is_finite else []
    for target in run.spec.targets:
        state = targets.get(target.id)
        if state is not None and state.is_finite:
            everyone.append(state if vut is None else _at(state, vut.stamp_ns))
    limits = run.spec.limits
    found = [
        supervisor.too_near(everyone[i], everyone[k], limits)
        for i, k in judge.near_pairs(everyone, limits.separation_m)
    ]
    return [v for v in found if v is not None and v.code is SafetyCode.COLLISION]


def _at(state: ObjectState, stamp_ns: int) -> ObjectState:
    return state.extrapolated(stamp_ns) if state.is_finite else state


def _own_abort(run: Run, state: ObjectState, now_ns: int) -> Violation | None:
    """An object that stopped by itself; in a run it has time to say why, with a safety event."""
    violation = supervisor.own_abort(state)
    if violation is None or run.started_ns is None:
        return violation
    since = run.own_abort_ns.setdefault(state.object_id, now_ns)
    return violation if now_ns - since >= seconds_to_ns(OWN_REASON_S) else None


def _left_the_run(run: Run, state: ObjectState, now_ns: int) -> Violation | None:
    """An object that doesn't take part any more: started anew, or stopped by somebody else.

    It stands or will, but nobody knows why, and it takes no reference. ARMED is one that hasn't
    heard of the start yet, as long as it may have heard nothing and its states may be on their way.
    """
    control = state.control_state
    if control in (ControlState.RUNNING, ControlState.ABORTING) or run.started_ns is None:
        return None
    limits = run.spec.limits
    hears_s = limits.heartbeat_s + limits.state_age_s
    if control is ControlState.ARMED and now_ns - run.started_ns <= seconds_to_ns(hears_s):
        return None
    return supervisor.not_running(state)
