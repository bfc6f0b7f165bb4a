"""Who is known to stand: by speed, by the age of what says so, by what the object is doing."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.session.preconditions import moving, stands

S = 1_000_000_000
NOW_NS = 50 * S
StateMaker = Callable[..., ObjectState]


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, True),
        ({"speed_mps": 0.05}, True),
        ({"speed_mps": -0.05}, True),
        ({"speed_mps": math.nextafter(0.05, 1.0)}, False),
        ({"speed_mps": -0.06}, False),
        ({"speed_mps": math.nan}, False),
        ({"stamp_ns": NOW_NS - S}, True),
        ({"stamp_ns": NOW_NS - S - 1}, False),
        ({"stamp_ns": NOW_NS + S}, True),
        ({"stamp_ns": NOW_NS + S + 1}, False),  # a clock that is far off proves nothing
        ({"control_state": ControlState.RUNNING}, False),
        ({"control_state": ControlState.REMOTE_CONTROLLED}, False),
    ],
)
def test_one_object(state: StateMaker, changed: dict[str, Any], expected: bool) -> None:
    assert stands(state("ot1", **{"stamp_ns": NOW_NS, **changed}), NOW_NS) is expected


@pytest.mark.parametrize("control", ControlState)
def test_in_an_abort_everybody_must_have_heard_it(state: StateMaker, control: ControlState) -> None:
    could_go = {"ARMED", "PRE_ARMING", "PRE_RUNNING", "RUNNING", "REMOTE_CONTROLLED"}
    known = state("ot1", stamp_ns=NOW_NS, control_state=control)
    assert stands(known, NOW_NS, aborting=True) is (control.name not in could_go)


def test_who_is_asked(run: RunSpec, state: StateMaker) -> None:
    vut, ot1 = state("vut", stamp_ns=NOW_NS), state("ot1", stamp_ns=NOW_NS)
    fast = state("ot1", stamp_ns=NOW_NS, speed_mps=1.0)
    assert moving(run, vut, {"ot1": ot1}, NOW_NS, armed=True) == []
    assert moving(run, vut, {"ot1": fast}, NOW_NS, armed=True) == ["ot1"]
    assert moving(run, vut, {"ot1": fast}, NOW_NS, armed=True, without=["ot1"]) == []
    # What was never heard must prove that it stands only once it could have been set in motion.
    assert moving(run, None, {}, NOW_NS, armed=False) == []
    assert moving(run, None, {}, NOW_NS, armed=True) == ["vut", "ot1"]
