"""What keeps a session from connecting, arming and starting: each thing, and all at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.run_spec import RunSpec
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState
from ssp_scenario_manager.core.readiness import (
    Facts,
    cannot_fire,
    missing_to_arm,
    missing_to_connect,
    missing_to_start,
)

READY = Facts(
    recorder_ready=True,
    recorder_age_s=0.1,
    camera_age_s=0.1,
    vut_age_s=0.1,
    target_age_s=(("ot1", 0.1),),
)
StateMaker = Callable[..., ObjectState]


@pytest.fixture
def vut(state: StateMaker) -> ObjectState:
    return state("vut")


@pytest.fixture
def ot1(state: StateMaker) -> ObjectState:
    return state("ot1", x_m=40.0, y_m=3.5, control_state=ControlState.DISARMED)


# -- connect --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("age_s", "fresh"), [(1.0, True), (1.001, False), (math.inf, False)])
def test_connect_needs_fresh_states(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, age_s: float, fresh: bool
) -> None:
    targets = {"ot1": ot1}
    assert missing_to_connect(run, READY, vut, targets) == []
    facts = replace(READY, vut_age_s=age_s)
    missing = [] if fresh else ["no state of the VUT arrives"]
    assert missing_to_connect(run, facts, vut, targets) == missing
    facts = replace(READY, target_age_s=(("ot1", age_s),))
    missing = [] if fresh else ["no state of ot1 arrives"]
    assert missing_to_connect(run, facts, vut, targets) == missing


# -- arm ------------------------------------------------------------------------------------------


def test_nothing_is_missing(run: RunSpec, vut: ObjectState, ot1: ObjectState) -> None:
    assert missing_to_arm(run, READY, vut, {"ot1": ot1}) == []


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({"recorder_age_s": 2.0}, None),
        ({"recorder_age_s": 2.01}, "the recorder is silent"),
        ({"recorder_ready": False}, "the recorder is not ready: its file is not open"),
        (
            {"recorder_ready": False, "recorder_missing": ("/ssp/a", "/ssp/b")},
            "the recorder is not ready: /ssp/a, /ssp/b",
        ),
    ],
)
def test_the_recorder(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, facts: dict[str, Any], says: str | None
) -> None:
    missing = [says] if says else []
    assert missing_to_arm(run, replace(READY, **facts), vut, {"ot1": ot1}) == missing


def test_the_camera_counts_if_there_is_one(
    run_mapping: dict[str, Any], run: RunSpec, vut: ObjectState, ot1: ObjectState
) -> None:
    facts = replace(READY, camera_age_s=3.01)
    assert missing_to_arm(run, facts, vut, {"ot1": ot1}) == []
    run_mapping["camera"] = {}
    seen = RunSpec.model_validate(run_mapping)
    assert missing_to_arm(seen, facts, vut, {"ot1": ot1}) == ["no camera frame arrives"]
    assert missing_to_arm(seen, replace(READY, camera_age_s=3.0), vut, {"ot1": ot1}) == []


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"x_m": 41.5}, []),
        ({"x_m": 41.51}, ["ot1 is 1.51 m from its start, limit 1.5 m"]),
        ({"speed_mps": 0.05}, []),
        ({"speed_mps": -0.06}, ["ot1 moves at -0.06 m/s"]),
        ({"control_state": ControlState.ARMED}, []),
        ({"control_state": ControlState.ABORTING}, ["ot1 is ABORTING, not DISARMED"]),
        ({"control_state": ControlState.OFF}, ["ot1 is OFF, not DISARMED"]),
    ],
)
def test_each_target_in_place_and_disarmed(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, changed: dict[str, Any], says: list[str]
) -> None:
    assert missing_to_arm(run, READY, vut, {"ot1": replace(ot1, **changed)}) == says


def test_the_vut_in_place(run: RunSpec, vut: ObjectState, ot1: ObjectState) -> None:
    away = replace(vut, x_m=-11.0, speed_mps=1.0)
    assert missing_to_arm(run, READY, away, {"ot1": ot1}) == [
        "vut is 11.00 m from its start, limit 1.5 m",
        "vut moves at 1.00 m/s",
        "vut is outside the geofence",
    ]


def test_separation_before_the_start(
    run_mapping: dict[str, Any], vut: ObjectState, ot1: ObjectState
) -> None:
    # Bumper to bumper 0.25 m, limit 0.5 m: the run file itself asks for too little.
    run_mapping["targets"][0]["start"] = {"x_m": 4.75, "y_m": 0.0, "yaw_rad": 0.0}
    close = RunSpec.model_validate(run_mapping)
    near = replace(ot1, x_m=4.75, y_m=0.0)
    assert missing_to_arm(close, READY, vut, {"ot1": near}) == [
        "ot1 is 0.25 m from the VUT, limit 0.5 m"
    ]
    exact = replace(ot1, x_m=5.0, y_m=0.0, size=replace(ot1.size, rear_m=1.0))
    ahead = replace(vut, size=replace(vut.size, front_m=3.5))
    assert missing_to_arm(close, READY, ahead, {"ot1": exact}) == []


def test_everything_that_is_missing_is_named_at_once(
    run_mapping: dict[str, Any], state: StateMaker
) -> None:
    run_mapping["camera"] = {}
    ot2 = {"id": "ot2", "object_class": "car", "start": {"x_m": 70.0, "y_m": 0.0, "yaw_rad": 0.0}}
    run_mapping["targets"].append(ot2)
    both = RunSpec.model_validate(run_mapping)
    stray = state("ot2", x_m=99.0, y_m=99.0, speed_mps=3.0, control_state=ControlState.INIT)
    assert missing_to_arm(both, Facts(), None, {"ot2": stray}) == [
        "no state of the VUT arrives",
        "no state of ot1 arrives",
        "no state of ot2 arrives",
        "the recorder is silent",
        "no camera frame arrives",
        "ot2 is INIT, not DISARMED",
        "ot2 is 103.16 m from its start, limit 1.5 m",
        "ot2 moves at 3.00 m/s",
        "ot2 is outside the geofence",
    ]


def test_no_number_is_not_in_place(run: RunSpec, vut: ObjectState, ot1: ObjectState) -> None:
    nowhere = replace(ot1, x_m=math.nan)
    assert "ot1 is outside the geofence" in missing_to_arm(run, READY, vut, {"ot1": nowhere})


# -- start ----------------------------------------------------------------------------------------


def test_start_needs_armed_objects_that_are_still_heard(
    run: RunSpec, vut: ObjectState, ot1: ObjectState
) -> None:
    armed = {"ot1": replace(ot1, control_state=ControlState.ARMED)}
    assert missing_to_start(run, READY, vut, armed) == []
    assert missing_to_start(run, READY, vut, {"ot1": ot1}) == ["ot1 is DISARMED, not ARMED"]
    gone = replace(READY, vut_age_s=1.5, recorder_age_s=2.5)
    assert missing_to_start(run, gone, vut, armed) == [
        "no state of the VUT arrives",
        "the recorder is not ready",
    ]
    assert missing_to_start(run, replace(READY, recorder_ready=False), None, {}) == [
        "no state of the VUT arrives",
        "no state of ot1 arrives",
        "the recorder is not ready",
    ]


# -- cannot fire ----------------------------------------------------------------------------------


def arrival(x_m: float, y_m: float = 0.0) -> dict[str, Any]:
    return {"type": "time_to_arrival", "anchor": (x_m, y_m), "below_s": 3.0}


def set_trigger(mapping: dict[str, Any], **changes: Any) -> None:
    mapping["triggers"][0].update(changes)


CASES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "target of the manoeuvre": (
        lambda m: set_trigger(m, object_id="ot7"),
        "triggers[0].object_id: ot7 is no target of this run",
    ),
    "object of the gap": (
        lambda m: m["triggers"][0]["condition"].update(object_id="vut"),
        "triggers[0].condition.object_id: vut is no target of this run",
    ),
    "anchor behind": (
        lambda m: set_trigger(m, condition=arrival(3.6)),
        "triggers[0].condition.anchor: lies behind the VUT's start",
    ),
    "anchor beyond": (
        lambda m: set_trigger(m, condition=arrival(250.0)),
        "triggers[0].condition.anchor: lies beyond the VUT's path",
    ),
    "anchor beside": (
        lambda m: set_trigger(m, condition=arrival(100.0, 10.1)),
        "triggers[0].condition.anchor: is 10.1 m beside the VUT's path",
    ),
    "too late": (
        lambda m: set_trigger(m, not_before_s=40.0),
        "triggers[0].not_before_s: 40 s is not before the end of the run (40 s)",
    ),
    "nothing to leave": (
        lambda m: m["targets"][0].update(approach=None),
        "triggers[0].manoeuvre: ot1 has no approach that a lane change could leave",
    ),
    "vut without a path": (
        lambda m: m["vut"].update(approach=None),
        "vut.approach: the VUT has no path, so that nothing it does can trigger",
    ),
    "standing path": (
        lambda m: m["vut"]["approach"].update(path=[(0.0, 0.0), (0.0, 0.0)]),
        "vut.approach.path: a path's consecutive points must differ",
    ),
    "standing path of a target": (
        lambda m: m["targets"][0]["approach"].update(path=[(0.0, 0.0), (0.0, 0.0)]),
        "targets[0].approach.path: a path's consecutive points must differ",
    ),
    "standing path of a manoeuvre": (
        lambda m: set_trigger(
            m,
            manoeuvre={
                "kind": "follow_path",
                "motion": {"path": [(1.0, 2.0), (1.0, 2.0)], "cruise_mps": 1.0},
            },
        ),
        "triggers[0].manoeuvre.motion.path: a path's consecutive points must differ",
    ),
    "two targets of one name": (
        lambda m: m["targets"].append(m["targets"][0]),
        "targets[1].id: ot1 stands twice",
    ),
    "target named as the vut": (
        lambda m: m["targets"].append({**m["targets"][0], "id": "vut"}),
        "targets[1].id: vut stands twice",
    ),
    "two triggers of one name": (
        lambda m: m["triggers"].append(m["triggers"][0]),
        "triggers[1].id: gap stands twice",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_run_that_cannot_fire(run_mapping: dict[str, Any], name: str) -> None:
    change, says = CASES[name]
    assert cannot_fire(RunSpec.model_validate(run_mapping)) == []
    change(run_mapping)
    assert cannot_fire(RunSpec.model_validate(run_mapping)) == [says]


def test_just_possible(run_mapping: dict[str, Any]) -> None:
    for changes in (
        {"condition": arrival(3.7)},
        {"condition": arrival(249.9, -10.0)},
        {"not_before_s": 39.9},
    ):
        set_trigger(run_mapping, **changes)
        assert cannot_fire(RunSpec.model_validate(run_mapping)) == []


def test_all_reasons_at_once(run_mapping: dict[str, Any]) -> None:
    set_trigger(run_mapping, condition=arrival(300.0), not_before_s=99.0, object_id="ot7")
    assert len(cannot_fire(RunSpec.model_validate(run_mapping))) == 3
