"""The fault matrix itself: every row and cell, with the reason for what is expected.

Bounds on reaction times are a limit of the site plus ``SEEN_S``: one step until the fault is in a
state, one until it is judged, one until the answer is published. Watches of processes use the
wall's clock in lockstep, where session time stands still while the world waits.
"""

from __future__ import annotations

from dataclasses import replace

from ssp_core import names
from ssp_scenario_manager.faults.model import (
    OT,
    Cell,
    Expected,
    NotApplicable,
    Row,
    Stage,
    Within,
)

SEEN_S = 0.06
# Polling periods and scheduling of processes, on the wall's clock.
TOLD_S = 0.75
# Lockstep: the world drops whom it waits for in vain (sil/node.py), and how long its own
# standstill may last (core/vigil.py, target/crew.py).
HANG_S = 1.5
WORLD_S = 4.0
# Without ticks outside a run an object takes the world for dead (target/crew.py).
TICKS_S = 1.0
# The recorder's flush and report, and how long the manager waits for its status (core/vigil.py).
DISK_S = 1.0
RECORDER_S = 2.0
# A reference that begins to move is that much ahead of what shows as motion.
STARTS_S = 0.4
# An error of 2 m by an acceleration of 1 m/s^2 that nobody asked for.
ERROR_S = 3.0

VALID = frozenset({"valid"})
HARNESS = frozenset({"invalid_harness"})
ABORTED = frozenset({"aborted"})
FAILED = frozenset({"failed_safety"})
# What the runner says of a session whose end nobody could confirm.
_UNCONFIRMED = "the recording ends while the session is"
_RUN = (Stage.BEFORE, Stage.AFTER, Stage.CONFLICT)


def _valid(why: str) -> Expected:
    return Expected(VALID, why, stops=False)


def _stages(armed: Cell, running: Cell) -> dict[Stage, Cell]:
    """One cell for the armed session, the same for all stages of the run."""
    return {Stage.ARMED: armed, **dict.fromkeys(_RUN, running)}


def _same(cell: Cell) -> dict[Stage, Cell]:
    return dict.fromkeys(Stage, cell)


# -- processes ------------------------------------------------------------------------------------

MANAGER_KILLED = Row(
    "manager_killed",
    "Scenario manager killed (SIGKILL)",
    "kill",
    target=names.SCENARIO_MANAGER,
    cells=_stages(
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
            also=("heartbeat_lost", "participant_lost", _UNCONFIRMED),
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
    cells=_stages(
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
            also=("object_target killed", "reply_missing", _UNCONFIRMED),
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
    cells=_stages(
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
            also=("reply_missing", "object_aborted", "participant_lost", "heartbeat_lost"),
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
    cells=_stages(
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
            also=("monitor killed", "the recorder did not close its bag", _UNCONFIRMED),
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
    cells=_stages(
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
            also=("monitor exited", "the recorder did not close its bag", _UNCONFIRMED),
            within=Within(TOLD_S + DISK_S, clock="wall"),
            since="abort",
            loses=True,
            may_end_first=True,
        ),
    ),
)

# -- links ----------------------------------------------------------------------------------------


def _delayed(milliseconds: int, cells: dict[Stage, Cell]) -> Row:
    return Row(
        f"link_delay_{milliseconds}",
        f"Link delay {milliseconds} ms each way",
        "link_delay",
        target=OT,
        value=milliseconds / 1000.0,
        cells=cells,
    )


def _lossy(percent: int, cells: dict[Stage, Cell]) -> Row:
    return Row(
        f"link_loss_{percent}",
        f"Link loss {percent} % each way",
        "link_loss",
        target=OT,
        value=percent / 100.0,
        cells=cells,
    )


def _late(why: str, primary: tuple[str, ...], later: str) -> dict[Stage, Cell]:
    """A link that is too slow for the manoeuvre's reference, and good enough for all else."""
    refused = Expected(
        ABORTED,
        why,
        by="the object by itself, then the manager",
        primary=primary,
        also=("reference_refused", "ack_missing", "object_aborted"),
        since="abort",
    )
    well = _valid(later)
    return {
        Stage.ARMED: refused,
        Stage.BEFORE: refused,
        Stage.AFTER: well,
        Stage.CONFLICT: well,
    }


_SILENT = Expected(
    ABORTED,
    "States and heartbeats stay away for 0.5 s at once: the manager misses the object's states "
    "after 0.3 s and aborts; the object hears that late, but misses the heartbeats by itself.",
    by="the manager, and the object by itself",
    primary=("object_silent", "heartbeat_lost"),
    also=(
        "heartbeat_lost",
        "object_silent",
        "ack_missing",
        "reply_missing",
        "link_delay",
        "reference_refused",
    ),
    within=Within(SEEN_S, "state_age_s"),
    blind=Within(SEEN_S, "heartbeat_s"),
)
DELAYS = [
    _delayed(
        50,
        _same(_valid("Well inside all limits; references are sent early enough for it.")),
    ),
    _delayed(
        150,
        _late(
            "A reference is sent lead_time_s before it is to be executed, 0.1 s unless the event "
            "says more, and comes 0.15 s later: too late, it is refused and the object stops. That "
            "is the stated limit; a slower link needs a longer lead_time_s.",
            ("reference_refused",),
            "Half of the age that a state may have; nothing is on its way any more.",
        ),
    ),
    _delayed(
        225,
        _late(
            "As with 150 ms. There and back it takes 0.45 s and two steps, and ack_s is 0.5 s, so "
            "that the answer to a reference may be missed before.",
            ("reference_refused", "ack_missing"),
            "States are 0.245 s old at most, limit 0.3 s; there and back 0.45 s of 0.5.",
        ),
    ),
    _delayed(
        500,
        _stages(
            Expected(
                ABORTED | HARNESS,
                "There and back takes a second, and the site allows half of one: the measured "
                "link keeps the session from starting.",
                by="the manager",
                primary=("the link to",),
                also=("no answer",),
                starts=False,
            ),
            _SILENT,
        ),
    ),
]
_HALF = Expected(
    VALID | ABORTED,
    "States and heartbeats come often enough to bear it. But every second reference is lost the "
    "first time, and sent again it may come too late to be executed in time: then it is refused "
    "and everything stops. While armed there are only 20 heartbeats a second, and ten in a row are "
    "lost every other minute. Which of it happens is a matter of the seed; both are right.",
    by="the object by itself, or nobody",
    primary=("reference_refused", "ack_missing", "heartbeat_lost", "object_silent"),
    also=("reference_refused", "ack_missing", "heartbeat_lost", "object_aborted"),
    since="abort",
)
LOSSES = [
    _lossy(5, _same(_valid("States come every 20 ms; a lost reference is sent again."))),
    _lossy(20, _same(_valid("Three in a row are lost once in 125; references are sent again."))),
    _lossy(
        50,
        {
            Stage.ARMED: _HALF,
            Stage.BEFORE: _HALF,
            Stage.AFTER: _valid("Fifteen states in a row are lost once in 32768."),
            Stage.CONFLICT: _valid("Fifteen states in a row are lost once in 32768."),
        },
    ),
]
REORDERED = Row(
    "link_reorder",
    "Reordering: 30 % of the states overtaken",
    "link_reorder",
    target=OT,
    value=0.3,
    cells=_same(_valid("An older state than the newest one known is dropped, by its stamp.")),
)

# -- the object's own state -----------------------------------------------------------------------


_CLOCK_REFUSED = Expected(
    ABORTED | HARNESS,
    "The offset of every clock is measured, and stamps from the future are seen: the session "
    "doesn't start, since the object would execute everything at the wrong time.",
    by="the manager",
    primary=("clock_offset", "the clock of"),
    also=("clock_offset",),
    starts=False,
)
CLOCKS = [
    Row(
        "clock_plus",
        "Object's clock steps by +0.5 s",
        "clock_step",
        target=OT,
        value=0.5,
        cells=_stages(
            _CLOCK_REFUSED,
            Expected(
                FAILED | ABORTED,
                "Its stamps say that it needed half a second for the way of a step: no motion "
                "explains that. The manager sees states from the future at the same time.",
                by="the object, by itself",
                primary=("position_jump", "error_longitudinal", "clock_offset"),
                also=("clock_offset", "object_aborted"),
                within=Within(SEEN_S),
            ),
        ),
    ),
    Row(
        "clock_minus",
        "Object's clock steps by -0.5 s",
        "clock_step",
        target=OT,
        value=-0.5,
        cells=_stages(
            _CLOCK_REFUSED,
            Expected(
                FAILED | ABORTED,
                "It is half a second ahead of where its own clock wants it. If its reference "
                "hasn't begun by that clock it brakes, and the manager, to whom nothing new comes, "
                "calls it silent.",
                by="the object by itself, or the manager",
                primary=("error_longitudinal", "object_silent"),
                also=("object_silent", "object_aborted", "clock_offset"),
                within=Within(SEEN_S, "state_age_s"),
            ),
        ),
    ),
]


# What else a manager believes that is told of a wrong place.
_WRONG_PLACE = ("object_aborted", "collision", "separation")


def _own_state(
    name: str,
    title: str,
    kind: str,
    limit: str,
    why: str,
    armed: Expected | None = None,
    value: float | None = None,
) -> Row:
    seen = Expected(
        FAILED,
        why,
        by="the object, by itself",
        primary=(limit,),
        also=_WRONG_PLACE,
        within=Within(SEEN_S),
    )
    armed = armed or Expected(
        FAILED,
        "An armed object watches its state already; it latches ABORTING and nothing starts.",
        by="the object, by itself",
        primary=(limit,),
        also=("object_aborted",),
        within=Within(TOLD_S, clock="wall"),
        starts=False,
    )
    return Row(name, title, kind, target=OT, value=value, cells=_stages(armed, seen))  # type: ignore[arg-type]


JUMP = _own_state(
    "position_jump",
    "Localisation jumps by 2 m",
    "position_jump",
    "position_jump",
    "No motion explains 2 m within a step. The object doesn't know where it is, so that it must "
    "not steer back: it stops with the steering as it was.",
    Expected(
        HARNESS | FAILED,
        "It is 2 m from where it must stand, and a start region is 1.5 m: the session doesn't "
        "start. While time stands still no state can be told from the one before.",
        by="the manager",
        primary=("ot1 is 2.00 m from its start", "collision", "separation"),
        starts=False,
    ),
    2.0,
)
NAN = _own_state(
    "state_nan",
    "State holds NaN",
    "state_nan",
    "state_not_finite",
    "Every comparison with NaN is false: limits are written so that it counts as passed. The "
    "object stops blindly.",
)
_FROZEN_AT_REST = Expected(
    FAILED,
    "While it stands, a frozen state is a right one. When it is told to drive off, the state "
    "doesn't follow: it is seen as soon as the object must have moved.",
    by="the object, by itself",
    primary=("state_frozen",),
    also=("object_aborted",),
    within=Within(SEEN_S + STARTS_S, "frozen_s"),
    since="motion",
)
FROZEN = Row(
    "state_frozen",
    "State frozen (stamps go on)",
    "state_frozen",
    target=OT,
    cells=_stages(
        _FROZEN_AT_REST,
        Expected(
            FAILED,
            "States arrive in time and say that it drives, but its position stands and falls "
            "behind its reference. Nothing can confirm its standstill: the session stays in "
            "ABORTING.",
            by="the object, by itself",
            primary=("state_frozen", "error_longitudinal"),
            also=(*_WRONG_PLACE, _UNCONFIRMED),
            within=Within(SEEN_S, "frozen_s"),
        ),
    ),
    standing=dict.fromkeys((Stage.ARMED, Stage.BEFORE, Stage.AFTER), _FROZEN_AT_REST),
)

# -- references -----------------------------------------------------------------------------------


def _strange(kind: str, title: str, why: str) -> Row:
    # It is on its way for some milliseconds, which in lockstep are many steps: the wall's clock.
    cell = Expected(
        ABORTED,
        why,
        by="the object by itself, then the manager",
        primary=("reference_refused",),
        also=("object_aborted",),
        within=Within(TOLD_S, clock="wall"),
        since="abort",
    )
    armed = replace(cell, within=Within(SEEN_S))
    return Row(kind, title, kind, target=OT, cells=_stages(armed, cell))  # type: ignore[arg-type]


REFERENCES = [
    _strange(
        "reference_stale",
        "Stale reference (expired a second ago)",
        "A reference that took too long describes a motion that nobody waits for any more. It is "
        "refused, and who gets such things doesn't know what is wanted: it stops. One that comes "
        "while the object is armed is looked at when the run starts.",
    ),
    _strange(
        "reference_out_of_fence",
        "Reference that leaves the geofence",
        "Whoever asks for it, no object leaves the fence: refused with the distance, and a stop.",
    ),
]

# -- actuators and the VUT ------------------------------------------------------------------------

_RUNS_AWAY = Expected(
    FAILED,
    "The service brake is what is stuck, and nobody is asked whether it may push. The object runs "
    "away from its reference, or from where it should stand, notices at 2 m and stops by its "
    "emergency brake.",
    by="the object, by itself",
    primary=("error_longitudinal", "over_speed", "stopping_room"),
    also=("object_aborted",),
    within=Within(ERROR_S),
)
_STARTS_WRONG = Expected(
    FAILED,
    "It starts by 1 m/s² where its approach asks for twice as much, and falls behind; at 2 m it "
    "stops by its emergency brake.",
    by="the object, by itself",
    primary=("error_longitudinal",),
    also=("object_aborted",),
    within=Within(ERROR_S + 1.0),
)
_PUSHES_LATER = Expected(
    FAILED,
    "It stands and pushes: the brake doesn't hold it, so that it pulls its emergency brake at "
    "once. When the trigger sends it off, it runs away from its reference, and stops again.",
    by="the object, by itself",
    primary=("error_longitudinal", "over_speed", "stopping_room"),
    also=("object_aborted",),
    within=Within(ERROR_S + 1.0),
    since="trigger",
)
ACTUATOR_STUCK = Row(
    "actuator_stuck",
    "Actuator stuck: drive pushes with 1 m/s²",
    "actuator_stuck",
    target=OT,
    value=1.0,
    cells=_stages(_STARTS_WRONG, _RUNS_AWAY),
    standing=dict.fromkeys((Stage.ARMED, Stage.BEFORE, Stage.AFTER), _PUSHES_LATER),
)
_NOT_RESOLVED = Expected(
    HARNESS,
    "The event doesn't take place any more. The run waits for it until its time is over and says "
    "that it is missing.",
    by="the manager",
    primary=("event_missing",),
    within=Within(SEEN_S, "at_latest_s"),
    since="abort",
)
_VUT_YIELDS = Expected(
    VALID | HARNESS,
    "A VUT that brakes for the conflict is what the test is about: if conflict and resolution "
    "take place all the same, the run is valid. If the object can't meet it as specified any more, "
    "however its reference is adapted, the event is missing.",
    by="the manager",
    primary=("event_missing",),
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
    cells=_stages(
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

MATRIX: tuple[Row, ...] = (
    MANAGER_KILLED,
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
