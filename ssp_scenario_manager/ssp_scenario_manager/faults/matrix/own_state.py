"""Rows of what an object knows of itself: its clock and its localisation."""

from __future__ import annotations

from ssp_scenario_manager.faults.matrix.common import (
    ABORTED,
    FAILED,
    HARNESS,
    SEEN_S,
    STARTS_S,
    TOLD_S,
    UNCONFIRMED,
    stages,
)
from ssp_scenario_manager.faults.model import OT, Expected, Row, Stage, Within

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
