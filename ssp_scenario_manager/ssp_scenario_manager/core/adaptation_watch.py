"""Adapted re-dispatch after a trigger: what a run sends so that conflict timing holds."""

from __future__ import annotations

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.safety.codes import SafetyCode
from ssp_scenario_manager.core import outbox
from ssp_scenario_manager.core.adaptations import Wish
from ssp_scenario_manager.core.answers import ADAPTED
from ssp_scenario_manager.core.dispatch import EXPIRY_S
from ssp_scenario_manager.core.pace import Pace, play
from ssp_scenario_manager.core.run import Run
from ssp_scenario_manager.core.supervisor import Violation


def watch_adaptation(run: Run, vut: ObjectState, now_ns: int) -> list[outbox.Outgoing | Violation]:
    """Judges the dispatched manoeuvres on the VUT's newest state, and adapts them.

    A passing order that can't be kept ends the run: nothing that happens afterwards would be the
    event.

    Args:
        run: the run.
        vut: state of the VUT that hasn't been judged yet.
        now_ns: session time, that of a dispatch.
    """
    facts: list[outbox.Outgoing | Violation] = []
    for wish in run.adaptations.judge(run.spec, run.path, vut, now_ns):
        decision, trigger = wish.decision, wish.fired.trigger
        if decision.wrong_order:
            elapsed_s = ns_to_seconds(now_ns - (run.started_ns or 0))
            facts.append(
                Violation(
                    SafetyCode.EVENT_MISSING,
                    trigger.object_id,
                    elapsed_s,
                    run.spec.end.at_latest_s,
                    now_ns,
                    decision.wrong_order,
                )
            )
            continue
        if decision.pace is not None:
            facts.append(_dispatch(run, wish, decision.pace, now_ns))
        if decision.note:
            facts.append(outbox.Note(now_ns, f"{trigger.object_id}: {decision.note}"))
    facts += [outbox.Note(now_ns, text) for text in run.adaptations.take_notes()]
    return facts


def _dispatch(run: Run, wish: Wish, pace: Pace, now_ns: int) -> outbox.Dispatch:
    lead_s = ns_to_seconds(pace.start_ns - now_ns)
    address = run.address(wish.fired.trigger.object_id, ADAPTED, now_ns, lead_s)
    run.adaptations.send(address.reference_id, wish)
    return run.send(
        Reference(
            reference_id=address.reference_id,
            object_id=address.object_id,
            event_version=address.event_version,
            purpose=address.purpose,
            dispatched_ns=now_ns,
            execute_at_ns=pace.start_ns,
            expires_at_ns=pace.start_ns + seconds_to_ns(EXPIRY_S),
            points=play(wish.decision.adapting.routine.columns, pace),
        )
    )
