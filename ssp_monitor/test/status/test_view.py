"""Markers and /diagnostics: what is said of a session to other tools."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from visualization_msgs.msg import Marker

from ssp_core.clock import NS_PER_S
from ssp_core.geometry import Polyline, point_in_polygon
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.node_interface import Level, Status
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, ObjectClass, Role, SessionPhase, Verdict
from ssp_core.world.road_drawing import drawing_of
from ssp_monitor.ros.view_node import (
    COLOURS,
    FORGOTTEN_S,
    STALE,
    TRAIL_POINTS,
    VUT,
    ObjectMarkers,
    Trail,
    standing_marks,
)
from ssp_monitor.status.board import (
    Board,
    LatestReport,
    LatestState,
    LinkFact,
    ManagerStatus,
    RecorderFact,
    SessionFact,
    SessionStatus,
)
from ssp_monitor.status.health import ClockWatch, health
from tests.support.states import object_state

NOW_NS = 100 * NS_PER_S


def _state(object_id: str = "vut", x_m: float = 0.0, **changes: Any) -> ObjectState:
    runs = {"stamp_ns": NS_PER_S, "speed_mps": 10.0, "control_state": ControlState.RUNNING}
    return object_state(object_id, x_m=x_m, **runs | changes)


def _moving(*states: ObjectState, age_s: float = 0.0, over: ObjectMarkers | None = None) -> Any:
    """Marks by space and number, and those that are to disappear."""
    at_ns = NOW_NS - round(age_s * NS_PER_S)
    board = Board(objects={state.object_id: LatestState(state, at_ns) for state in states})
    marks = (over or ObjectMarkers()).marks(board, NOW_NS)
    gone = {(mark.ns, mark.id) for mark in marks if mark.action == Marker.DELETE}
    return {(mark.ns, mark.id): mark for mark in marks if mark.action == Marker.ADD}, gone


def _points(mark: Marker) -> list[tuple[float, float]]:
    return [(point.x, point.y) for point in mark.points]


def _colour(mark: Marker) -> Any:
    return pytest.approx((mark.color.r, mark.color.g, mark.color.b, mark.color.a))


def test_standing_marks_have_names_of_their_own_and_two_points_a_line(run_mapping):
    marks = [*standing_marks(drawing_of(RunSpec.model_validate(run_mapping)))]
    assert len({(mark.ns, mark.id) for mark in marks}) == len(marks)
    assert {mark.ns for mark in marks} == {"fence", "road", "start", "start heading"}
    fence = next(mark for mark in marks if mark.ns == "fence")
    assert _points(fence) == [(0.0, 0.0), (300.0, -9.0), (300.0, 9.0), (0.0, 0.0)]
    for mark in marks:
        assert mark.type == Marker.LINE_STRIP
        assert len(mark.points) >= 2
        assert mark.scale.x > 0.0


def test_a_box_stands_about_the_middle_of_its_object():
    marks, _ = _moving(_state(x_m=5.0, y_m=1.0, yaw_rad=math.pi / 2))
    box = marks["object", 0]
    # A car's reference point is its rear axle: 3.6 m to the front, 0.9 m to the rear.
    assert (box.type, box.header.frame_id) == (Marker.CUBE, "map")
    at, turn = box.pose.position, box.pose.orientation
    assert (at.x, at.y, at.z) == pytest.approx((5.0, 1.0 + 1.35, 0.75))
    assert (turn.z, turn.w) == pytest.approx((math.sqrt(0.5), math.sqrt(0.5)))
    assert (box.scale.x, box.scale.y, box.scale.z) == (4.5, 1.8, 1.5)
    assert marks["name", 0].text == "vut  10.0 m/s"


def test_every_class_has_a_colour_and_the_vut_its_own():
    assert set(COLOURS) == set(ObjectClass)
    walker = _state("walker", object_class=ObjectClass.PEDESTRIAN)
    marks, _ = _moving(_state(), walker)
    assert _colour(marks["object", 0]) == VUT
    assert _colour(marks["object", 1]) == COLOURS[ObjectClass.PEDESTRIAN]


def test_a_silent_object_turns_grey_says_so_and_disappears_at_last():
    moving = ObjectMarkers()
    assert _colour(_moving(_state(), over=moving)[0]["object", 0]) == VUT
    stale, _ = _moving(_state(), age_s=2.0, over=moving)
    assert _colour(stale["object", 0]) == STALE
    assert stale["name", 0].text == "vut  silent for 2.0 s"
    for gone in ({("name", 0), ("object", 0)}, set()):
        assert _moving(_state(), age_s=FORGOTTEN_S + 1, over=moving) == ({}, gone)


def test_an_object_whose_state_is_no_number_is_not_drawn_somewhere():
    assert _moving(_state(x_m=math.nan)) == ({}, set())


def test_numbers_of_marks_stay_with_their_objects():
    moving = ObjectMarkers()
    _moving(_state("b"), _state("a"), over=moving)
    again, _ = _moving(_state("a"), _state("b"), over=moving)
    assert again["name", 0].text.startswith("b")
    assert again["name", 1].text.startswith("a")


def test_trails_have_steps_an_end_and_no_jumps():
    trail = Trail()
    for k in range(10 * TRAIL_POINTS):
        trail.add(_state(x_m=0.1 * k, stamp_ns=k))
    assert len(trail.points) == TRAIL_POINTS
    steps = [b[0] - a[0] for a, b in pairwise(trail.points)]
    assert steps == pytest.approx([0.3] * len(steps))
    trail.add(_state(x_m=5000.0, stamp_ns=10**6))
    assert list(trail.points) == [(5000.0, 0.0)]
    trail.add(_state(x_m=5001.0, stamp_ns=10**6 + 1))
    trail.add(_state(x_m=5002.0, stamp_ns=7))  # a replay that begins again
    assert list(trail.points) == [(5002.0, 0.0)]


def test_the_gap_is_drawn_to_whom_the_vut_is_about_to_meet():
    moving = ObjectMarkers(Polyline([(0.0, 0.0), (200.0, 0.0)]))
    crossing = _state(
        "walker",
        30.0,
        y_m=5.0,
        yaw_rad=-math.pi / 2,
        speed_mps=2.0,
        object_class=ObjectClass.PEDESTRIAN,
        size=DEFAULT_SIZES[ObjectClass.PEDESTRIAN],
    )
    marks, _ = _moving(_state(), crossing, over=moving)
    assert _points(marks["gap", 1]) == [(0.0, 0.0), (30.0, 5.0)]
    # The VUT's front reaches the walker's corridor after 30 - 0.55 - 3.6 m at 10 m/s, the walker
    # the VUT's after 5 - 0.25 - 1.2 m at 2 m/s: 2.585 s and 1.775 s.
    assert marks["gap time", 1].text.startswith("gap 0.8 s")
    away = dataclasses.replace(crossing, yaw_rad=math.pi / 2, y_m=20.0)
    assert ("gap", 1) in _moving(_state(), away, over=moving)[1]
    assert ("gap", 1) not in _moving(_state(), crossing, age_s=2.0, over=moving)[0]


def _board(run_mapping: dict[str, Any], **changes: Any) -> Board:
    board = Board(RunSpec.model_validate(run_mapping))
    for name in ("vut", "ot1", "walker"):
        board.objects[name] = LatestState(_state(name), NOW_NS)
    board.session = SessionStatus(SessionFact(NS_PER_S, SessionPhase.RUNNING), NOW_NS)
    board.manager = ManagerStatus(NOW_NS)
    board.recorder = LatestReport(RecorderFact(True, "bag"), NOW_NS)
    for name, value in changes.items():
        setattr(board, name, value)
    return board


def _health(board: Board, clock: ClockWatch | None = None) -> dict[str, Status]:
    clock = clock or ClockWatch(NS_PER_S, NOW_NS)
    return {status.name.removeprefix("ssp: "): status for status in health(board, clock, NOW_NS)}


def test_a_session_in_which_all_is_well(run_mapping):
    found = _health(_board(run_mapping))
    assert list(found) == [
        "recorder",
        "session",
        "clock",
        "object vut",
        "object ot1",
        "object walker",
    ]
    assert {status.level for status in found.values()} == {Level.OK}
    for status in found.values():
        assert all(isinstance(word, str) for pair in status.values for word in pair)


def test_nothing_heard_is_stale_not_well(run_mapping):
    found = _health(Board(RunSpec.model_validate(run_mapping)), ClockWatch())
    assert {status.level for status in found.values()} == {Level.STALE}
    assert len(found) == 6


@pytest.mark.parametrize(
    ("fact", "level", "text"),
    [
        (RecorderFact(False, missing=("/ssp/vut/state",)), Level.WARN, "missing: /ssp/vut/state"),
        (RecorderFact(True, failure="disk full"), Level.ERROR, "disk full"),
        (RecorderFact(True, lost=3), Level.ERROR, "3 messages lost"),
        (RecorderFact(True, lost=3, dropped=2), Level.ERROR, "2 of them dropped"),
        (RecorderFact(True, warnings=("disk slow",)), Level.WARN, "disk slow"),
    ],
)
def test_the_recorders_health(fact, level, text, run_mapping):
    status = _health(_board(run_mapping, recorder=LatestReport(fact, NOW_NS)))["recorder"]
    assert status.level is level
    assert text in status.message


@pytest.mark.parametrize(
    ("fact", "level"),
    [
        (SessionFact(0, SessionPhase.ABORTED, reason="operator"), Level.ERROR),
        (SessionFact(0, SessionPhase.ABORTING), Level.ERROR),
        (SessionFact(0, SessionPhase.FINISHED, verdict=Verdict.FAILED_SAFETY), Level.ERROR),
        (SessionFact(0, SessionPhase.FINISHED, verdict=Verdict.VALID), Level.OK),
        (SessionFact(0, SessionPhase.CONNECTED), Level.WARN),
    ],
)
def test_the_sessions_health(fact, level, run_mapping):
    assert (
        _health(_board(run_mapping, session=SessionStatus(fact, NOW_NS)))["session"].level is level
    )


def test_a_silent_manager_and_a_clock_that_stands(run_mapping):
    board = _board(run_mapping, manager=ManagerStatus(NOW_NS - 2 * NS_PER_S))
    clock = ClockWatch()
    clock.see(5, NOW_NS - 3 * NS_PER_S)
    clock.see(5, NOW_NS)
    found = _health(board, clock)
    assert found["session"].level is Level.STALE
    assert found["clock"].level is Level.ERROR
    assert "has stood for 3.0 s" in found["clock"].message
    clock.see(4, NOW_NS)
    assert _health(board, clock)["clock"].level is Level.OK


@pytest.mark.parametrize(
    ("changes", "age_s", "level", "text"),
    [
        ({}, 0.31, Level.ERROR, "0.31 s old"),
        ({}, 1.5, Level.STALE, "silent for 1.5 s"),
        ({"x_m": math.inf}, 0.0, Level.ERROR, "no number"),
        ({"control_state": ControlState.ABORTING}, 0.0, Level.ERROR, "aborting"),
        ({"reference_id": "r", "error_lateral_m": -0.81}, 0.0, Level.ERROR, "to the left is -0.81"),
        ({"reference_id": "r", "error_lateral_m": 0.8}, 0.0, Level.OK, "RUNNING"),
        ({"reference_id": "r", "error_longitudinal_m": 2.1}, 0.0, Level.ERROR, "ahead"),
        ({"reference_id": "r", "error_yaw_rad": 0.36}, 0.0, Level.ERROR, "heading"),
        ({"error_yaw_rad": 0.36}, 0.0, Level.OK, "RUNNING"),
    ],
)
def test_an_objects_health(changes, age_s, level, text, run_mapping):
    board = _board(run_mapping)
    board.objects["ot1"] = LatestState(_state("ot1", **changes), NOW_NS - round(age_s * NS_PER_S))
    status = _health(board)["object ot1"]
    assert status.level is level
    assert text in status.message


def test_slow_links_and_wrong_clocks_are_warned_of(run_mapping):
    links = {"vut": LinkFact(0.16, 0.1), "ot1": LinkFact(0.0, 0.6), "walker": LinkFact()}
    found = _health(_board(run_mapping, links=LatestReport(links, NOW_NS)))
    assert "0.160 s off" in found["object vut"].message
    assert "takes 0.600 s" in found["object ot1"].message
    assert found["object walker"].level is Level.OK
    assert dict(found["object walker"].values)["link there and back, s"] == "unknown"


def test_links_of_a_manager_that_tells_nothing_any_more_are_not_known(run_mapping):
    links = {"ot1": LinkFact(0.0, 0.6)}
    old = NOW_NS - round(3.1 * NS_PER_S)
    found = _health(_board(run_mapping, links=LatestReport(links, old)))["object ot1"]
    assert found.level is Level.OK
    assert ("link there and back, s", "unknown") in found.values


def test_a_state_that_was_held_up_on_its_way_is_old(run_mapping):
    found = _health(_board(run_mapping, manager=ManagerStatus(NOW_NS, 3 * NS_PER_S)))
    assert found["object ot1"].level is Level.STALE
    assert ("state age, s", "2.000") in found["object ot1"].values


def test_a_replay_is_said_to_be_one(run_mapping):
    found = _health(_board(run_mapping, replay=True))["replay"]
    assert found.level is Level.WARN
    assert "nothing of this is live" in found.message


def _with(run_mapping: dict[str, Any], **changes: Any) -> RunSpec:
    return RunSpec.model_validate({**run_mapping, **changes})


def _close(points: Any, expected: Sequence[tuple[float, float]]) -> bool:
    return np.shape(points) == np.shape(expected) and np.allclose(points, expected, atol=1e-9)


@pytest.fixture
def crossing_run(run_mapping):
    """A walker crosses from the left, the VUT drives along x."""
    trigger = {
        "id": "walk",
        "condition": {
            "type": "any",
            "of": [
                {"type": "time_to_arrival", "anchor": [100.0, 0.0], "below_s": 3.0},
                {
                    "type": "in_region",
                    "object_id": "vut",
                    "polygon": [[0.0, -2.0], [9.0, -2.0], [9.0, 2.0]],
                },
            ],
        },
        "object_id": "walker",
        "manoeuvre": {
            "kind": "follow_path",
            "motion": {"path": [[100.0, 6.0], [100.0, -6.0]], "cruise_mps": 1.5},
        },
        "adaptation": {"anchor": [99.0, 0.0], "first": "initiator", "gap_s": 1.0},
    }
    vut = {
        **run_mapping["vut"],
        "approach": {"path": [[0.0, 0.0], [250.0, 0.0]], "cruise_mps": 10.0},
    }
    return _with(run_mapping, triggers=[trigger], vut=vut)


def test_fence_starts_and_bounds_are_those_of_the_run(run_mapping):
    drawing = drawing_of(RunSpec.model_validate(run_mapping))
    assert drawing.fence == ((0.0, 0.0), (300.0, -9.0), (300.0, 9.0))
    assert drawing.bounds_m == (0.0, -9.0, 300.0, 9.0)
    assert [(start.object_id, start.role) for start in drawing.starts] == [
        ("vut", Role.VUT),
        ("ot1", Role.OT),
        ("walker", Role.OT),
    ]
    assert {start.radius_m for start in drawing.starts} == {1.5}
    assert drawing.crossings == ()
    assert drawing.conflict_zones == ()


def test_lines_of_a_road_of_two_directions_turned_by_a_right_angle(run_mapping):
    road = {
        "origin": {"x_m": 5.0, "y_m": 0.0, "yaw_rad": math.pi / 2},
        "length_m": 50.0,
        "lanes": [
            {"y_m": 0.0, "width_m": 3.0, "direction": "forward"},
            {"y_m": 3.5, "width_m": 4.0, "direction": "backward"},
        ],
        "crossing_x_m": 20.0,
    }
    drawing = drawing_of(_with(run_mapping, road=road))
    by_kind: dict[str, list[Any]] = {}
    for line in drawing.road_lines:
        by_kind.setdefault(line.kind, []).append(line)
    # Left of a road that runs north is west.
    assert _close(by_kind["edge"][0].points, ((-0.5, 0.0), (-0.5, 50.0)))
    assert _close(by_kind["edge"][1].points, ((6.5, 0.0), (6.5, 50.0)))
    (divider,) = by_kind["divider"]
    assert divider.opposed
    assert _close(divider.points, ((3.5, 0.0), (3.5, 50.0)))
    assert _close(by_kind["centre"][0].points, ((5.0, 0.0), (5.0, 50.0)))
    assert _close(by_kind["centre"][1].points, ((1.5, 50.0), (1.5, 0.0)))
    (crossing,) = drawing.crossings
    assert _close(crossing, ((-0.5, 18.5), (-0.5, 21.5), (6.5, 21.5), (6.5, 18.5)))


def test_a_bend_is_drawn_round_and_lines_beyond_its_centre_are_left_out(run_mapping):
    piece = {"length_m": 10.0, "start_curvature_1pm": 0.25, "end_curvature_1pm": 0.25}
    road = {
        "origin": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
        "length_m": 10.0,
        "pieces": [piece],
        "lanes": [
            {"y_m": 0.0, "width_m": 3.0, "direction": "forward"},
            {"y_m": 3.5, "width_m": 4.0, "direction": "forward"},
        ],
    }
    drawing = drawing_of(_with(run_mapping, road=road))
    edges = [line for line in drawing.road_lines if line.kind == "edge"]
    assert len(edges) == 1  # the left one would lie at 5.5 m, and the bend's centre is at 4 m
    radii = [math.hypot(x, y - 4.0) for x, y in edges[0].points]
    assert radii == pytest.approx([5.5] * len(radii))
    assert len(radii) > 8


def test_a_walker_across_the_road_has_a_conflict_zone(crossing_run):
    drawing = drawing_of(crossing_run)
    (zone,) = drawing.conflict_zones
    assert zone.name == "walker"
    # Half the walker's corridor is 0.25 + 0.3 m, half the VUT's 0.9 + 0.3 m.
    xs, ys = zip(*zone.outline, strict=True)
    assert (min(xs), max(xs)) == pytest.approx((99.45, 100.55))
    assert (min(ys), max(ys)) == pytest.approx((-1.2, 1.2))
    assert point_in_polygon(100.0, 0.0, zone.outline)


def test_routes_anchors_and_regions_are_those_of_the_triggers(crossing_run):
    drawing = drawing_of(crossing_run)
    assert [(r.object_id, r.purpose, len(r.points)) for r in drawing.routes] == [
        ("vut", "approach", 2),
        ("walker", "manoeuvre", 2),
    ]
    assert [(anchor.name, anchor.at) for anchor in drawing.anchors] == [
        ("walk: conflict", (99.0, 0.0)),
        ("walk: arrival", (100.0, 0.0)),
    ]
    assert [region.name for region in drawing.regions] == ["walk: vut"]
