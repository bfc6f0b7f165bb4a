"""The fault matrix itself: rows of the event, of people and of processes, with the reason for what
is expected.
"""

from __future__ import annotations

from ssp_core import names
from ssp_scenario_manager.faults.model import (
    ABORTED,
    DISK_S,
    HANG_S,
    HARNESS,
    OFF_SPEC,
    RECORDER_S,
    SEEN_S,
    TICKS_S,
    TOLD_S,
    UNCONFIRMED,
    VALID,
    WORLD_S,
    Expected,
    NotApplicable,
    Row,
    Stage,
    Within,
    stages,
)
from ssp_scenario_manager.faults.object_rows import (
    ACTUATOR_STUCK,
    CLOCKS,
    DELAYS,
    FROZEN,
    JUMP,
    LOSSES,
    NAN,
    REFERENCES,
    REORDERED,
)

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


MANAGER_KILLED = Row(
    "manager_killed",
    "Scenario manager killed (SIGKILL)",
    "kill",
    target=names.SCENARIO_MANAGER,
    cells=stages(
        Expected(
            HARNESS,
            "Nothing moves yet, but armed objects may: without heartbeats each latches ABORTING by "
            "itself. There is nobody left who could start them.",
            by="each object, by itself",
            primary=("scenario_manager killed",),
            also=("heartbeat_lost",),
            within=Within(TOLD_S, "heartbeat_s", "wall"),
            signs=("heartbeat_lost",),
            starts=False,
        ),
        Expected(
            HARNESS,
            "Nobody commands any more. Each object brakes along its path as soon as the heartbeat "
            "has stayed away for its limit, without anyone's help; the VUT's simulated driver does "
            "the same. Our side failed, so that the run says nothing about the VUT.",
            by="each object, by itself",
            primary=("scenario_manager killed",),
            also=("heartbeat_lost", "participant_lost", UNCONFIRMED),
            within=Within(SEEN_S, "heartbeat_s"),
            signs=("heartbeat_lost",),
        ),
    ),
)
MANAGER_STOPPED = Row(
    "manager_stopped",
    "Scenario manager stands still for good (SIGSTOP)",
    "pause",
    target=names.SCENARIO_MANAGER,
    cells=stages(
        Expected(
            HARNESS,
            "As if it had been killed, but its process is still there: only its silence tells. "
            "Armed objects latch ABORTING by themselves, and the runner ends the run.",
            by="each object, by itself",
            primary=("scenario_manager silent",),
            also=("heartbeat_lost",),
            within=Within(TOLD_S, "heartbeat_s", "wall"),
            signs=("heartbeat_lost",),
            starts=False,
        ),
        Expected(
            HARNESS,
            "Each object brakes along its path by itself, as if the manager had been killed. "
            "The runner, which hears the manager every second, calls it silent after 10 s, and "
            "the run ends with that verdict and a whole bag.",
            by="each object, by itself",
            primary=("scenario_manager silent",),
            also=("heartbeat_lost", "participant_lost", UNCONFIRMED),
            within=Within(SEEN_S, "heartbeat_s"),
            signs=("heartbeat_lost",),
        ),
    ),
)
OBJECT_KILLED = Row(
    "object_killed",
    "Object target killed (SIGKILL)",
    "kill",
    target=names.OBJECT_TARGET,
    cells=stages(
        Expected(
            ABORTED | HARNESS,
            "An armed object that is not heard any more might do anything when the run starts.",
            by="the manager",
            primary=("object_silent", "participant_lost", "object_target killed"),
            also=("object_target killed",),
            within=Within(TOLD_S + 0.5, clock="wall"),
            lockstep=Within(TOLD_S + WORLD_S, clock="wall"),
            starts=False,
        ),
        Expected(
            ABORTED | HARNESS,
            "The body hears no commands and brakes hard after 0.2 s; the manager misses its states "
            "and aborts for everybody else. In lockstep the world waits for the dead process first "
            "and then names it.",
            by="its body by itself, then the manager",
            primary=("participant_lost: object_target", "object_silent"),
            also=("object_target killed", "reply_missing", UNCONFIRMED),
            within=Within(SEEN_S + 0.1, "state_age_s"),
            lockstep=Within(TOLD_S + HANG_S, clock="wall"),
            blind=Within(SEEN_S + 0.1, "state_age_s"),
        ),
    ),
)
WORLD_PAUSED = Row(
    "world_paused",
    "Simulated world paused for 6 s (SIGSTOP)",
    "pause",
    target=names.SIL_WORLD,
    duration_s=6.0,
    cells=stages(
        Expected(
            ABORTED | HARNESS,
            "On a track it is all localisation that stops. An armed object that gets no state of "
            "itself must not start.",
            by="each object, by itself",
            primary=("state_stale", "world_silent", "vut_silent", "object_silent"),
            also=("reply_missing", "object_aborted"),
            within=Within(TOLD_S + TICKS_S, clock="wall"),
            starts=False,
        ),
        Expected(
            ABORTED | HARNESS,
            "Session time stands still with the world, so that only watches on the wall's clock "
            "see it. Whoever sees it first stops; when the world goes on, everybody brakes at once "
            "and nobody drives on by what was asked before.",
            by="each object by itself, and the manager",
            primary=("world_silent", "state_stale", "vut_silent", "object_silent", "overrun"),
            also=(
                "reply_missing",
                "object_aborted",
                "participant_lost",
                "heartbeat_lost",
                UNCONFIRMED,
            ),
            within=Within(TOLD_S + TICKS_S, clock="wall"),
            lockstep=Within(TOLD_S + WORLD_S, clock="wall"),
            blind=Within(0.1),
        ),
    ),
)
RECORDER_KILLED = Row(
    "recorder_killed",
    "Recorder killed (SIGKILL)",
    "kill",
    target=names.MONITOR,
    cells=stages(
        Expected(
            HARNESS,
            "What can't be explained afterwards must not begin.",
            by="the manager",
            primary=("recorder",),
            also=("monitor killed", "the recorder did not close its bag"),
            within=Within(TOLD_S + RECORDER_S, clock="wall"),
            starts=False,
            loses=True,
        ),
        Expected(
            HARNESS,
            "Nobody is in danger, but the run can't be explained any more: it is broken off, and "
            "the bag is recovered up to the last flush. In lockstep the whole event may be over "
            "before 2 s have passed on the wall; the verdict is the same.",
            by="the manager, and the runner",
            primary=("recorder", "monitor killed"),
            also=("monitor killed", "the recorder did not close its bag", UNCONFIRMED),
            within=Within(TOLD_S + RECORDER_S, clock="wall"),
            since="abort",
            loses=True,
            may_end_first=True,
        ),
    ),
)
DISK_FULL = Row(
    "disk_full",
    "Disk full (the recorder's writes fail)",
    "disk_full",
    target=names.MONITOR,
    cells=stages(
        Expected(
            HARNESS,
            "A recorder that can't write isn't ready, and without it nothing starts.",
            by="the recorder, then the manager",
            primary=("recorder",),
            also=("monitor exited", "the recorder did not close its bag"),
            within=Within(TOLD_S + DISK_S, clock="wall"),
            starts=False,
            loses=True,
        ),
        Expected(
            HARNESS,
            "The recorder notices with its next flush and says so; what was flushed before can be "
            "read. Every lost message is counted.",
            by="the recorder, then the manager",
            primary=("recorder", "monitor exited"),
            also=("monitor exited", "the recorder did not close its bag", UNCONFIRMED),
            within=Within(TOLD_S + DISK_S, clock="wall"),
            since="abort",
            loses=True,
            may_end_first=True,
        ),
    ),
)


MATRIX: tuple[Row, ...] = (
    MANAGER_KILLED,
    MANAGER_STOPPED,
    OBJECT_KILLED,
    WORLD_PAUSED,
    RECORDER_KILLED,
    DISK_FULL,
    *DELAYS,
    *LOSSES,
    REORDERED,
    *CLOCKS,
    JUMP,
    NAN,
    FROZEN,
    *REFERENCES,
    ACTUATOR_STUCK,
    VUT_STOPS,
    TRIGGER_NEVER,
    OPERATOR_ABORT,
)

__all__ = ["MATRIX"]
