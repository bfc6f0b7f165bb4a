"""Values of files: angles in radians, places on the Earth, crossings of a road."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from ssp_core.run_file.model import Camera
from ssp_core.run_file.road import Building, Lane, Road
from ssp_core.run_file.values import SiteDatum, Start, Strict

START: dict[str, Any] = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
BUILDING: dict[str, Any] = {
    "type": "building",
    "s_m": 0,
    "l_m": 9,
    "length_m": 5,
    "width_m": 5,
    "height_m": 5,
}
DATUM: dict[str, Any] = {"latitude_deg": 57.7, "longitude_deg": 12.9}
ANGLES = [
    (Start, START, "yaw_rad", 2 * math.pi, "2π"),
    (SiteDatum, DATUM, "yaw_rad", 2 * math.pi, "2π"),
    (Building, BUILDING, "yaw_rad", 2 * math.pi, "2π"),
    (Camera, {}, "yaw_left_rad", 2 * math.pi, "2π"),
    (Camera, {}, "pitch_down_rad", math.pi / 2, "π/2"),
    (Camera, {}, "roll_right_rad", math.pi, "π"),
]


@pytest.mark.parametrize(("model", "given", "field", "most", "written"), ANGLES)
def test_angles_in_degrees_are_refused_with_the_remedy(
    model: type[BaseModel], given: dict[str, Any], field: str, most: float, written: str
) -> None:
    for value in (0.0, most, -most, round(most, 4)):
        assert getattr(model.model_validate(given | {field: value}), field) == value
    for value in (90.0, -45.0, most * 1.001):
        with pytest.raises(ValidationError) as caught:
            model.model_validate(given | {field: value})
        (failure,) = caught.value.errors()
        assert failure["loc"] == (field,)
        assert (
            f"must be from -{written} to {written}; give radians: {value:g} deg" in failure["msg"]
        )
    with pytest.raises(ValidationError, match="must be a finite number"):
        model.model_validate(given | {field: math.nan})


@pytest.mark.parametrize(("field", "most"), [("latitude_deg", 90.0), ("longitude_deg", 180.0)])
def test_places_that_are_not_on_the_earth_are_refused(field: str, most: float) -> None:
    for value in (most, -most):
        assert getattr(SiteDatum.model_validate(DATUM | {field: value}), field) == value
    for value in (most + 0.001, -6_400_000.0, math.nan, math.inf):
        with pytest.raises(ValidationError, match=f"from -{most:g} to {most:g}; give decimal deg"):
            SiteDatum.model_validate(DATUM | {field: value})


def test_further_crossings_leave_files_without_them_as_they_were() -> None:
    road = Road(
        origin=Start(**START),
        length_m=100.0,
        lanes=[Lane(y_m=0.0, width_m=3.5, direction="forward")],
        crossing_x_m=50.0,
    )
    assert "further_crossings_x_m" not in road.model_dump(mode="json")
    assert road.crossings_x_m == [50.0]
    more = Road.model_validate(road.model_dump() | {"further_crossings_x_m": [80.0, 20.0]})
    assert more.crossings_x_m == [20.0, 50.0, 80.0]
    assert Road.model_validate_json(more.model_dump_json()) == more


def test_the_validator_of_a_file_model_is_made_when_it_is_first_used() -> None:
    """A node imports the models of many files and reads one of them."""

    class Within(Strict):
        value: float

    class Whole(Strict):
        within: Within

    assert not Whole.__pydantic_complete__
    assert Whole.model_validate({"within": {"value": 1}}).within.value == 1.0
    assert Whole.__pydantic_complete__
    with pytest.raises(ValidationError, match=r"within\.value"):
        Whole.model_validate({"within": {"value": "1"}})
