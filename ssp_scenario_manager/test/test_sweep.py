"""What a sweep may vary, and what it is refused for."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run.sweep import Choice, Span, Variable, grid, parse_variation, values_of


@pytest.mark.parametrize(
    ("text", "variation"),
    [
        ("driver.cruise_mps=8:12", Span("driver.cruise_mps", 8.0, 12.0)),
        ("clock=-0.5:1e-1", Span("clock", -0.5, 0.1)),
        ("disturbance.reorder=0,0.1", Choice("disturbance.reorder", (0, 0.1))),
        (" driver.reacts = true, false", Choice("driver.reacts", (True, False))),
        ("a.b=car", Choice("a.b", ("car",))),
        ("a.b=null,2", Choice("a.b", (None, 2))),
    ],
)
def test_forms(text: str, variation: Choice | Span) -> None:
    assert parse_variation(text) == variation
    assert parse_variation(str(variation)) == variation


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("driver.cruise_mps", "FIELD=VALUES"),
        ("=3", "FIELD=VALUES"),
        ("a=", "FIELD=VALUES"),
        ("a=3:2", "lower and an upper"),
        ("a=2:2", "lower and an upper"),
        ("a=x:3", "lower and an upper"),
        ("a=1:2:3", "two bounds"),
        ("a=1,,2", "'' is no number or word"),
        ("a={b: 2}", "'{b' is no number or word"),
        ("a=[1", "'[1' is no number or word"),
    ],
)
def test_what_is_no_variation(text: str, says: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_variation(text)
    assert (caught.value.field, caught.value.value) == ("--vary", text)
    assert says in str(caught.value)


def test_values_in_turn_make_a_grid_and_ranges_are_drawn() -> None:
    variations = [Choice("a", (1, 2)), Span("b", 0.0, 1.0), Choice("c", ("x", "y", "z"))]
    assert len(grid(variations)) == 6
    rows = [values_of(variations, 5, k) for k in range(12)]
    assert [list(row) for row in rows] == [["a", "b", "c"]] * 12
    cells = [(row["a"], row["c"]) for row in rows]
    assert cells[:6] == [(a, c) for a in (1, 2) for c in "xyz"]
    assert cells[6:] == cells[:6]
    drawn = [row["b"] for row in rows]
    assert len(set(drawn)) == 12
    assert all(0.0 <= value < 1.0 for value in drawn)


def test_a_draw_depends_on_seed_field_and_run_alone() -> None:
    alone = [values_of([Span("b", 8.0, 12.0)], 5, k)["b"] for k in range(50)]
    beside = [values_of([Span("a", 0.0, 1.0), Span("b", 8.0, 12.0)], 5, k)["b"] for k in range(50)]
    assert alone == beside
    assert alone != [values_of([Span("b", 8.0, 12.0)], 6, k)["b"] for k in range(50)]
    assert min(alone) < 8.5
    assert max(alone) > 11.5


def test_a_field_deep_inside_is_replaced_and_nothing_else(run: RunSpec) -> None:
    changed = Variable(run).with_values(
        {"driver.cruise_mps": 8.5, "triggers.0.lead_time_s": 0.3, "limits.jump_m": 2}, 11
    )
    assert changed.driver.cruise_mps == 8.5
    assert changed.triggers[0].lead_time_s == 0.3
    assert (changed.limits.jump_m, changed.seed) == (2.0, 11)
    assert (
        Variable(changed).with_values(
            {
                "driver.cruise_mps": run.driver.cruise_mps,
                "triggers.0.lead_time_s": run.triggers[0].lead_time_s,
                "limits.jump_m": run.limits.jump_m,
            },
            run.seed,
        )
        == run
    )


@pytest.mark.parametrize(
    ("field", "value", "says"),
    [
        ("driver.cruise", 8, "driver.cruise_mps"),
        ("cruise_mps", 8, "driver.cruise_mps"),
        ("limits", 8, "is no single field"),
        ("triggers.3.lead_time_s", 8, "triggers.0.lead_time_s"),
        ("triggers.x", 8, "is no single field"),
        ("driver.cruise_mps.x", 8, "driver.cruise_mps"),
        ("driver.cruise_mps", -1, "greater than 0"),
        ("driver.cruise_mps", "fast", "valid number"),
    ],
)
def test_what_is_no_field_or_no_value_of_it(
    run: RunSpec, field: str, value: Any, says: str
) -> None:
    with pytest.raises(InputError) as caught:
        Variable(run).check([Choice(field, (value,))])
    assert says in str(caught.value)


def test_a_sweep_keeps_what_is_its_own_and_names_no_field_twice(run: RunSpec) -> None:
    with pytest.raises(InputError, match="can't be varied"):
        Variable(run).check([Choice("seed", (1, 2))])
    with pytest.raises(InputError, match="twice"):
        Variable(run).check([Choice("limits.jump_m", (1,)), Span("limits.jump_m", 1.0, 2.0)])
    with pytest.raises(InputError, match="less than or equal"):
        Variable(run).check([Span("step_s", 0.02, 0.5)])
