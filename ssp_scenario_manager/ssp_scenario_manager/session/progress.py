"""The judgement of each instant of a run: limits passed, triggers, phases, adaptation, the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import boxes_overlap
from ssp_core.motion.event import PhaseBegan, next_phase
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import TriggerSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, Phase
from ssp_scenario_manager.dispatch import references
from ssp_scenario_manager.dispatch.planned_motion import play
from ssp_scenario_manager.dispatch.references import ADAPTED
from ssp_scenario_manager.session import outbox
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
from ssp_scenario_manager.triggers.evaluator import Firing, TriggerWatch


def begin(run: Run, now_ns: int) -> list[outbox.Outgoing]:
    """Start the run's clock and send all objects on their approach; one without it stands."""
    run.started_ns = now_ns
    run.watches = [TriggerWatch(t, run.path, now_ns) for t in run.spec.triggers]
    facts: list[outbox.Outgoing] = [PhaseBegan(now_ns, Phase.APPROACH, "start of the run")]
    for target in run.spec.targets:
        if target.approach is not None:
            address = run.address(target.id, "approach", now_ns, references.APPROACH_LEAD_S)
            facts.append(run.send(references.approach_reference(address, target.approach)))
    return facts


class CannotFire(Exception):
    """The reason why a trigger that fired has no reference to send."""


def fire(
    run: Run,
    trigger: TriggerSpec,
    firing: Firing,
    targets: Mapping[str, ObjectState],
    now_ns: int,
) -> tuple[Reference, outbox.Triggered]:
    """Return the reference that a trigger sends, and its decision record.

    Raises:
        CannotFire: the object was never heard, or can't drive the manoeuvre from where it is.
    """
    target = next(t for t in run.spec.targets if t.id == trigger.object_id)
    if target.id not in targets:
        raise CannotFire(f"{target.id} was never heard")
    address = run.address(target.id, "manoeuvre", now_ns, trigger.lead_time_s)
    current = run.references.get(target.id)
    # Looked up only where it is needed: it may have to be decoded first.
    state = targets[target.id].extrapolated(firing.fired_ns) if current is None else None
    try:
        reference = references.manoeuvre_reference(
            address, trigger.manoeuvre, state, current, target.approach
        )
    except ValueError as error:
        raise CannotFire(f"its manoeuvre can't be driven: {error}") from error
    run.send(reference)
    run.adaptations.fire(trigger, reference, current)
    record = outbox.Triggered(
        stamp_ns=firing.fired_ns,
        trigger_id=trigger.id,
        condition=firing.condition,
        threshold=firing.threshold,
        samples=firing.samples,
        crossing_ns=firing.crossing_ns,
        dispatched_ns=now_ns,
        object_ids=(reference.object_id,),
        reference_ids=(reference.reference_id,),
    )
    return reference, record


def judge_phases(
    run: Run, vut: ObjectState, targets: Mapping[str, ObjectState]
) -> list[outbox.Outgoing]:
    """Judge the phases on the states of the VUT and of the OT whose manoeuvre is the event."""
    state = targets.get(run.spec.initiator_id)
    if state is None:
        return []
    run.phase_watch, began = next_phase(
        run.phase_watch,
        vut,
        state.extrapolated(vut.stamp_ns),
        run.path,
        run.spec.thresholds,
        run.spec.observable,
    )
    if began is None:
        return []
    run.phase_starts[began.phase] = began.stamp_ns
    if began.phase is Phase.RESOLUTION:
        run.resolved_ns = vut.stamp_ns
    return [began]


# A driven run goes on for so long after the VUT's first contact (METHOD 8.2).
AFTER_CONTACT_S = 1.0


def note_contact(run: Run, vut: ObjectState, targets: Mapping[str, ObjectState]) -> None:
    """Remember the first contact of a driven VUT, which ends its run."""
    if run.spec.driven is None or run.contact_ns is not None:
        return
    others = [_at(state, vut.stamp_ns) for state in targets.values() if state.is_finite]
    if vut.is_finite and any(boxes_overlap(vut.box, other.box) for other in others):
        run.contact_ns = vut.stamp_ns


def is_complete(run: Run, now_ns: int) -> bool:
    """Tell whether the event was resolved long enough ago.

    Conditions of K* don't end a driven run: it ends after its first contact, or at T_end.
    """
    if run.spec.driven is not None:
        touched_ns = run.contact_ns
        if touched_ns is not None and now_ns - touched_ns >= seconds_to_ns(AFTER_CONTACT_S):
            return True
        return run.elapsed_s(now_ns) >= run.spec.driven.end_s - 1e-9
    wait_ns = seconds_to_ns(run.spec.end.after_resolution_s)
    return run.resolved_ns is not None and now_ns - run.resolved_ns >= wait_ns


def overdue(run: Run, now_ns: int) -> Violation | None:
    """Find an event that should have been resolved by now."""
    if run.started_ns is None or run.resolved_ns is not None or run.spec.driven is not None:
        return None
    if ns_to_seconds(now_ns - run.started_ns) < run.spec.end.at_latest_s:
        return None
    why = f"phase reached: {run.phase_watch.phase.name.lower()}"
    if run.late_vut_states:
        why += f"; {run.late_vut_states} states of the VUT came too late for triggers"
    # A trigger that wasn't judged in time may be all that was missing.
    return replace(missing(run, "", now_ns, why), by_us=run.late_vut_states > 0)


def missing(run: Run, object_id: str, now_ns: int, why: str) -> Violation:
    """Return the violation that the event doesn't happen any more."""
    elapsed_s = ns_to_seconds(now_ns - run.started_ns) if run.started_ns is not None else 0.0
    limit_s = run.spec.end.at_latest_s
    return Violation(SafetyCode.EVENT_MISSING, object_id, elapsed_s, limit_s, now_ns, why)


OWN_REASON_S = 0.1


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
    breaks = run.take_breaks()
    found: list[Violation | None] = []
    present: list[ObjectState] = []
    # Who was never heard has been silent since the start, and may be still before it.
    since_ns = run.started_ns if run.started_ns is not None else now_ns
    early_s = spec.step_s if spec.mode == "realtime" else 0.0

    def unheard(code: SafetyCode, who: str, last_ns: int, limit_s: float) -> Violation | None:
        return silent(code, who, ns_to_seconds(now_ns - last_ns), limit_s, now_ns)

    last_ns = since_ns if vut is None else vut.stamp_ns
    found.append(unheard(SafetyCode.VUT_SILENT, "vut", last_ns, limits.state_age_s))
    if vut is not None:
        found.append(stamp_ahead(vut, now_ns, early_s, limits))
        present.append(vut)
    # A stamp from the future makes its state a jump, or one that stands; it is the reason.
    found += breaks
    for target in spec.targets:
        state = targets.get(target.id)
        last_ns = since_ns if state is None else state.stamp_ns
        late = unheard(SafetyCode.OBJECT_SILENT, target.id, last_ns, limits.state_age_s)
        found.append(late)
        if state is not None and late is None:
            found.append(stamp_ahead(state, now_ns, early_s, limits))
            found.append(_own_abort(run, state, now_ns))
            found.append(_unexplained(run, state, now_ns))
            if running:
                found.append(_left_the_run(run, state, now_ns))
            present.append(state if vut is None else _at(state, vut.stamp_ns))
    found += violations(present, spec, run.is_well_inside)
    for reference in run.answers.due:
        who, sent_ns = reference.object_id, reference.dispatched_ns
        found.append(unheard(SafetyCode.ACK_MISSING, who, sent_ns, limits.ack_s))
    if run.started_ns is not None:
        passed = judge.duration(ns_to_seconds(now_ns - run.started_ns), limits)
        found.append(of_object(passed, "", now_ns))
    return [violation for violation in found if violation is not None]


def collisions(
    run: Run, vut: ObjectState | None, targets: Mapping[str, ObjectState]
) -> list[Violation]:
    """Find the one thing left to see while everything brakes: that two of us touch."""
    known = [targets[target.id] for target in run.spec.targets if target.id in targets]
    if vut is not None:
        known = [vut, *(_at(state, vut.stamp_ns) for state in known)]
    near = too_near(
        kept_apart([state for state in known if state.is_finite], run.spec), run.spec.limits
    )
    return [violation for violation in near if violation.code is SafetyCode.COLLISION]


def _at(state: ObjectState, stamp_ns: int) -> ObjectState:
    is_led_on = state.stamp_ns != stamp_ns and state.is_finite
    return state.extrapolated(stamp_ns) if is_led_on else state


def _own_abort(run: Run, state: ObjectState, now_ns: int) -> Violation | None:
    """Find an object that stopped by itself; in a run it may first say why, by a safety event."""
    if state.control_state is not ControlState.ABORTING:
        return None
    since = run.own_abort_ns.setdefault(state.object_id, now_ns)
    if run.started_ns is not None and now_ns - since < seconds_to_ns(OWN_REASON_S):
        return None
    return Violation(
        SafetyCode.OBJECT_ABORTED, state.object_id, 1.0, 0.0, state.stamp_ns, "local stop"
    )


def _unexplained(run: Run, state: ObjectState, now_ns: int) -> Violation | None:
    """Find an unexplained refusal of an object that isn't running, after its time to explain it."""
    refused = run.unexplained.get(state.object_id)
    if refused is None or state.control_state is ControlState.ABORTING:
        return None
    waited_s = ns_to_seconds(now_ns - refused.stamp_ns)
    return None if waited_s < OWN_REASON_S else refused


def _left_the_run(run: Run, state: ObjectState, now_ns: int) -> Violation | None:
    """Find an object that left the run: started anew, or stopped from elsewhere.

    It stands or will, but nobody knows why, and it takes no reference. ARMED is one that hasn't
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
    for adapted, decision in run.adaptations.judge(run.spec, run.path, vut, now_ns):
        object_id, pace = adapted.target.id, decision.pace
        if decision.wrong_order:
            facts.append(missing(run, object_id, now_ns, decision.wrong_order))
            continue
        if pace is not None:
            lead_s = ns_to_seconds(pace.start_ns - now_ns)
            address = run.address(object_id, ADAPTED, now_ns, lead_s)
            points = play(adapted.planned_motion.columns, pace)
            run.adaptations.send(address.reference_id, adapted, pace)
            facts.append(run.send(references.reference(address, points)))
        if decision.note:
            facts.append(outbox.Note(now_ns, f"{object_id}: {decision.note}"))
    facts += [outbox.Note(now_ns, text) for text in run.adaptations.take_notes()]
    return facts
