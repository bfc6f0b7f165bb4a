"""The judgement of each instant of a run: limits passed, triggers, phases, adaptation, the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.state import ObjectState
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, Phase
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.dispatches import CannotFire
from ssp_scenario_manager.session.limits import (
    Violation,
    kept_apart,
    of_object,
    silent,
    stamp_ahead,
    too_near,
    violations,
)
from ssp_scenario_manager.session.run import Run
from ssp_scenario_manager.triggers.conditions import Snapshot


def begin(run: Run, now_ns: int) -> list[outbox.Outgoing]:
    """Start the run's clock and send all objects on their approach; one without it stands."""
    run.start(now_ns)
    began = PhaseBegan(now_ns, Phase.APPROACH, "start of the run")
    return [began, *run.dispatches.approaches(now_ns)]


def judge_triggers(
    run: Run, vut: ObjectState, targets: Mapping[str, ObjectState], now_ns: int
) -> list[outbox.Outgoing]:
    """Evaluate the run's open triggers at a state of the VUT that they weren't judged at yet.

    Args:
        run: the run.
        vut: the state, with finite values.
        targets: newest states, by id.
        now_ns: session time, that of a dispatch.
    """
    if not run.triggers.is_in_time(vut, now_ns):
        return []
    age_ns = seconds_to_ns(run.spec.limits.state_age_s)
    snapshot = Snapshot(vut, targets, run.path, age_ns, run.event.phase_starts)
    decided: list[outbox.Outgoing] = []
    for trigger, firing in run.triggers.firings(snapshot):
        try:
            decided += run.dispatches.fire(trigger, firing, targets, now_ns)
        except CannotFire as error:
            why = f"trigger {trigger.id} fired, but {error}"
            run.triggers.failed = missing(run, trigger.object_id, now_ns, why)
            break
    return decided


def overdue(run: Run, now_ns: int) -> Violation | None:
    """Find an event that should have been resolved by now."""
    if run.started_ns is None or run.event.resolved_ns is not None or run.spec.driven is not None:
        return None
    if ns_to_seconds(now_ns - run.started_ns) < run.spec.end.at_latest_s:
        return None
    why = f"phase reached: {run.event.phase.name.lower()}"
    if run.triggers.late_states:
        why += f"; {run.triggers.late_states} states of the VUT came too late for triggers"
    # A trigger that wasn't judged in time may be all that was missing.
    return replace(missing(run, "", now_ns, why), by_us=run.triggers.late_states > 0)


def missing(run: Run, object_id: str, now_ns: int, why: str) -> Violation:
    """Return the violation that the event doesn't happen any more."""
    elapsed_s, limit_s = run.elapsed_s(now_ns), run.spec.end.at_latest_s
    return Violation(SafetyCode.EVENT_MISSING, object_id, elapsed_s, limit_s, now_ns, why)


def limits_passed(
    run: Run,
    vut: ObjectState | None,
    targets: Mapping[str, ObjectState],
    now_ns: int,
    *,
    running: bool,
) -> list[Violation]:
    """List all passed limits of this instant, in the order in which they are announced.

    Args:
        run: the run.
        vut: newest state of the VUT; None when there was none.
        targets: newest states, by id.
        now_ns: session time.
        running: the session is RUNNING, and so must be its objects.
    """
    spec, limits = run.spec, run.spec.limits
    breaks = run.history.take_breaks()
    findings: list[Violation | None] = []
    present: list[ObjectState] = []
    # Who was never heard has been silent since the start, and may be still before it.
    started = run.started_ns is not None
    since_ns = run.started_ns if run.started_ns is not None else now_ns
    early_s = spec.step_s if spec.mode == "realtime" else 0.0

    def unheard(code: SafetyCode, who: str, last_ns: int, limit_s: float) -> Violation | None:
        return silent(code, who, ns_to_seconds(now_ns - last_ns), limit_s, now_ns)

    last_ns = since_ns if vut is None else vut.stamp_ns
    findings.append(unheard(SafetyCode.VUT_SILENT, "vut", last_ns, limits.state_age_s))
    if vut is not None:
        findings.append(stamp_ahead(vut, now_ns, early_s, limits))
        present.append(vut)
    # A stamp from the future makes its state a jump, or one that stands; it is the reason.
    findings += breaks
    for target in spec.targets:
        state = targets.get(target.id)
        last_ns = since_ns if state is None else state.stamp_ns
        late = unheard(SafetyCode.OBJECT_SILENT, target.id, last_ns, limits.state_age_s)
        findings.append(late)
        if state is not None and late is None:
            findings.append(stamp_ahead(state, now_ns, early_s, limits))
            findings.append(run.local_stops.own_abort(state, now_ns, started=started))
            findings.append(run.local_stops.unexplained(state, now_ns))
            if running:
                findings.append(_left_the_run(run, state, now_ns))
            present.append(state if vut is None else _at(state, vut.stamp_ns))
    findings += violations(present, spec, run.history.is_well_inside)
    for reference in run.dispatches.due:
        who, sent_ns = reference.object_id, reference.dispatched_ns
        findings.append(unheard(SafetyCode.ACK_MISSING, who, sent_ns, limits.ack_s))
    if run.started_ns is not None:
        passed = judge.duration(ns_to_seconds(now_ns - run.started_ns), limits)
        findings.append(of_object(passed, "", now_ns))
    return [violation for violation in findings if violation is not None]


def collisions(
    run: Run, vut: ObjectState | None, targets: Mapping[str, ObjectState], now_ns: int
) -> list[Violation]:
    """Find the one thing left to see while everything brakes: that two of us touch.

    Where a silent one is now isn't known.

    Args:
        run: the run.
        vut: newest state of the VUT; None when there was none.
        targets: newest states, by id.
        now_ns: session time.
    """
    oldest_ns = now_ns - seconds_to_ns(run.spec.limits.state_age_s)
    states = [targets[target.id] for target in run.spec.targets if target.id in targets]
    states = [state for state in states if state.stamp_ns >= oldest_ns]
    if vut is not None and vut.stamp_ns >= oldest_ns:
        states = [vut, *(_at(state, vut.stamp_ns) for state in states)]
    near = too_near(
        kept_apart([state for state in states if state.is_finite], run.spec), run.spec.limits
    )
    return [violation for violation in near if violation.code is SafetyCode.COLLISION]


def _at(state: ObjectState, stamp_ns: int) -> ObjectState:
    is_led_on = state.stamp_ns != stamp_ns and state.is_finite
    return state.extrapolated(stamp_ns) if is_led_on else state


def _left_the_run(run: Run, state: ObjectState, now_ns: int) -> Violation | None:
    """Find an object that left the run: started anew, or stopped from elsewhere.

    It stands or will, for an unknown reason, and it takes no reference. ARMED is one that hasn't
    heard of the start yet, as long as it may have heard nothing and its states may be on their way;
    PRE_RUNNING is on its way to RUNNING, as objects of ISO 22133 may be for as long.
    """
    control = state.control_state
    if control in (ControlState.RUNNING, ControlState.ABORTING) or run.started_ns is None:
        return None
    limits = run.spec.limits
    hears_s = limits.heartbeat_s + limits.state_age_s
    begins = control in (ControlState.ARMED, ControlState.PRE_RUNNING)
    if begins and now_ns - run.started_ns <= seconds_to_ns(hears_s):
        return None
    detail = f"it is {control.name} while the session runs"
    return Violation(SafetyCode.OBJECT_ABORTED, state.object_id, 1.0, 0.0, state.stamp_ns, detail)


def watch_adaptation(run: Run, vut: ObjectState, now_ns: int) -> list[outbox.Outgoing]:
    """Judge the dispatched manoeuvres on the VUT's newest state, and adapt them.

    A passing order that can't be kept ends the run: nothing that happens afterwards would be the
    event.

    Args:
        run: the run.
        vut: state of the VUT that hasn't been judged yet.
        now_ns: session time, that of a dispatch.
    """
    facts: list[outbox.Outgoing] = []
    for adapted, decision in run.dispatches.adaptations.judge(run.spec, run.path, vut, now_ns):
        object_id, pace = adapted.target.id, decision.pace
        if decision.wrong_order:
            facts.append(missing(run, object_id, now_ns, decision.wrong_order))
            continue
        if pace is not None:
            facts.append(run.dispatches.adapt(adapted, pace, now_ns))
        if decision.note:
            facts.append(outbox.Note(now_ns, f"{object_id}: {decision.note}"))
    facts += [outbox.Note(now_ns, text) for text in run.dispatches.adaptations.take_notes()]
    return facts
