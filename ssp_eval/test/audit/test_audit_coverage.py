"""Camera coverage: what is in the picture, what stands in the way, which time counts (METHOD 4)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.camera import Mounting, intrinsics
from ssp_eval.recordings.sight import (
    Moment,
    Optics,
    object_share,
    object_sight,
    sight,
    zone_share,
    zone_sight,
)
from tests.support.states import object_state as box

CAMERA = Camera()
OPTICS = Optics(
    intrinsics(CAMERA), Mounting(CAMERA.forward_m, CAMERA.height_m, CAMERA.pitch_down_rad)
)
ZONE = ((20.0, -1.2), (24.0, -1.2), (24.0, 1.2), (20.0, 1.2))


VUT = box("vut", ObjectClass.CAR, 0.0, 0.0)
VIEW = OPTICS.view(VUT.pose)


@pytest.mark.parametrize(
    ("x_m", "y_m", "share"),
    [(20.0, 0.0, 1.0), (20.0, 40.0, 0.0), (-20.0, 0.0, 0.0), (900.0, 0.0, 0.0)],
)
def test_what_is_in_the_picture(x_m: float, y_m: float, share: float) -> None:
    """The boxes lie in the middle, at the side, behind, and too far away to be 8 px high."""
    assert object_share(VIEW, box("ot1", ObjectClass.PEDESTRIAN, x_m, y_m), []) == share


def test_at_the_edge_a_part_of_it_is_seen() -> None:
    edge_m = 18.2 * math.tan(math.radians(CAMERA.hfov_deg / 2))
    share = object_share(VIEW, box("ot1", ObjectClass.TRUCK, 20.0, edge_m), [])
    assert 0.2 < share < 0.9


def test_what_stands_in_the_way() -> None:
    walker = box("ot1", ObjectClass.PEDESTRIAN, 30.0, 0.0)
    truck = box("ot2", ObjectClass.TRUCK, 12.0, 0.0)
    assert object_share(VIEW, walker, [truck]) == 0.0
    assert object_share(VIEW, walker, [replace(truck, y_m=6.0)]) == 1.0
    assert zone_share(VIEW, ZONE, []) == 1.0
    assert zone_share(VIEW, ZONE, [truck]) == 0.0


def test_who_is_in_the_zone_does_not_hide_it() -> None:
    states = {"vut": VUT, "ot1": box("ot1", ObjectClass.TRUCK, 12.0, 0.0)}
    moments = [Moment(0.1 * k, states) for k in range(11)]
    found = zone_sight(moments, (0.0, 1.0), 0.1, OPTICS, "vut", "ot1", ZONE)
    assert found.fraction == pytest.approx(1.0)
    assert found.first_lost_s is None
    found = zone_sight(moments, (0.0, 1.0), 0.1, OPTICS, "vut", "ot2", ZONE)
    assert (found.fraction, found.first_lost_s) == (0.0, 0.0)


def test_the_time_that_it_is_gone_counts() -> None:
    moments = []
    for k in range(21):
        there = box("ot1", ObjectClass.CAR, 20.0 if k < 15 else -20.0, 0.0)
        moments.append(Moment(0.1 * k, {"vut": VUT, "ot1": there}))
    found = object_sight(moments, (0.5, 2.0), 0.1, OPTICS, "vut", "ot1")
    assert found.fraction == pytest.approx(1.0 / 1.5)
    assert found.first_lost_s == pytest.approx(1.5)


def test_nobody_sees_what_no_frame_shows() -> None:
    states = {"vut": VUT, "ot1": box("ot1", ObjectClass.CAR, 20.0, 0.0)}
    moments = [Moment(t, states) for t in (0.0, 0.1, 0.2, 0.8, 0.9)]
    found = object_sight(moments, (0.0, 1.0), 0.1, OPTICS, "vut", "ot1")
    # From 0.35 s, when the frame of 0.2 s is stale, to 0.8 s.
    assert found.fraction == pytest.approx(0.55)
    assert found.first_lost_s == pytest.approx(0.35)
    nothing = object_sight([], (0.0, 1.0), 0.1, OPTICS, "vut", "ot1")
    assert (nothing.fraction, nothing.first_lost_s) == (0.0, 0.0)


def test_who_is_not_there_is_not_visible_and_no_time_has_no_share() -> None:
    moments = [Moment(0.0, {"vut": VUT}), Moment(0.1, {})]
    assert object_sight(moments, (0.0, 0.2), 0.1, OPTICS, "vut", "ot1").fraction == 0.0
    assert object_sight(moments, (0.2, 0.2), 0.1, OPTICS, "vut", "ot1").fraction is None


@given(
    times=st.lists(st.floats(0, 10), max_size=30).map(sorted),
    start=st.floats(0, 10),
    length=st.floats(0.01, 5),
    seen=st.booleans(),
)
def test_a_share_is_a_share(times: list[float], start: float, length: float, seen: bool) -> None:
    def visible(states: Mapping[str, ObjectState]) -> bool:
        return seen

    found = sight([Moment(t, {}) for t in times], (start, start + length), 0.1, visible)
    assert found.fraction is not None
    assert 0.0 <= found.fraction <= 1.0
    assert seen or found.fraction == 0.0
