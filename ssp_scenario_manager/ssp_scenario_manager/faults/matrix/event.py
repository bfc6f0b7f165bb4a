"""Rows of the event and of people: it doesn't take place, or somebody ends it."""

from __future__ import annotations

from ssp_core import names
from ssp_scenario_manager.faults.matrix.common import (
    ABORTED,
    OFF_SPEC,
    SEEN_S,
    TOLD_S,
    VALID,
    stages,
)
from ssp_scenario_manager.faults.model import Expected, NotApplicable, Row, Stage, Within

_NOT_RESOLVED = Expected(
    OFF_SPEC,
    "The event doesn't take place any more. The run waits for it until its time is over and says "
    "that it is missing.",
    by="the manager",
    primary=("event_missing",),
    within=Within(SEEN_S, "at_latest_s"),
    since="abort",
)
_VUT_YIELDS = Expected(
    VALID | OFF_SPEC,
    "A VUT that brakes for the conflict is what the test is about: if conflict and resolution "
    "take place all the same, and the VUT passes as K* wants, the run is valid. If the object "
    "can't meet it as specified any more, however its reference is adapted, or the VUT never "
    "reaches the conflict zone, it is off spec.",
    by="the manager",
    primary=("event_missing", "time gap at the conflict point"),
    since="abort",
)
VUT_STOPS = Row(
    "vut_stop",
    "VUT stops early",
    "vut_stop",
    target=names.VUT_ID,
    cells={
        Stage.ARMED: _NOT_RESOLVED,
        Stage.BEFORE: _NOT_RESOLVED,
        Stage.AFTER: _VUT_YIELDS,
        Stage.CONFLICT: _VUT_YIELDS,
    },
)
TRIGGER_NEVER = Row(
    "trigger_never",
    "Trigger never met",
    "trigger_never",
    cells={
        Stage.ARMED: NotApplicable(
            "no trigger is judged before the start; the cell before the trigger is this run from "
            "its very beginning"
        ),
        Stage.BEFORE: _NOT_RESOLVED,
        Stage.AFTER: NotApplicable("by then the trigger has been met"),
        Stage.CONFLICT: NotApplicable("by then the trigger has been met"),
    },
)
OPERATOR_ABORT = Row(
    "operator_abort",
    "Operator aborts",
    "operator_abort",
    cells=stages(
        Expected(
            ABORTED,
            "Abort is legal in every state; armed objects latch it too.",
            by="the manager",
            primary=("abort by",),
            also=("operator",),
            within=Within(TOLD_S, clock="wall"),
            starts=False,
        ),
        Expected(
            ABORTED,
            "A person's word needs no reason. Everybody brakes with the next heartbeat.",
            by="the manager",
            primary=("abort by",),
            also=("operator",),
            within=Within(TOLD_S, clock="wall"),
            since="abort",
        ),
    ),
)
