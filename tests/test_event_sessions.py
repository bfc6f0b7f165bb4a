"""Whole sessions in one process: events on sites, braking in a bend, a standing target."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ssp_core.cli import main
from ssp_core.geometry import Pose2
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import CurvePiece
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.run.sweep import for_one_process, run_one
from tests.support.bags.messages import messages
from tests.support.bags.of_events import check_event
from tests.support.runs import small_run

# The other sites' sessions run over DDS (system/test_session_runs.py).
EVENTS = [
    ("cut_in", "south_loop"),
    ("lead_braking", "boulevard"),
    ("lead_braking", "south_loop"),
    ("occluded_crossing", "boulevard"),
    ("occluded_crossing", "north_track"),
]
NOISE = {"state_delay_s": 0.02, "position_noise_m": 0.02, "speed_noise_mps": 0.05}


def given(**changes: Any) -> dict[str, Any]:
    """A run on a straight road with two lanes forward, its VUT at 11 m/s in the right one."""
    lanes = [{"y_m": y_m, "width_m": 3.5, "direction": "forward"} for y_m in (0.0, 3.5)]
    road = {
        "origin": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
        "length_m": 400.0,
        "lanes": lanes,
        "sidewalk_left_m": 3.0,
        "sidewalk_right_m": 3.0,
    }
    vut = {
        "id": "vut",
        "object_class": "car",
        "start": {"x_m": 10.0, "y_m": 0.0, "yaw_rad": 0.0},
        "approach": {"path": [(10.0, 0.0), (380.0, 0.0)], "cruise_mps": 11.0},
    }
    own: dict[str, Any] = {
        "scenario": "given",
        "interaction": "given",
        "seed": 3,
        "road": road,
        "geofence": [(0.0, -6.0), (400.0, -6.0), (400.0, 9.0), (0.0, 9.0)],
        "vut": vut,
        "driver": {"cruise_mps": 11.0},
        "disturbance": NOISE,
    }
    return small_run(**(own | changes))


K = 1.0 / 70.0
PIECES = [
    CurvePiece(length_m=70.0),
    CurvePiece(length_m=40.0, end_curvature_1pm=K),
    CurvePiece(length_m=70.0, start_curvature_1pm=K, end_curvature_1pm=K),
    CurvePiece(length_m=40.0, start_curvature_1pm=K),
    CurvePiece(length_m=80.0),
]
LINE = ReferenceLine(Pose2(120.0, 40.0, 2.5), PIECES)


def lead_braking() -> dict[str, Any]:
    """The VUT follows through a bend, and the car ahead brakes in it."""

    def start(s_m: float) -> dict[str, float]:
        x, y = LINE.to_map(s_m, 0.0)
        return {"x_m": x, "y_m": y, "yaw_rad": LINE.pose(s_m).yaw_rad}

    straight = given()
    road = straight["road"] | {
        "origin": start(0.0),
        "length_m": LINE.length_m,
        "pieces": [piece.model_dump() for piece in PIECES],
    }
    vut = {"path": LINE.path(10.0, 290.0, 0.0), "cruise_mps": 11.0}
    lead = {
        "id": "ot1",
        "object_class": "car",
        "start": start(42.0),
        "approach": {"path": LINE.path(42.0, 280.0, 0.0), "cruise_mps": 9.0},
    }
    trigger = {
        "id": "close",
        "condition": {"type": "relative_distance", "object_id": "ot1", "below_m": 22.0},
        "not_before_s": 6.0,
        "object_id": "ot1",
        "manoeuvre": {"kind": "brake", "to_mps": 2.0, "deceleration_mps2": 4.5},
    }
    return straight | {
        "observable": "braking",
        "road": road,
        "geofence": LINE.path(0.0, 300.0, -6.0) + LINE.path(300.0, 0.0, 9.0),
        "vut": straight["vut"] | {"start": start(10.0), "approach": vut},
        "targets": [lead],
        "triggers": [trigger],
        "thresholds": {"ttc_s": 3.0, "arrival_gap_s": None},
        "traffic": [
            {"id": "beside", "object_class": "car", "lane": 1, "x_m": 60.0, "speed_mps": 8.0}
        ],
        "camera": {"width_px": 320, "height_px": 180},
    }


def parked_truck() -> dict[str, Any]:
    """A pedestrian at 121 m behind a truck; neither stands first in the list by chance."""
    truck = {
        "id": "ot2",
        "object_class": "truck",
        "start": {"x_m": 112.0, "y_m": -3.0, "yaw_rad": 0.0},
    }
    person = {
        "id": "ot1",
        "object_class": "pedestrian",
        "start": {"x_m": 121.0, "y_m": -2.6, "yaw_rad": 1.5707963},
    }
    walk = {"path": [(121.0, -2.6), (121.0, 7.0)], "cruise_mps": 1.5, "acceleration_mps2": 1.5}
    trigger = {
        "id": "near",
        "condition": {"type": "time_to_arrival", "anchor": (121.0, 0.0), "below_s": 3.2},
        "object_id": "ot1",
        "manoeuvre": {"kind": "follow_path", "motion": walk},
    }
    return given(initiator="ot1", targets=[truck, person], triggers=[trigger])


def recorded(tmp_path: Path, mapping: dict[str, Any]) -> Path:
    """The bag of a valid session of a run file."""
    spec = RunSpec.model_validate(mapping)
    told = run_one(for_one_process(spec, camera=True), tmp_path, False, recorded=True)
    assert (told["verdict"], told["reasons"]) == ("valid", [])
    return tmp_path / "bag"


@pytest.mark.parametrize(("event", "site"), EVENTS)
def test_events_compiled_for_sites_are_valid(event: str, site: str, tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = ["run", event, "--site", site, "--in-process", "--record", "--no-camera"]
    assert main([*command, "--out", str(out)]) == 0
    check_event(out, json.loads((out / "result.json").read_text()))


def seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def test_a_lead_vehicle_brakes_in_a_bend(tmp_path: Path) -> None:
    bag = recorded(tmp_path, lead_braking())
    phases = messages(bag, "/ssp/phase_event")
    assert [m.phase for m in phases] == [1, 2, 3, 4]
    (trigger,) = messages(bag, "/ssp/trigger_event")
    seen = seconds(phases[1].header.stamp) - seconds(trigger.crossing_time)
    # Sent at once, executed 0.1 s later, and seen when deceleration has built up to 1 m/s^2.
    assert 0.1 < seen < 0.6
    assert "deceleration" in phases[1].evidence
    states = [m for m in messages(bag, "/ssp/ot1/state") if m.reference_id]
    assert max(abs(m.error_longitudinal) for m in states) < 1.0
    lowest = min(m.acceleration for m in states)
    assert -5.0 < lowest < -4.0
    braked = [m.speed for m in states if seconds(m.header.stamp) > seconds(trigger.crossing_time)]
    assert any(1.8 < v < 2.2 for v in braked)
    for name in ("ot1", "vut"):
        path = [LINE.to_local(m.x, m.y) for m in messages(bag, f"/ssp/{name}/state")]
        assert max(abs(offset) for _, offset in path) < 0.3
        assert path[-1][0] > 150.0  # far into the bend
    assert len(messages(bag, "/ssp/vut/front_camera/image/compressed")) > 50
    assert not messages(bag, "/ssp/safety_event")


def test_a_standing_target_without_a_trigger_takes_part(tmp_path: Path) -> None:
    bag = recorded(tmp_path, parked_truck())
    assert [m.phase for m in messages(bag, "/ssp/phase_event")] == [1, 2, 3, 4]
    assert {m.object_id for m in messages(bag, "/ssp/ot1/reference_ack")} == {"ot1"}
    assert not messages(bag, "/ssp/ot2/reference")
    truck = messages(bag, "/ssp/ot2/state")
    assert len(truck) > 200
    assert max(m.speed for m in truck) == 0.0
    # It runs with the others all the same, and is the object of limits and of silence.
    assert {m.control_state for m in truck} >= {3, 2, 4}
    assert not messages(bag, "/ssp/safety_event")
