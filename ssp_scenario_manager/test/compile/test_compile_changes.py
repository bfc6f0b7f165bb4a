"""Changes on site: fields by path, typed by the model of runs, explained by the log in order."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.compile.changes import (
    LINKS,
    OF_THE_EVENT,
    OF_THE_RUN,
    Difference,
    check_changeable,
    differences,
    explained,
    parse_value,
    run_mapping,
    same_value,
    value_at,
    with_value,
)
from ssp_scenario_manager.event_spec.fields import leaves
from ssp_scenario_manager.event_spec.log import Record

RUN = RunSpec.model_validate(
    {
        "schema": "ssp.run/1",
        "run_id": "r1",
        "scenario": "cut_in",
        "interaction": "cut_in",
        "domain": "physical",
        "stand_in": True,
        "event_version": "sha256:1",
        "site": "made_up",
        "site_version": "sha256:2",
        "seed": 1,
        "mode": "lockstep",
        "road": {
            "origin": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
            "length_m": 400.0,
            "lanes": [
                {"y_m": 0.0, "width_m": 3.5, "direction": "forward"},
                {"y_m": 3.5, "width_m": 3.5, "direction": "forward"},
            ],
        },
        "geofence": [[0.0, -9.0], [400.0, -9.0], [400.0, 9.0]],
        "vut": {"id": "vut", "object_class": "car", "start": {"x_m": 0, "y_m": 0, "yaw_rad": 0}},
        "driver": {"cruise_mps": 10.0},
        "targets": [
            {"id": "ot1", "object_class": "car", "start": {"x_m": 14, "y_m": -3.5, "yaw_rad": 0}}
        ],
        "triggers": [
            {
                "id": "t1",
                "condition": {"type": "relative_distance", "object_id": "ot1", "below_m": 15.0},
                "object_id": "ot1",
                "manoeuvre": {"kind": "brake", "to_mps": 0.0, "deceleration_mps2": 4.0},
            }
        ],
        "limits": {"speed_mps": 20.0, "acceleration_mps2": 6.0},
    }
)


def change(field: str | None, old: Any, new: Any, kind: str = "site_change") -> Record:
    return Record.model_validate(
        {
            "kind": kind,
            "when": "2025-03-01T09:30:00Z",
            "who": "A",
            "subject": "task cut_in",
            "field": field,
            "old": old,
            "new": new,
            "reason": "wet",
        }
    )


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("limits.speed_mps", 20.0),
        ("triggers[0].condition.below_m", 15.0),
        ("geofence[1][0]", 400.0),
        ("road.lanes[1].direction", "forward"),
        ("targets[0].approach", None),
        ("geofence[2]", [400.0, 9.0]),
    ],
)
def test_a_field_has_a_path(field: str, value: Any) -> None:
    assert value_at(RUN, field) == value


@pytest.mark.parametrize(
    "field",
    [
        "",
        ".",
        "limits.",
        ".limits",
        "limits..speed_mps",
        "limits speed_mps",
        "limits.speed",
        "limitsspeed_mps",
        "limits[0]",
        "geofence[9]",
        "geofence[-1]",
        "geofence[x]",
        "[0]",
        "road.lanes.0.y_m",
        "limits.speed_mps.value",
        "triggers[0]condition",
        "__class__",
        "a" * 999,
    ],
)
def test_what_is_no_path_of_a_field_is_refused(field: str) -> None:
    with pytest.raises(InputError, match="is no field of the run"):
        value_at(RUN, field)


def test_a_misspelt_field_is_answered_with_the_right_one() -> None:
    with pytest.raises(InputError, match=r"did you mean limits\.speed_mps"):
        value_at(RUN, "limits.speed_mp")


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        ("limits.speed_mps", "12", 12.0),
        ("limits.speed_mps", "1.2e1", 12.0),
        ("driver.reacts", "false", False),
        ("geofence", "[[0, 0], [1, 0], [1, 1]]", [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]),
        ("targets[0].id", "no", "no"),
        ("camera", "null", None),
    ],
)
def test_what_is_typed_is_read_as_the_model_reads_it(field: str, text: str, value: Any) -> None:
    found = parse_value(RUN, field, text)
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("limits.speed_mps", "fast"),
        ("limits.speed_mps", "-1"),
        ("limits.speed_mps", ".nan"),
        ("limits.speed_mps", "null"),
        ("limits.speed_mps", "[12"),
        ("road.lanes[0].direction", "sideways"),
        ("geofence", "[[0, 0]]"),
        ("triggers[0].manoeuvre.to_mps", "{a: 1}"),
    ],
)
def test_what_the_model_would_not_take_is_refused(field: str, text: str) -> None:
    with pytest.raises(InputError):
        parse_value(RUN, field, text)


@given(st.sampled_from(sorted(dict(leaves(run_mapping(RUN))))), st.floats(0.5, 8.0))
def test_one_changed_field_is_the_one_difference(field: str, value: float) -> None:
    try:
        changed = with_value(RUN, field, value)
    except InputError:
        return  # not a field of numbers
    # Whole-number fields would not take the value, so what was taken is what stands there.
    whole = "geofence" if field.startswith("geofence") else field
    expected = [] if field in OF_THE_RUN else [whole]
    if value != value_at(RUN, field):
        assert [d.field for d in differences(RUN, changed)] == expected
        assert differences(changed, with_value(changed, field, value_at(RUN, field)))[:1] == (
            [Difference(whole, value_at(changed, whole), value_at(RUN, whole))] if expected else []
        )
    assert value_at(RUN, field) != value or changed == RUN


def test_items_that_were_added_or_taken_are_differences() -> None:
    shorter = with_value(RUN, "road.lanes", run_mapping(RUN)["road"]["lanes"][:1])
    found = differences(RUN, shorter)
    assert {d.field for d in found} == {
        f"road.lanes[1].{name}" for name in ("y_m", "width_m", "direction")
    }
    assert all(d.executed is None for d in found)
    assert [d.compiled for d in differences(shorter, RUN)] == [None] * 3


def test_what_is_a_run_s_own_is_no_difference() -> None:
    other = RUN.model_copy(update={"run_id": "r2", "seed": 9, "mode": "realtime"})
    assert differences(RUN, other) == []


def test_a_log_explains_changes_in_its_order() -> None:
    log = [
        change("limits.speed_mps", 20, 15),
        change("motion.ot1", "left", "right", kind="edit"),
        change("limits.speed_mps", 15.0, 12),
        change("camera", run_mapping(RUN)["camera"], None),
    ]
    run = explained(RUN, log)
    assert run.limits.speed_mps == 12.0
    assert run.camera is None
    assert {d.field.split(".")[0] for d in differences(RUN, run)} == {"limits", "camera"}
    with pytest.raises(InputError, match=r"was 20\.0 before this change") as caught:
        explained(RUN, log[2:], "log.jsonl")
    assert (caught.value.file, caught.value.field) == ("log.jsonl", "limits.speed_mps")


@pytest.mark.parametrize("record", [change(None, 1, 2), change("nothing", 1, 2)])
def test_an_entry_that_changes_no_field_is_refused(record: Record) -> None:
    with pytest.raises(InputError):
        explained(RUN, [record])


@pytest.mark.parametrize("field", sorted(OF_THE_RUN | LINKS | OF_THE_EVENT))
def test_ids_and_versions_are_no_changes_on_site(field: str) -> None:
    old = value_at(RUN, field)
    with pytest.raises(InputError):
        check_changeable(field)
    with pytest.raises(InputError):
        explained(RUN, [change(field, old, "x")])


def test_what_makes_the_event_is_changed_in_its_k_star() -> None:
    with pytest.raises(InputError, match="can't be changed on site") as caught:
        check_changeable("thresholds.ttc_s")
    assert "another version of the K*" in (caught.value.remedy or "")


def test_values_are_equal_as_json_is() -> None:
    assert same_value(15, 15.0)
    assert same_value([1, {"a": 2}], [1.0, {"a": 2.0}])
    assert not same_value(True, 1)
    assert not same_value([1], [1, 2])
    assert not same_value({"a": 1}, {"b": 1})
    assert not same_value(None, 0)


@pytest.mark.parametrize(
    ("field", "text", "old"),
    [
        ("limits.stop_reaction_s", "0.8", 1.0),
        ("datum", "{latitude_deg: 57.7, longitude_deg: 12.9}", None),
    ],
)
def test_what_files_leave_out_can_be_changed_on_site(field: str, text: str, old: object) -> None:
    new = parse_value(RUN, field, text)
    changed = with_value(RUN, field, new)
    record = Record(
        kind="site_change",
        when="2025-03-01T09:30:00Z",
        who="A. Tester",
        subject="cut_in",
        field=field,
        old=old,
        new=new,
        reason="surveyed",
    )
    assert differences(RUN, changed) != []
    assert differences(explained(RUN, [record]), changed) == []
