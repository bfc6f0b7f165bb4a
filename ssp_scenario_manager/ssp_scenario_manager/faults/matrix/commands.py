"""Rows of what an object is asked to do, and of a body that does something else."""

from __future__ import annotations

from dataclasses import replace

from ssp_scenario_manager.faults.matrix.common import (
    ABORTED,
    ERROR_S,
    FAILED,
    SEEN_S,
    TOLD_S,
    stages,
)
from ssp_scenario_manager.faults.model import OT, Expected, Row, Stage, Within


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
