"""Runs of one target."""

from __future__ import annotations

from typing import Any

_START = {"x_m": 10.0, "y_m": 0.0, "yaw_rad": 0.0}
# The VUT drives 380 m straight on; a target stands in its lane at 200 m.
APPROACH: dict[str, Any] = {
    "vut": {
        "id": "vut",
        "object_class": "car",
        "start": _START,
        "approach": {"path": [(10.0, 0.0), (390.0, 0.0)], "cruise_mps": 10.0},
    },
    "targets": [{"id": "ot1", "object_class": "car", "start": {**_START, "x_m": 200.0}}],
}


def small_run(**changes: Any) -> dict[str, Any]:
    """A run of a target that stands at 40 m, as its file has it; keywords replace its parts."""
    start = {"x_m": 40.0, "y_m": 0.0, "yaw_rad": 0.0}
    return {
        "schema": "ssp.run/1",
        "run_id": "r",
        "scenario": "s",
        "interaction": "cut_in",
        "domain": "simulation",
        "stand_in": False,
        "event_version": "sha256:event",
        "site": "s",
        "site_version": "sha256:s",
        "seed": 1,
        "mode": "lockstep",
        "road": {
            "origin": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
            "length_m": 400.0,
            "lanes": [{"y_m": 0.0, "width_m": 3.5, "direction": "forward"}],
        },
        "geofence": [(0.0, -8.0), (400.0, -8.0), (400.0, 12.0), (0.0, 12.0)],
        "vut": {"id": "vut", "object_class": "car", "start": {**start, "x_m": 10.0}},
        "driver": {"cruise_mps": 10.0},
        "targets": [{"id": "ot1", "object_class": "car", "start": start}],
        "triggers": [
            {
                "id": "t",
                "condition": {"type": "relative_distance", "object_id": "ot1", "below_m": 9.0},
                "object_id": "ot1",
                "manoeuvre": {
                    "kind": "lane_change",
                    "lateral_shift_m": -3.5,
                    "duration_s": 2.5,
                    "cruise_mps": 8.0,
                },
            }
        ],
        "limits": {"speed_mps": 15.0, "acceleration_mps2": 5.0},
        "camera": None,
        **changes,
    }


def cut_in_run() -> dict[str, Any]:
    """A run of a target that drives in the left lane and cuts in, as its file has it."""
    start = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    lanes = [{"y_m": y_m, "width_m": 3.5, "direction": "forward"} for y_m in (0.0, 3.5)]
    made = small_run(
        run_id="run-1",
        scenario="cut_in",
        site="straight",
        site_version="sha256:site",
        road={"origin": start, "length_m": 300.0, "lanes": lanes},
        geofence=[(-10.0, -6.0), (300.0, -6.0), (300.0, 10.0), (-10.0, 10.0)],
        vut={
            "id": "vut",
            "object_class": "car",
            "start": start,
            "approach": {"path": [(0.0, 0.0), (250.0, 0.0)], "cruise_mps": 10.0},
        },
        targets=[
            {
                "id": "ot1",
                "object_class": "car",
                "start": {"x_m": 40.0, "y_m": 3.5, "yaw_rad": 0.0},
                "approach": {"path": [(40.0, 3.5), (250.0, 3.5)], "cruise_mps": 7.0},
            }
        ],
    )
    made["triggers"][0] |= {"id": "gap"}
    made["triggers"][0]["condition"]["below_m"] = 12.0
    made["triggers"][0]["manoeuvre"]["cruise_mps"] = 6.0
    # Tests move objects at will: what is no jump, and no frozen position, is wide here.
    made["limits"] |= {"jump_m": 100.0, "frozen_s": 60.0}
    return made


# Of a campaign's sealed start, beside its run, hash, kind and seed.
START_FACTS: dict[str, Any] = {
    "values": {"driver.cruise_mps": 9.3},
    "hand_over_s": 8.0,
    "first_request_s": 6.3,
    "observable_s": 10.5,
    "end_s": 18.0,
    "frame_period_s": 0.1,
    "contact_s": 13.0,
    "v_r_mps": 9.5,
    "triggers_s": [10.0],
    "left_out": ["traffic"],
    "camera": None,
}
