"""Geodetic places and a site's metres."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2

TRACK = Place(57.7779, 12.7810, 201.5)
latitudes = st.floats(-90.0, 90.0)
longitudes = st.floats(-180.0, 180.0)
places = st.builds(Place, latitudes, longitudes, st.floats(-500.0, 9000.0))
angles = st.floats(-math.pi, math.pi)
metres = st.floats(-20_000.0, 20_000.0)


def test_a_degree_on_the_equator_and_on_a_meridian() -> None:
    """One degree of longitude is an arc of the semi-major axis; the plane shows its sine."""
    x, y, z = Datum(Place(0.0, 0.0, 0.0)).to_site(Place(0.0, 1.0, 0.0))
    a = 6_378_137.0
    assert x == pytest.approx(a * math.sin(math.radians(1.0)), abs=1e-6)
    assert y == pytest.approx(0.0, abs=1e-6)
    assert z == pytest.approx(a * (math.cos(math.radians(1.0)) - 1.0), abs=1e-6)
    # The meridian's radius of curvature at the equator is a (1 - e²).
    step_deg = 1e-4
    _, y, _ = Datum(Place(0.0, 0.0, 0.0)).to_site(Place(step_deg, 0.0, 0.0))
    assert y == pytest.approx(a * (1.0 - 0.00669437999014) * math.radians(step_deg), rel=1e-8)


def test_earth_centred_numbers_of_a_known_place() -> None:
    """The pole is a (1 - f) from the centre, 90 degrees of longitude are the y axis."""
    pole = Datum(Place(90.0, 0.0, 0.0))
    x, y, z = pole.to_site(Place(0.0, 90.0, 0.0))
    assert (x, y) == pytest.approx((6_378_137.0, 0.0), abs=1e-6)
    assert z == pytest.approx(-6_356_752.314245, abs=1e-5)


@pytest.mark.parametrize(
    ("yaw_rad", "north", "east"),
    [(0.0, (0.0, 1.0), (1.0, 0.0)), (math.pi / 2, (1.0, 0.0), (0.0, -1.0))],
)
def test_axes(yaw_rad: float, north: tuple[float, float], east: tuple[float, float]) -> None:
    """A site whose x axis points north sees east on its right."""
    datum = Datum(TRACK, yaw_rad)
    up = datum.to_site(Place(TRACK.latitude_deg, TRACK.longitude_deg, TRACK.altitude_m + 1.0))
    assert up == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)
    x, y, _ = datum.to_site(Place(TRACK.latitude_deg + 1e-4, TRACK.longitude_deg, 201.5))
    assert (x / math.hypot(x, y), y / math.hypot(x, y)) == pytest.approx(north, abs=1e-6)
    x, y, _ = datum.to_site(Place(TRACK.latitude_deg, TRACK.longitude_deg + 1e-4, 201.5))
    assert (x / math.hypot(x, y), y / math.hypot(x, y)) == pytest.approx(east, abs=1e-6)


@given(places, angles, metres, metres, st.floats(-100.0, 100.0))
def test_a_point_comes_back(origin: Place, yaw: float, x: float, y: float, z: float) -> None:
    datum = Datum(origin, yaw)
    assert datum.to_site(datum.to_place(x, y, z)) == pytest.approx((x, y, z), abs=1e-6)


@given(places)
def test_a_place_comes_back_from_far_away(place: Place) -> None:
    """The rounding is far below a receiver's resolution even on another continent."""
    datum = Datum(TRACK, 0.3)
    again = datum.to_place(*datum.to_site(place))
    assert again.latitude_deg == pytest.approx(place.latitude_deg, abs=1e-9)
    assert again.altitude_m == pytest.approx(place.altitude_m, abs=1e-5)
    # Near a pole a metre is many degrees of longitude.
    turn = math.remainder(again.longitude_deg - place.longitude_deg, 360.0)
    assert abs(turn) * math.cos(math.radians(place.latitude_deg)) < 1e-9


@pytest.mark.parametrize(
    ("away_m", "drop_m", "short_m"), [(1000.0, 0.079, 5e-6), (5000.0, 1.97, 6e-4)]
)
def test_the_stated_error_of_the_plane(away_m: float, drop_m: float, short_m: float) -> None:
    """The places lie along the equator, where the ground's radius is known."""
    a = 6_378_137.0
    x, _, z = Datum(Place(0.0, 0.0, 0.0)).to_site(Place(0.0, math.degrees(away_m / a), 0.0))
    assert -z == pytest.approx(drop_m, rel=0.01)
    assert 0.0 < away_m - x < short_m


@given(places, angles, metres, metres, angles)
def test_poses_turn_with_the_site(origin: Place, yaw: float, x: float, y: float, h: float) -> None:
    datum = Datum(origin, yaw)
    told = datum.to_enu(Pose2(x, y, h))
    back = datum.of_enu(told)
    assert (back.x_m, back.y_m) == pytest.approx((x, y), abs=1e-6)
    assert math.remainder(back.yaw_rad - h, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    # A step forward in the site is a step forward on the Earth.
    ahead = datum.to_enu(Pose2(x + math.cos(h), y + math.sin(h), h))
    step = (ahead.x_m - told.x_m, ahead.y_m - told.y_m)
    assert step == pytest.approx((math.cos(told.yaw_rad), math.sin(told.yaw_rad)), abs=1e-6)


@given(st.lists(places, max_size=5), angles)
def test_many_places_are_as_one_after_the_other(many: list[Place], yaw: float) -> None:
    datum = Datum(TRACK, yaw)
    rows = [(p.latitude_deg, p.longitude_deg, p.altitude_m) for p in many]
    found = np.array(datum.all_to_site(*np.array(rows).reshape(-1, 3).T))
    alone = [datum.to_site(place) for place in many]
    assert np.allclose(found.T, np.array(alone).reshape(-1, 3), rtol=0.0, atol=1e-7)
