"""Runs that could never become an event are refused, each with its field and reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.triggers.fireability import cannot_fire


def arrival(x_m: float, y_m: float = 0.0) -> dict[str, Any]:
    return {"type": "time_to_arrival", "anchor": (x_m, y_m), "below_s": 3.0}


def set_trigger(mapping: dict[str, Any], **changes: Any) -> None:
    mapping["triggers"][0].update(changes)


def brake(**changes: Any) -> dict[str, Any]:
    return {"kind": "brake", "to_mps": 0.0, "deceleration_mps2": 4.0, **changes}


def change_both(mapping: dict[str, Any], act: dict[str, Any], **changes: Any) -> None:
    set_trigger(mapping, manoeuvre=act)
    mapping.update(changes)


def parked() -> dict[str, Any]:
    """A target that stands all the while: no approach, no trigger."""
    start = {"x_m": 90.0, "y_m": -4.0, "yaw_rad": 0.0}
    return {"id": "truck1", "object_class": "truck", "start": start}


CASES: dict[str, tuple[Callable[[dict[str, Any]], None], str]] = {
    "target of the manoeuvre": (
        lambda m: set_trigger(m, object_id="ot7"),
        "triggers[0].object_id: ot7 is no target of this run",
    ),
    "object of the gap": (
        lambda m: m["triggers"][0]["condition"].update(object_id="vut"),
        "triggers[0].condition.object_id: vut is no target of this run",
    ),
    "too late": (
        lambda m: set_trigger(m, not_before_s=40.0),
        "triggers[0].not_before_s: 40 s is not before the end of the run (40 s)",
    ),
    "nothing to leave": (
        lambda m: m["targets"][0].update(approach=None),
        "triggers[0].manoeuvre: ot1 has no approach that a lane change could leave",
    ),
    "nothing to brake on": (
        lambda m: change_both(m, brake(), targets=[{**m["targets"][0], "approach": None}]),
        "triggers[0].manoeuvre: ot1 has no approach that it could brake on",
    ),
    "no lower speed": (
        lambda m: set_trigger(m, manoeuvre=brake(to_mps=7.0)),
        "triggers[0].manoeuvre.to_mps: 7 m/s is not below the 7 m/s at which ot1 drives",
    ),
    "braking that nobody sees": (
        lambda m: change_both(m, brake(deceleration_mps2=1.0), observable="braking"),
        "observable: ot1 brakes at 1 m/s^2, which is not above the 1 m/s^2 that can be seen",
    ),
    "initiator without a trigger": (
        lambda m: m.update(targets=[*m["targets"], parked()], initiator="truck1"),
        "initiator: truck1 has no trigger",
    ),
    "no threshold": (
        lambda m: m.update(thresholds={"ttc_s": None, "arrival_gap_s": None}),
        "thresholds: neither ttc_s nor arrival_gap_s is given, so no conflict",
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
        {"not_before_s": 39.9},
    ):
        set_trigger(run_mapping, **changes)
        assert cannot_fire(RunSpec.model_validate(run_mapping)) == []


def test_braking_and_standing_targets_can_be_run(run_mapping: dict[str, Any]) -> None:
    act = brake(to_mps=6.9, deceleration_mps2=1.01)
    change_both(run_mapping, act, observable="braking", initiator="ot1")
    run_mapping["targets"].append(parked())
    run_mapping["thresholds"] = {"arrival_gap_s": None}
    assert cannot_fire(RunSpec.model_validate(run_mapping)) == []


def test_braking_may_be_observed_of_who_changes_lane(run_mapping: dict[str, Any]) -> None:
    run_mapping["observable"] = "braking"
    assert cannot_fire(RunSpec.model_validate(run_mapping)) == []


def test_all_reasons_at_once(run_mapping: dict[str, Any]) -> None:
    set_trigger(run_mapping, not_before_s=99.0, object_id="ot7")
    assert len(cannot_fire(RunSpec.model_validate(run_mapping))) == 2
    run_mapping["initiator"] = "ot1"
    assert cannot_fire(RunSpec.model_validate(run_mapping))[2:] == ["initiator: ot1 has no trigger"]
