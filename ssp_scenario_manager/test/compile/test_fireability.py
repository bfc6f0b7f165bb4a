"""Unknown ids, times that can't come and edges that can't be are refused at load, by field."""

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


def problems_of(mapping: dict[str, Any], *conditions: dict[str, Any], **of_first: Any) -> list[str]:
    """Problems of the run with these triggers, all of them the initiator's first manoeuvre's."""
    first = mapping["triggers"][0]
    triggers = [
        {**first, "id": f"t{i}", "condition": condition} for i, condition in enumerate(conditions)
    ]
    triggers[0].update(of_first)
    return cannot_fire(RunSpec.model_validate({**mapping, "triggers": triggers}))


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
        # One part is enough.
        either(after(99.0), GAP),
        # What the traffic brings about isn't judged: the compiler simulates each plan.
        speed("ot1", "above", 99.0),
        region("ot1", 150.0, 0.0),
        every(GAP, phase("trigger")),
        TTC,
    ],
)
def test_what_may_fire_is_loaded(run_mapping: dict[str, Any], condition: dict[str, Any]) -> None:
    assert problems_of(run_mapping, condition) == []


CASES: dict[str, tuple[dict[str, Any], str]] = {
    "unknown, nested": (
        every(GAP, either(speed("ot9", "above", 1.0), GAP)),
        "triggers[0].condition.of[1].of[0].object_id: ot9 is no target of this run",
    ),
    "unknown, behind the VUT": (
        every(speed("vut", "above", 1.0), speed("ot9", "above", 1.0)),
        "triggers[0].condition.of[1].object_id: ot9 is no target of this run",
    ),
    "gap to the VUT itself": (
        {**HEADWAY, "object_id": "vut"},
        "triggers[0].condition.object_id: vut is no target of this run",
    ),
    "after the end": (
        after(40.0),
        "triggers[0].condition.after_s: 40 s is not before the end of the run (40 s)",
    ),
    "after the end, nested": (
        every(GAP, after(40.0)),
        "triggers[0].condition.of[1].after_s: 40 s is not before the end of the run (40 s)",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_what_cannot_fire_is_refused(run_mapping: dict[str, Any], name: str) -> None:
    condition, says = CASES[name]
    assert problems_of(run_mapping, condition) == [says]


def test_any_is_refused_with_the_reasons_of_all_its_parts(run_mapping: dict[str, Any]) -> None:
    problems = problems_of(run_mapping, either(after(50.0), every(GAP, after(60.0))))
    assert [p.split(": ")[0] for p in problems] == [
        "triggers[0].condition.of[0].after_s",
        "triggers[0].condition.of[1].of[1].after_s",
    ]


HOLDS = "it holds all the while from the first state on"
LASTS = "times and phases don't cease to hold"


@pytest.mark.parametrize(
    ("condition", "edge", "says"),
    [
        (after(0.0), "rising", HOLDS),
        (either(GAP, after(0.0)), "falling", HOLDS),
        (after(3.0), "falling", LASTS),
        (every(after(3.0), phase("conflict")), "falling", LASTS),
        (speed("ot1", "below", 15.1), "rising", HOLDS),
        (every(after(0.0), speed("ot1", "below", 15.1)), "falling", HOLDS),
        (either(speed("ot1", "below", 15.1), GAP), "rising", HOLDS),
    ],
)
def test_edges_that_never_come(
    run_mapping: dict[str, Any], condition: dict[str, Any], edge: str, says: str
) -> None:
    assert problems_of(run_mapping, condition, edge=edge) == [
        f"triggers[0].edge: {edge}, but {says}"
    ]
    assert problems_of(run_mapping, condition, edge="none") == []


@pytest.mark.parametrize(
    ("condition", "edge"),
    [
        (GAP, "rising"),
        (GAP, "falling"),
        (after(3.0), "rising"),
        (phase("conflict"), "rising"),
        (every(GAP, after(3.0)), "falling"),
        (every(GAP, after(0.0)), "rising"),
        # At the limit of 15 m/s the VUT may still drive.
        (speed("vut", "below", 15.0), "rising"),
        (speed("vut", "above", 15.1), "rising"),
    ],
)
def test_edges_that_may_come(
    run_mapping: dict[str, Any], condition: dict[str, Any], edge: str
) -> None:
    assert problems_of(run_mapping, condition, edge=edge) == []


def test_a_time_from_which_a_trigger_counts_hides_what_came_before(
    run_mapping: dict[str, Any],
) -> None:
    condition = every(after(3.0))
    assert problems_of(run_mapping, condition, edge="rising", not_before_s=2.9) == []
    for begin_s in (3.0, 4.0):
        assert problems_of(run_mapping, condition, edge="rising", not_before_s=begin_s) == [
            f"triggers[0].edge: rising, but {HOLDS}"
        ]


def test_holding_that_lasts_longer_than_the_run(run_mapping: dict[str, Any]) -> None:
    assert problems_of(run_mapping, after(30.0), held_for_s=10.0) == [
        "triggers[0].held_for_s: 10 s from 30 s on, when it may hold at the earliest, are not over "
        "before the end of the run (40 s)"
    ]
    assert problems_of(run_mapping, after(30.0), held_for_s=9.9) == []
    assert problems_of(run_mapping, GAP, held_for_s=39.9) == []
    late = phase("resolution")
    assert problems_of(run_mapping, late, GAP, held_for_s=2.5) == []
    assert problems_of(run_mapping, late, GAP, held_for_s=2.6) == [
        "triggers[0].held_for_s: the run ends 2.5 s after the start of the resolution"
    ]
    assert problems_of(run_mapping, either(late, GAP), GAP, held_for_s=2.6) == []
    for deeper in (every(GAP, late), every(every(late), GAP), either(late, every(GAP, late))):
        assert len(problems_of(run_mapping, deeper, GAP, held_for_s=2.6)) == 1
    assert problems_of(run_mapping, every(GAP, phase("conflict")), GAP, held_for_s=2.6) == []


def test_the_shorter_of_the_runs_two_ends_counts(run_mapping: dict[str, Any]) -> None:
    run_mapping["limits"]["duration_s"] = 20.0
    assert problems_of(run_mapping, after(20.0)) == [
        "triggers[0].condition.after_s: 20 s is not before the end of the run (20 s)"
    ]
