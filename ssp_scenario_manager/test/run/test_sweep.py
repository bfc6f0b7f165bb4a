"""The fields that a sweep may vary, and the reasons for which it is refused."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run.sweep import (
    Sweep,
    Variation,
    combinations,
    parse_variation,
    values_of,
    with_values,
)


@pytest.mark.parametrize(
    ("text", "variation"),
    [
        ("driver.cruise_mps=8:12", Variation("driver.cruise_mps", (8.0, 12.0), is_drawn=True)),
        ("clock=-0.5:1e-1", Variation("clock", (-0.5, 0.1), is_drawn=True)),
        ("disturbance.reorder=0,0.1", Variation("disturbance.reorder", (0, 0.1))),
        (" driver.reacts = true, false", Variation("driver.reacts", (True, False))),
        ("a.b=car", Variation("a.b", ("car",))),
        ("a.b=null,2", Variation("a.b", (None, 2))),
    ],
)
def test_forms(text: str, variation: Variation) -> None:
    assert parse_variation(text) == variation


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("driver.cruise_mps", "FIELD=VALUES"),
        ("=3", "FIELD=VALUES"),
        ("a=", "FIELD=VALUES"),
        ("a=3:2", "lower and an upper"),
        ("a=2:2", "lower and an upper"),
        ("a=x:3", "lower and an upper"),
        ("a=1:2:3", "lower and an upper"),
        ("a=1:inf", "lower and an upper"),
        ("a=1,,2", "'' is no number or word"),
        ("a=1_0:20", "lower and an upper"),
        ("a={b,2}", "'{b' is no number or word"),
        ("a=[1", "'[1' is no number or word"),
    ],
)
def test_what_is_no_variation(text: str, says: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_variation(text)
    assert (caught.value.field, caught.value.value) == ("--vary", text)
    assert says in str(caught.value)


def test_values_in_turn_make_a_grid_and_ranges_are_drawn() -> None:
    variations = [
        Variation("a", (1, 2)),
        Variation("b", (0.0, 1.0), is_drawn=True),
        Variation("c", ("x", "y", "z")),
    ]
    assert combinations(variations) == 6
    rows = [values_of(variations, 5, k) for k in range(12)]
    assert [list(row) for row in rows] == [["a", "b", "c"]] * 12
    cells = [(row["a"], row["c"]) for row in rows]
    assert cells[:6] == [(a, c) for a in (1, 2) for c in "xyz"]
    assert cells[6:] == cells[:6]
    drawn = [row["b"] for row in rows]
    assert len(set(drawn)) == 12
    assert all(0.0 <= value < 1.0 for value in drawn)


def test_a_draw_depends_on_seed_field_and_run_alone() -> None:
    alone = [values_of([Variation("b", (8.0, 12.0), is_drawn=True)], 5, k)["b"] for k in range(50)]
    beside = [
        values_of(
            [Variation("a", (0.0, 1.0), is_drawn=True), Variation("b", (8.0, 12.0), is_drawn=True)],
            5,
            k,
        )["b"]
        for k in range(50)
    ]
    assert alone == beside
    assert alone != [
        values_of([Variation("b", (8.0, 12.0), is_drawn=True)], 6, k)["b"] for k in range(50)
    ]
    assert min(alone) < 8.5
    assert max(alone) > 11.5


def test_a_field_deep_inside_is_replaced_and_nothing_else(run: RunSpec) -> None:
    changed = with_values(
        run, {"driver.cruise_mps": 8.5, "triggers.0.lead_time_s": 0.3, "limits.jump_m": 2}, 11
    )
    assert changed.driver.cruise_mps == 8.5
    assert changed.triggers[0].lead_time_s == 0.3
    assert (changed.limits.jump_m, changed.seed) == (2.0, 11)
    before = {
        "driver.cruise_mps": run.driver.cruise_mps,
        "triggers.0.lead_time_s": run.triggers[0].lead_time_s,
        "limits.jump_m": run.limits.jump_m,
    }
    assert with_values(changed, before, run.seed) == run


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("driver.cruise", 8, "cruise_mps"),
        ("cruise_mps", 8, "driver"),
        ("limits", 8, "is no single field"),
        ("triggers.3.lead_time_s", 8, "there is 0"),
        ("triggers.x", 8, "is no single field"),
        ("driver.cruise_mps.x", 8, "see run.yaml"),
        ("driver.cruise_mps", -1, "greater than 0"),
        ("driver.cruise_mps", "fast", "valid number"),
        ("seed", 2, "can't be varied"),
    ],
)
def test_what_is_no_field_or_no_value_of_it(
    run: RunSpec, field: str, value: Any, says: str
) -> None:
    with pytest.raises(InputError, match=says):
        Sweep(run, (Variation(field, (value,)),), 1).check()


def test_each_bound_is_a_value_and_no_field_is_named_twice(run: RunSpec) -> None:
    with pytest.raises(InputError, match="less than or equal"):
        Sweep(run, (Variation("step_s", (0.02, 0.5), is_drawn=True),), 1).check()
    twice = Variation("limits.jump_m", (1,)), Variation("limits.jump_m", (1.0, 2.0), is_drawn=True)
    with pytest.raises(InputError, match="twice"):
        Sweep(run, twice, 1).check()


def test_values_are_checked_together_as_they_will_be_run(run: RunSpec) -> None:
    x_m, y_m = run.vut.start.x_m, run.vut.start.y_m
    # Each is within the start region, and both together are not.
    off_m = 0.8 * run.limits.start_region_m
    starts = (
        Variation("vut.start.x_m", (x_m, x_m + off_m)),
        Variation("vut.start.y_m", (y_m, y_m + off_m)),
    )
    for one in starts:
        Sweep(run, (one,), 2).check()
    Sweep(run, starts, 3).check()
    with pytest.raises(InputError, match=r"run 3: vut.start: lies .* from its path's first point"):
        Sweep(run, starts, 4).check()


def test_values_that_are_sound_together_alone_are_taken(run: RunSpec) -> None:
    far_m = 3.0 * run.limits.start_region_m
    together = Variation("vut.start.x_m", (run.vut.start.x_m + far_m,))
    path = Variation("vut.approach.path.0.0", (run.vut.start.x_m + far_m,))
    Sweep(run, (together, path), 1).check()
