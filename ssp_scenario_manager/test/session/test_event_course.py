"""The end of a driven run: its first contact, with an object or with scenery, or its own end."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import Pole
from ssp_scenario_manager.session.event_course import EventCourse

MS = 1_000_000
S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (250.0, 0.0)])
END_S = 9.0
StateMaker = Callable[..., ObjectState]


@pytest.fixture
def spec(run: RunSpec) -> RunSpec:
    """A driven run with a pole beside its road, at 50 m."""
    driven = Driven(driver="no_response", first_request_s=1.0, hand_over_s=2.0, end_s=END_S)
    road = run.road.model_copy(update={"scenery": [Pole(type="pole", s_m=50.0, l_m=-2.5)]})
    return run.model_copy(update={"driven": driven, "road": road})


def test_a_driven_run_ends_a_second_after_the_first_contact(
    spec: RunSpec, state: StateMaker
) -> None:
    """The object comes from 1.5 m behind the VUT's rear, which it touches at 0.15 s."""
    course = EventCourse(spec, PATH)
    targets = {"ot1": state("ot1", x_m=-6.0, speed_mps=10.0)}
    for at_ms in (100, 200, 400, 800):
        course.note_contact(state(stamp_ns=at_ms * MS), targets)
    assert not course.is_complete(1200 * MS - 1, 1.2)
    assert course.is_complete(1200 * MS, 1.2)


@pytest.mark.parametrize(("y_m", "touches"), [(0.0, False), (-2.5, True)])
def test_scenery_ends_a_driven_run_as_an_object_does(
    spec: RunSpec, state: StateMaker, y_m: float, touches: bool
) -> None:
    course = EventCourse(spec, PATH)
    course.note_contact(state(stamp_ns=S, x_m=49.0, y_m=y_m), {"ot1": state("ot1", x_m=80.0)})
    assert not course.is_complete(2 * S - 1, 2.0)
    assert course.is_complete(2 * S, 2.0) is touches


@pytest.mark.parametrize(
    ("vut_x_m", "target_x_m"), [(0.0, 40.0), (math.nan, 0.0), (0.0, math.nan), (math.inf, 0.0)]
)
@pytest.mark.parametrize("has_scenery", [True, False])
def test_without_a_contact_that_can_be_told_a_driven_run_ends_at_its_own_end(
    spec: RunSpec, state: StateMaker, vut_x_m: float, target_x_m: float, has_scenery: bool
) -> None:
    if not has_scenery:
        spec = spec.model_copy(update={"road": spec.road.model_copy(update={"scenery": []})})
    course = EventCourse(spec, PATH)
    course.note_contact(state(stamp_ns=S, x_m=vut_x_m), {"ot1": state("ot1", x_m=target_x_m)})
    # A resolution ends no driven run.
    course.resolved_ns = S
    assert not course.is_complete(8 * S, END_S - 0.5)
    assert course.is_complete(9 * S, END_S)


def test_a_contact_does_not_end_a_run_that_is_not_driven(run: RunSpec, state: StateMaker) -> None:
    course = EventCourse(run, PATH)
    course.note_contact(state(stamp_ns=S), {"ot1": state("ot1")})
    assert not course.is_complete(9 * S, 9.0)
