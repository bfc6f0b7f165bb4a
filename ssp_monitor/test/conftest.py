"""Fixtures of the monitor's tests: a run file, and a small bag."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ssp_core.bag.types import serialize, typestore
from ssp_core.bag.writer import BagWriter
from ssp_core.clock import NS_PER_S

START = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}


@pytest.fixture
def run_mapping() -> dict[str, Any]:
    """A valid run with two object targets."""
    return {
        "schema": "ssp.run/1",
        "run_id": "run_1",
        "scenario": "cut_in",
        "interaction": "cut_in",
        "domain": "simulation",
        "stand_in": False,
        "event_version": "sha256:00",
        "site": "site",
        "site_version": "sha256:00",
        "seed": 1,
        "mode": "realtime",
        "road": {
            "origin": START,
            "length_m": 300.0,
            "lanes": [{"y_m": 0.0, "width_m": 3.5, "direction": "forward"}],
        },
        "geofence": [[0.0, 0.0], [300.0, -9.0], [300.0, 9.0]],
        "vut": {"id": "vut", "object_class": "car", "start": START},
        "driver": {"cruise_mps": 10.0},
        "targets": [
            {"id": "ot1", "object_class": "car", "start": START},
            {"id": "walker", "object_class": "pedestrian", "start": START},
        ],
        "triggers": [
            {
                "id": "t",
                "condition": {"type": "relative_distance", "object_id": "ot1", "below_m": 10.0},
                "object_id": "ot1",
                "manoeuvre": {
                    "kind": "lane_change",
                    "lateral_shift_m": 1.0,
                    "duration_s": 1.0,
                    "cruise_mps": 10.0,
                },
            }
        ],
        "limits": {"speed_mps": 20.0, "acceleration_mps2": 5.0},
    }


@pytest.fixture
def run_file(tmp_path: Path, run_mapping: dict[str, Any]) -> Path:
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps(run_mapping, indent=1))  # JSON is YAML too
    return path


@pytest.fixture
def clock_cdr() -> Callable[[int], bytes]:
    """Serialised /clock message at a time in ns."""
    types = typestore().types

    def make(stamp_ns: int) -> bytes:
        stamp = types["builtin_interfaces/msg/Time"](
            sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S
        )
        return serialize(types["rosgraph_msgs/msg/Clock"](clock=stamp))

    return make


@pytest.fixture
def small_bag(tmp_path: Path, clock_cdr: Callable[[int], bytes]) -> Path:
    """Ten /clock messages and an attachment."""
    path = tmp_path / "small"
    with BagWriter(path) as writer:
        writer.attach("run.yaml", b"seed: 1\n", "application/yaml")
        writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        for k in range(10):
            writer.write("/clock", clock_cdr(k * NS_PER_S), k * NS_PER_S, k * NS_PER_S)
    return path
