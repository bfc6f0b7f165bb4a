"""Conditions that can't come true in a run are refused at load, each with its field and reason."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.triggers.fireability import cannot_fire

GAP = {"type": "relative_distance", "object_id": "ot1", "below_m": 12.0}
HEADWAY = {"type": "time_headway", "object_id": "ot1", "below_s": 2.0}
TTC = {"type": "time_to_collision", "object_id": "ot1", "below_s": 3.0}
ARRIVAL = {"type": "time_to_arrival", "anchor": (100.0, 0.0), "below_s": 3.0}


def speed(who: str, relation: str, value_mps: float) -> dict[str, Any]:
    return {"type": "speed", "object_id": who, "relation": relation, "value_mps": value_mps}


def region(who: str, x_m: float, y_m: float) -> dict[str, Any]:
    """A square of 4 m around a place."""
    corners = [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)]
    polygon = [(x_m + dx, y_m + dy) for dx, dy in corners]
    return {"type": "in_region", "object_id": who, "polygon": polygon}


def phase(name: str) -> dict[str, Any]:
    return {"type": "phase_reached", "phase": name}


def after(after_s: float) -> dict[str, Any]:
    return {"type": "elapsed_time", "after_s": after_s}


def every(*of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "all", "of": list(of)}


def either(*of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "any", "of": list(of)}


def found(mapping: dict[str, Any], *conditions: dict[str, Any], **of_first: Any) -> list[str]:
    """Problems of the run with these triggers, all of them the initiator's first manoeuvre's."""
    first = mapping["triggers"][0]
    triggers = [
        {**first, "id": f"t{i}", "condition": condition} for i, condition in enumerate(conditions)
    ]
    triggers[0].update(of_first)
    return cannot_fire(RunSpec.model_validate({**mapping, "triggers": triggers}))


def add_walker(mapping: dict[str, Any], y_m: float = -8.0) -> None:
    """ot2, which stands beside the road and has no motion of its own."""
    start = {"x_m": 120.0, "y_m": y_m, "yaw_rad": 1.57}
    mapping["targets"].append({"id": "ot2", "object_class": "pedestrian", "start": start})


@pytest.mark.parametrize(
    "condition",
    [
        GAP,
        HEADWAY,
        ARRIVAL,
        speed("vut", "above", 9.9),
        speed("ot1", "above", 6.9),
        speed("vut", "below", 0.5),
        speed("ot1", "below", 0.5),
        region("vut", 200.0, 0.0),
        region("ot1", 200.0, 5.5),
        after(39.9),
        every(GAP, speed("vut", "above", 5.0), speed("vut", "below", 9.0), after(3.0)),
        # One part is enough; the others may be out of reach.
        either(speed("ot1", "above", 99.0), after(99.0), phase("trigger"), GAP),
    ],
)
def test_what_may_fire_is_loaded(run_mapping: dict[str, Any], condition: dict[str, Any]) -> None:
    assert found(run_mapping, condition) == []


CASES: dict[str, tuple[dict[str, Any], str]] = {
    "unknown, nested": (
        every(GAP, either(speed("ot9", "above", 1.0), GAP)),
        "triggers[0].condition.of[1].of[0].object_id: ot9 is no target of this run",
    ),
    "gap to the VUT itself": (
        {**HEADWAY, "object_id": "vut"},
        "triggers[0].condition.object_id: vut is no target of this run",
    ),
    "too fast for the VUT": (
        speed("vut", "above", 10.0),
        "triggers[0].condition.value_mps: vut is never faster than 10 m/s",
    ),
    "too fast for the OT": (
        speed("ot1", "above", 7.0),
        "triggers[0].condition.value_mps: ot1 is never faster than 7 m/s",
    ),
    "slower than nothing": (
        speed("vut", "below", 0.0),
        "triggers[0].condition.value_mps: nothing is slower than 0 m/s",
    ),
    "region beside the path": (
        region("vut", 200.0, 4.0),
        "triggers[0].condition.polygon: vut comes no nearer than 2.0 m",
    ),
    "region beyond the path": (
        region("ot1", 300.0, 3.5),
        "triggers[0].condition.polygon: ot1 comes no nearer than 48.0 m",
    ),
    "region that only the own manoeuvre reaches": (
        region("ot1", 150.0, 0.0),
        "triggers[0].condition.polygon: ot1 comes no nearer than 1.5 m",
    ),
    "ttc of who stays in its lane": (
        TTC,
        "triggers[0].condition.object_id: ot1 stays beside the VUT's corridor, so that there is "
        "no TTC",
    ),
    "phase that needs this trigger": (
        every(GAP, phase("trigger")),
        "triggers[0].condition.of[1].phase: trigger is never reached: no trigger of ot1, whose "
        "manoeuvre it needs, fires without it",
    ),
    "after the end": (
        after(40.0),
        "triggers[0].condition.after_s: 40 s is not before the end of the run (40 s)",
    ),
    "two speeds at once": (
        every(speed("ot1", "above", 5.0), GAP, speed("ot1", "below", 5.0)),
        "triggers[0].condition: ot1 is never above 5 m/s and below 5 m/s at once",
    ),
    "anchor behind, nested": (
        every(GAP, {**ARRIVAL, "anchor": (3.6, 0.0)}),
        "triggers[0].condition.of[1].anchor: lies behind the VUT's start",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_cannot_fire_is_refused(run_mapping: dict[str, Any], name: str) -> None:
    condition, says = CASES[name]
    assert found(run_mapping, condition) == [says]


def test_an_anchor_that_is_reached_too_late(run_mapping: dict[str, Any]) -> None:
    run_mapping["end"] = {"at_latest_s": 6.6}
    assert found(run_mapping, ARRIVAL) == [
        "triggers[0].condition.anchor: the VUT isn't 3 s away from it before the end of the run "
        "(6.6 s)"
    ]
    run_mapping["end"] = {"at_latest_s": 6.7}
    assert found(run_mapping, ARRIVAL) == []


def test_any_is_refused_with_the_reasons_of_all_its_parts(run_mapping: dict[str, Any]) -> None:
    problems = found(run_mapping, either(after(50.0), speed("ot1", "above", 9.0)))
    assert [p.split(": ")[0] for p in problems] == [
        "triggers[0].condition.of[0].after_s",
        "triggers[0].condition.of[1].value_mps",
    ]


@pytest.mark.parametrize("condition", [GAP, HEADWAY, TTC])
def test_an_object_that_is_never_ahead(
    run_mapping: dict[str, Any], condition: dict[str, Any]
) -> None:
    ot1 = run_mapping["targets"][0]
    ot1["start"] |= {"x_m": -60.0}
    ot1["approach"]["path"] = [(-60.0, 3.5), (-1.0, 3.5)]
    assert found(run_mapping, condition) == [
        "triggers[0].condition.object_id: ot1 is never ahead of the VUT"
    ]
    ot1["start"] |= {"y_m": 0.0}
    ot1["approach"]["path"] = [(-60.0, 0.0), (0.5, 0.0)]
    assert found(run_mapping, condition) == []


def test_one_trigger_may_make_another_possible(run_mapping: dict[str, Any]) -> None:
    """The cut-in of t0 gives a TTC, brings ot1 into the VUT's lane and causes the phases."""
    for condition in (TTC, region("ot1", 150.0, 0.0), phase("conflict")):
        assert found(run_mapping, GAP, condition) == []


def test_triggers_that_wait_for_each_other_are_both_refused(run_mapping: dict[str, Any]) -> None:
    add_walker(run_mapping)
    into = region("ot1", 150.0, 0.0)  # where only the first's manoeuvre takes ot1
    walked = region("ot2", 120.0, 0.0)
    walk = {"kind": "follow_path", "motion": {"path": [(120.0, -8.0), (120.0, 8.0)],
                                               "cruise_mps": 1.4}}  # fmt: skip
    first = run_mapping["triggers"][0]
    run_mapping["initiator"] = "ot1"
    run_mapping["triggers"] = [
        {**first, "id": "a", "condition": walked},
        {**first, "id": "b", "condition": into, "object_id": "ot2", "manoeuvre": walk},
    ]
    problems = cannot_fire(RunSpec.model_validate(run_mapping))
    assert [p.split(":")[0] for p in problems] == [
        "triggers[0].condition.polygon",
        "triggers[1].condition.polygon",
    ]
    run_mapping["triggers"][0]["condition"] = GAP
    assert cannot_fire(RunSpec.model_validate(run_mapping)) == []


def test_a_speed_that_is_not_left_again(run_mapping: dict[str, Any]) -> None:
    """From 5 s on ot1 drives 7 m/s, and comes to its path's end after the run's."""
    run_mapping["end"] = {"at_latest_s": 29.0}
    slow = speed("ot1", "below", 5.0)
    assert found(run_mapping, slow, not_before_s=5.0) == [
        "triggers[0].condition.value_mps: ot1 has no motion that makes it slower than that again"
    ]
    assert found(run_mapping, slow, edge="rising") != []
    assert found(run_mapping, slow, not_before_s=1.0) == []
    assert found(run_mapping, slow, GAP, not_before_s=5.0) != []  # its lane change drives 6 m/s
    assert found(run_mapping, speed("ot1", "below", 6.5), GAP, not_before_s=5.0) == []
    run_mapping["end"] = {"at_latest_s": 31.0}
    assert found(run_mapping, slow, not_before_s=5.0) == []


def test_who_never_gets_so_fast_does_not_become_slower(run_mapping: dict[str, Any]) -> None:
    assert found(run_mapping, speed("ot1", "below", 8.0), edge="rising") == [
        "triggers[0].condition.value_mps: ot1 is always slower, never faster than 7 m/s"
    ]


def test_a_driver_from_outside_may_drive_as_fast_as_the_site_allows(
    run_mapping: dict[str, Any],
) -> None:
    run_mapping["driver"]["external"] = True
    assert found(run_mapping, speed("vut", "above", 14.9)) == []
    assert found(run_mapping, speed("vut", "above", 15.0)) == [
        "triggers[0].condition.value_mps: vut is never faster than 15 m/s"
    ]


@pytest.mark.parametrize(
    ("condition", "edge", "says"),
    [
        (after(0.0), "rising", "rising, but it holds all the while from the first state on"),
        (either(GAP, after(0.0)), "falling", "falling, but it holds all the while from the first"),
        (after(3.0), "falling", "falling, but times and phases don't cease to hold"),
        (speed("ot1", "below", 15.1), "rising", "ot1 is always slower"),
        (every(speed("ot1", "below", 15.1)), "falling", "holds all the while"),
    ],
)
def test_edges_that_never_come(
    run_mapping: dict[str, Any], condition: dict[str, Any], edge: str, says: str
) -> None:
    (problem,) = found(run_mapping, condition, edge=edge)
    assert says in problem


def test_holding_that_lasts_longer_than_the_run(run_mapping: dict[str, Any]) -> None:
    assert found(run_mapping, after(30.0), held_for_s=10.0) == [
        "triggers[0].held_for_s: 10 s from 30 s on, when it may hold at the earliest, are not over "
        "before the end of the run (40 s)"
    ]
    assert found(run_mapping, after(30.0), held_for_s=9.9) == []
    late = phase("resolution")
    assert found(run_mapping, late, GAP, held_for_s=2.5) == []
    assert found(run_mapping, late, GAP, held_for_s=2.6) == [
        "triggers[0].held_for_s: the run ends 2.5 s after the start of the resolution"
    ]
    assert found(run_mapping, either(late, GAP), GAP, held_for_s=2.6) == []


def test_the_shorter_of_the_runs_two_ends_counts(run_mapping: dict[str, Any]) -> None:
    run_mapping["limits"]["duration_s"] = 20.0
    assert found(run_mapping, after(20.0)) == [
        "triggers[0].condition.after_s: 20 s is not before the end of the run (20 s)"
    ]
