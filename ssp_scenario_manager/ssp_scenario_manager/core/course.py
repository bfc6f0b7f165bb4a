"""The event of a run while it happens: approaches, triggers, phases, and the event's end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.core import dispatch, outbox, phases
from ssp_scenario_manager.core.readiness import trigger_age_s
from ssp_scenario_manager.core.run import Run
from ssp_scenario_manager.core.scene import Scene
from ssp_scenario_manager.core.supervisor import Violation
from ssp_scenario_manager.core.triggers import Firing, OpenWatches, TriggerWatch


def begin(run: Run, now_ns: int) -> list[outbox.Outgoing]:
    """Starts the run's clock and sends everybody on their approach; who has none stands."""
    run.started_ns = now_ns
    run.watches = OpenWatches(TriggerWatch(t, run.path, now_ns) for t in run.spec.triggers)
    facts: list[outbox.Outgoing] = [outbox.PhaseBegan(now_ns, Phase.APPROACH, "start of the run")]
    for target in run.spec.targets:
        if target.approach is not None:
            address = run.address(target.id, "approach", now_ns, dispatch.APPROACH_LEAD_S)
            facts.append(run.send(dispatch.approach_reference(address, target.approach)))
    return facts


def judge_triggers(
    run: Run, vut: ObjectState, targets: Mapping[str, ObjectState], now_ns: int
) -> Iterator[outbox.Outgoing]:
    """What the triggers ask for at the VUT's newest state, if that is to be judged at all.

    Each fact is given as soon as it is known, so that a reference can go out before its decision
    record is written and before the other triggers are judged.

    It isn't when it was judged before, when it is too old, or when it can't be believed, so that
    the step that follows ends the run. A trigger that can't be driven is remembered for that step,
    since a limit that is passed at the same instant is the graver reason.

    Args:
        run: the run.
        vut: newest state of the VUT.
        targets: newest states by id.
        now_ns: session time, that of the dispatch.
    """
    if vut.stamp_ns <= run.triggers_judged_ns or run.has_breaks or not vut.is_finite:
        return
    run.triggers_judged_ns = vut.stamp_ns
    if now_ns - vut.stamp_ns > seconds_to_ns(trigger_age_s(run.spec)):
        run.late_vut_states += 1
        return
    for fact in watch_triggers(run, vut, targets, now_ns):
        if isinstance(fact, Violation):
            run.failed_trigger = fact
            return
        yield fact


def watch_triggers(
    run: Run, vut: ObjectState, targets: Mapping[str, ObjectState], now_ns: int
) -> Iterator[outbox.Outgoing | Violation]:
    """Judges the triggers on the VUT's newest state, and sends what they ask for.

    They come before the phases, since every moment until their dispatch counts: a trigger that
    waits for a phase fires with the state after the one that confirmed it.

    Args:
        run: the run.
        vut: state of the VUT that hasn't been judged yet.
        targets: newest states by id.
        now_ns: session time, that of the dispatch.
    """
    age_ns = seconds_to_ns(run.spec.limits.state_age_s)
    scene = Scene(vut, targets, run.path, age_ns, run.phase_starts)
    for watch in run.watches.at(scene.stamp_ns):
        firing = watch.observe(scene)
        if firing is not None:
            yield from _fire(run, watch, firing, targets, now_ns)


def _fire(
    run: Run,
    watch: TriggerWatch,
    firing: Firing,
    targets: Mapping[str, ObjectState],
    now_ns: int,
) -> Iterator[outbox.Outgoing | Violation]:
    trigger = watch.spec
    target = next(t for t in run.spec.targets if t.id == trigger.object_id)
    if target.id not in targets:
        why = f"trigger {trigger.id} fired, but {target.id} was never heard"
        yield _missing(run, target.id, now_ns, why)
        return
    address = run.address(target.id, "manoeuvre", now_ns, trigger.lead_time_s)
    current = run.references.get(target.id)
    # Looked up only where it is needed: it may have to be decoded first.
    state = targets[target.id].extrapolated(firing.fired_ns) if current is None else None
    try:
        reference = run.ready.take(trigger, address, current) or dispatch.manoeuvre_reference(
            address,
            trigger.manoeuvre,
            state,
            current,
            target.approach,
        )
    except ValueError as error:
        why = f"trigger {trigger.id} fired, but its manoeuvre can't be driven: {error}"
        yield _missing(run, target.id, now_ns, why)
        return
    yield run.send(reference)
    run.adaptations.fire(trigger, reference, current)
    yield outbox.Triggered(
        stamp_ns=firing.fired_ns,
        trigger_id=trigger.id,
        condition=firing.condition,
        threshold=firing.threshold,
        samples=firing.samples,
        crossing_ns=firing.crossing_ns,
        references=(reference,),
    )


def watch_phases(
    run: Run, vut: ObjectState, targets: Mapping[str, ObjectState]
) -> list[outbox.Outgoing]:
    """Judges the phases on the states of the VUT and of the OT whose manoeuvre is the event."""
    state = targets.get(run.spec.initiator_id)
    if state is None:
        return []
    run.phase_watch, began = phases.watch_phases(
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
    return [outbox.PhaseBegan(began.stamp_ns, began.phase, began.evidence)]


def is_complete(run: Run, now_ns: int) -> bool:
    """The event was resolved long enough ago."""
    wait_ns = seconds_to_ns(run.spec.end.after_resolution_s)
    return run.resolved_ns is not None and now_ns - run.resolved_ns >= wait_ns


def overdue(run: Run, now_ns: int) -> Violation | None:
    """The event should have been resolved by now."""
    if run.started_ns is None or run.resolved_ns is not None:
        return None
    if ns_to_seconds(now_ns - run.started_ns) < run.spec.end.at_latest_s:
        return None
    why = f"phase reached: {run.phase_watch.phase.name.lower()}"
    if run.late_vut_states:
        why += f"; {run.late_vut_states} states of the VUT came too late for triggers"
    # A trigger that wasn't judged in time may be all that was missing.
    return replace(_missing(run, "", now_ns, why), by_us=run.late_vut_states > 0)


def _missing(run: Run, object_id: str, now_ns: int, why: str) -> Violation:
    elapsed_s = ns_to_seconds(now_ns - run.started_ns) if run.started_ns is not None else 0.0
    limit_s = run.spec.end.at_latest_s
    return Violation(SafetyCode.EVENT_MISSING, object_id, elapsed_s, limit_s, now_ns, why)
