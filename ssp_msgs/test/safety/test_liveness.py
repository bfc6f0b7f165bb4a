"""The table of silences that end a session, and whom a lockstep world waits for."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.liveness import SignOfLife, lockstep_participants, signs_of_life
from ssp_core.vocabulary import SessionPhase
from tests.support.runs import small_run

EXTERNAL = {"cruise_mps": 10.0, "external": True}


@pytest.mark.parametrize(
    ("changes", "others"),
    [
        ({}, ()),
        ({"camera": {}}, (names.FRONT_CAMERA,)),
        ({"driver": EXTERNAL}, (names.VUT_DRIVER,)),
        ({"camera": {}, "driver": EXTERNAL}, (names.FRONT_CAMERA, names.VUT_DRIVER)),
    ],
)
def test_a_lockstep_world_waits_for_camera_and_driver_where_there_are_any(
    changes: dict[str, Any], others: tuple[str, ...]
) -> None:
    run = RunSpec.model_validate(small_run(**changes))
    assert lockstep_participants(run) == (names.OBJECT_TARGET, *others, names.MONITOR)


@pytest.mark.parametrize(("state_age_s", "state_s"), [(0.3, 0.5), (0.8, 0.8)])
def test_a_state_may_be_silent_as_long_as_the_site_lets_it_grow_old(
    state_age_s: float, state_s: float
) -> None:
    limits = {"speed_mps": 15.0, "acceleration_mps2": 5.0, "state_age_s": state_age_s}
    limits["heartbeat_s"] = 0.4
    run = RunSpec.model_validate(small_run(mode="live", limits=limits))
    vut, silent, reply = (
        *(SafetyCode.VUT_SILENT, SafetyCode.OBJECT_SILENT),
        SafetyCode.REPLY_MISSING,
    )
    assert signs_of_life(run) == (
        SignOfLife(vut, names.VUT_ID, state_s),
        SignOfLife(silent, "ot1", state_s),
        SignOfLife(SafetyCode.RECORDER, names.MONITOR, 2.0),
        SignOfLife(reply, "ot1", 0.4),
        SignOfLife(vut, names.VUT_ID, state_age_s, by_stamp=True),
        SignOfLife(silent, "ot1", state_age_s, by_stamp=True),
    )
    stepped = signs_of_life(run.model_copy(update={"mode": "lockstep"}))
    assert stepped[:3] == (
        SignOfLife(SafetyCode.WORLD_SILENT, names.SIL_WORLD, 12.0),
        SignOfLife(vut, names.VUT_ID, 12.25),
        SignOfLife(silent, "ot1", 12.0, (SessionPhase.ARMED,)),
    )
    assert stepped[4] == SignOfLife(reply, "ot1", 0.4, ())
