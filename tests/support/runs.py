"""A run of one target that stands at 40 m."""

from __future__ import annotations

from typing import Any


def small_run(**changes: Any) -> dict[str, Any]:
    """The run as its file has it; keywords replace its parts."""
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
