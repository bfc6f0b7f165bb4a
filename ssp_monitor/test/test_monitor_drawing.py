"""The scene of a run as lines and outlines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from ssp_core.geometry import point_in_polygon
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Role
from ssp_core.world.road_drawing import drawing_of


def _with(run_mapping: dict[str, Any], **changes: Any) -> RunSpec:
    return RunSpec.model_validate({**run_mapping, **changes})


def _close(points: Any, expected: Sequence[tuple[float, float]]) -> bool:
    return np.shape(points) == np.shape(expected) and np.allclose(points, expected, atol=1e-9)


@pytest.fixture
def crossing_run(run_mapping: dict[str, Any]) -> RunSpec:
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


def test_fence_starts_and_bounds_are_those_of_the_run(run_mapping: dict[str, Any]) -> None:
    drawing = drawing_of(RunSpec.model_validate(run_mapping))
    assert drawing.fence == ((0.0, 0.0), (300.0, -9.0), (300.0, 9.0))
    assert drawing.bounds_m == (0.0, -9.0, 300.0, 9.0)
    assert [(start.object_id, start.role) for start in drawing.starts] == [
        ("vut", Role.VUT),
        ("ot1", Role.OT),
        ("walker", Role.OT),
    ]
    assert {start.radius_m for start in drawing.starts} == {1.5}
    assert drawing.crossing is None
    assert drawing.conflict_zones == ()


def test_lines_of_a_road_of_two_directions_turned_by_a_right_angle(
    run_mapping: dict[str, Any],
) -> None:
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
    assert _close(drawing.crossing, ((-0.5, 18.5), (-0.5, 21.5), (6.5, 21.5), (6.5, 18.5)))


def test_a_bend_is_drawn_round_and_lines_beyond_its_centre_are_left_out(
    run_mapping: dict[str, Any],
) -> None:
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


def test_a_walker_across_the_road_has_a_conflict_zone(crossing_run: RunSpec) -> None:
    drawing = drawing_of(crossing_run)
    (zone,) = drawing.conflict_zones
    assert zone.name == "walker"
    # Half the walker's corridor is 0.25 + 0.3 m, half the VUT's 0.9 + 0.3 m.
    xs, ys = zip(*zone.outline, strict=True)
    assert (min(xs), max(xs)) == pytest.approx((99.45, 100.55))
    assert (min(ys), max(ys)) == pytest.approx((-1.2, 1.2))
    assert point_in_polygon(100.0, 0.0, zone.outline)


def test_routes_anchors_and_regions_are_those_of_the_triggers(crossing_run: RunSpec) -> None:
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
