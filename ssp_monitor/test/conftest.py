"""Fixtures of the monitor's tests: a run file, and a small bag."""

from __future__ import annotations

import json

import pytest

from ssp_core.bag.writing.writer import BagWriter
from ssp_core.clock import NS_PER_S
from ssp_core.host.domains import free_domain
from ssp_core.host.shared_memory import remove_stale_shared_memory
from ssp_monitor.page.server import PageServer
from tests.support.bags.messages import clock
from tests.support.page_clients import TOKEN, Manager
from tests.support.runs import small_run

START = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}


@pytest.fixture
def run_mapping():
    """A valid run with two object targets."""
    walker = {"id": "walker", "object_class": "pedestrian", "start": START}
    car = {"id": "ot1", "object_class": "car", "start": START}
    return small_run(
        run_id="run_1",
        scenario="cut_in",
        mode="realtime",
        road={
            "origin": START,
            "length_m": 300.0,
            "lanes": [{"y_m": 0.0, "width_m": 3.5, "direction": "forward"}],
        },
        geofence=[[0.0, 0.0], [300.0, -9.0], [300.0, 9.0]],
        vut={**car, "id": "vut"},
        targets=[car, walker],
        limits={"speed_mps": 20.0, "acceleration_mps2": 5.0},
        camera={},
    )


@pytest.fixture
def run_file(tmp_path, run_mapping):
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps(run_mapping, indent=1))  # JSON is YAML too
    return path


@pytest.fixture
def clock_cdr():
    """Serialised /clock message at a time in ns."""
    return clock


@pytest.fixture
def small_bag(tmp_path, clock_cdr):
    """Ten /clock messages and an attachment."""
    path = tmp_path / "small"
    with BagWriter(path) as writer:
        writer.attach("run.yaml", b"seed: 1\n", "application/yaml")
        writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        for k in range(10):
            writer.write("/clock", clock_cdr(k * NS_PER_S), k * NS_PER_S, k * NS_PER_S)
    return path


@pytest.fixture
def domain(monkeypatch):
    """A ROS domain of the test's own, on this host."""
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with free_domain() as domain_id:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        yield domain_id
    remove_stale_shared_memory()


@pytest.fixture
def manager():
    return Manager()


@pytest.fixture
def page(manager):
    made = PageServer("127.0.0.1", 0, TOKEN, manager)
    yield made
    made.close()
