"""Rows of the fault matrix about objects: what they are asked to do, what they know of themselves,
their links.
"""

from __future__ import annotations

from dataclasses import replace

from ssp_scenario_manager.faults.model import (
    ABORTED,
    ERROR_S,
    FAILED,
    HARNESS,
    OT,
    SEEN_S,
    STARTS_S,
    TOLD_S,
    UNCONFIRMED,
    VALID,
    Cell,
    Expected,
    Row,
    Stage,
    Within,
    same,
    stages,
    valid,
)


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
    return Row(kind, title, kind, target=OT, cells=stages(armed, cell))  # type: ignore[arg-type]


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
    cells=stages(_STARTS_WRONG, _RUNS_AWAY),
    standing=dict.fromkeys((Stage.ARMED, Stage.BEFORE, Stage.AFTER), _PUSHES_LATER),
)


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
        cells=stages(
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
        cells=stages(
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
    return Row(name, title, kind, target=OT, value=value, cells=stages(armed, seen))  # type: ignore[arg-type]


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
    cells=stages(
        _FROZEN_AT_REST,
        Expected(
            FAILED,
            "States arrive in time and say that it drives, but its position stands and falls "
            "behind its reference. Nothing can confirm its standstill: the session stays in "
            "ABORTING.",
            by="the object, by itself",
            primary=("state_frozen", "error_longitudinal"),
            also=(*_WRONG_PLACE, UNCONFIRMED),
            within=Within(SEEN_S, "frozen_s"),
        ),
    ),
    standing=dict.fromkeys((Stage.ARMED, Stage.BEFORE, Stage.AFTER), _FROZEN_AT_REST),
)


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
    well = valid(later)
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
        same(valid("Well inside all limits; references are sent early enough for it.")),
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
        stages(
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
    _lossy(5, same(valid("States come every 20 ms; a lost reference is sent again."))),
    _lossy(20, same(valid("Three in a row are lost once in 125; references are sent again."))),
    _lossy(
        50,
        {
            Stage.ARMED: _HALF,
            Stage.BEFORE: _HALF,
            Stage.AFTER: valid("Fifteen states in a row are lost once in 32768."),
            Stage.CONFLICT: valid("Fifteen states in a row are lost once in 32768."),
        },
    ),
]
REORDERED = Row(
    "link_reorder",
    "Reordering: 30 % of the states overtaken",
    "link_reorder",
    target=OT,
    value=0.3,
    cells=same(valid("An older state than the newest one known is dropped, by its stamp.")),
)
