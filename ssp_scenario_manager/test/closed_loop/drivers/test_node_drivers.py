"""A bridge's node that runs already as the driver of the VUT (docs/closed-loop.md)."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError, PeerError
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from ssp_core.run_file.latency import Latency
from ssp_core.world.driver import driver_options
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver
from ssp_scenario_manager.closed_loop.campaigns.runs import drive_start
from ssp_scenario_manager.closed_loop.outcomes.outcome import DriverRun
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_vla_bridge.backend import DeclinedError, make_backend
from ssp_vla_bridge.backends.node import error_of
from tests.support.processes.children import end

BACKENDS = """
import os

class Odd:
    model_id = "odd/1"

    def __init__(self, does):
        self.does = does

    def answer(self, request):
        if self.does == "leaves":
            os._exit(3)
        raise RuntimeError("no weights")

def raises(options):
    return Odd("raises")

def leaves(options):
    return Odd("leaves")
"""


# A bridge of others, whose answers have an error code that VlaResponse.msg doesn't have.
OTHERS = """
import rclpy
from rclpy.qos import QoSProfile
from ssp_msgs.msg import VlaRequest, VlaResponse

rclpy.init()
node = rclpy.create_node("others")
publisher = node.create_publisher(VlaResponse, "/ssp/vla/theirs/response", QoSProfile(depth=10))

def answer(request):
    publisher.publish(VlaResponse(request_id=request.request_id, error_code=99, error_msg="odd"))

node.create_subscription(VlaRequest, "/ssp/vla/theirs/request", answer, QoSProfile(depth=10))
rclpy.spin(node)
"""


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    """A critical start of the shipped cut-in."""
    folder = tmp_path_factory.mktemp("nodes") / "cut_in"
    compiled = prepare_run("cut_in", "boulevard", folder, seed=1, mode="lockstep")
    return make_start(compiled, load_event("cut_in")[0], 1, latency_max_s=1.0)


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with free_domain() as domain_id:
        yield domain_id
        remove_shared_ports(domain_id)
    remove_stale_shared_memory()


@pytest.fixture
def bridge(domain: int, tmp_path: Path) -> Iterator[Callable[[str], Any]]:
    """Starts the bridge ``theirs`` with a backend; it is gone at the end of the test."""
    started = []
    (tmp_path / "odd_backends.py").write_text(BACKENDS)

    def begin(backend: str) -> Any:
        command = [sys.executable, "-m", "ssp_vla_bridge.ros.vla_bridge", "--ros-args"]
        command += ["-p", "model:=theirs", "-p", f"backend:={backend}"]
        if backend == "others":
            command = [sys.executable, "-c", OTHERS]
        process = subprocess.Popen(command, cwd=tmp_path, env=session_environment(domain))
        started.append(process)
        return process

    yield begin
    for process in started:
        end(process)


def led(start: Start, **given: Any) -> DriverRun:
    driver = CampaignDriver(driver="mine", options=driver_options("mine", given))
    return drive_start(start, driver, Latency(0.3))


@pytest.mark.ros
def test_a_bridge_that_runs_already_drives_as_its_backend_does_run_after_run(
    start: Start, domain: int, bridge: Callable[[str], Any]
) -> None:
    process = bridge("opencv_baseline")
    node = partial(led, start, backend="node", topic="theirs", domain_id=domain)
    loaded = led(start, backend="opencv_baseline")
    first, second = node(), node()
    vut = start.run.vut.id
    states = [list(one.record.truths(vut)) for one in (loaded, first, second)]
    assert states[0] == states[1] == states[2]
    assert loaded.outcome == first.outcome == second.outcome
    end(process)
    gone = node(start_s=1.0)
    assert gone.outcome.kind == "died"
    assert "no bridge of theirs in domain" in gone.outcome.why


@pytest.mark.ros
def test_an_error_of_a_running_bridge_is_a_refused_plan_and_its_end_the_drivers(
    start: Start, domain: int, bridge: Callable[[str], Any]
) -> None:
    for does, kind, why in (
        ("odd_backends:raises", "fallback", "no weights"),
        ("others", "fallback", "vla/theirs/response: error_code is no number of VlaResponse.msg"),
        ("odd_backends:leaves", "died", "left its topics"),
    ):
        process = bridge(does)
        drove = led(start, backend="node", topic="theirs", domain_id=domain)
        assert drove.outcome.kind == kind
        first = drove.answers[0].given
        assert why in (first.ended or getattr(first.answer, "refused", ""))
        end(process)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"domain_id": 1}, "topic"),
        ({"topic": "a b", "domain_id": 1}, "topic"),
        ({"topic": "theirs"}, "domain_id.*is missing"),
        ({"topic": "theirs", "domain_id": 233}, "domain_id.*must lie in"),
    ],
)
def test_a_bridge_without_a_place_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        make_backend("node", given)


def test_an_error_code_that_the_message_does_not_have_is_named_with_those_that_it_has() -> None:
    assert error_of("vla/theirs/response", 0, "") is None
    declined = error_of("vla/theirs/response", 6, "filtered")
    assert (type(declined), str(declined)) == (DeclinedError, "filtered")
    unknown = error_of("vla/theirs/response", 99, "odd")
    assert type(unknown) is PeerError
    assert str(unknown) == (
        "vla/theirs/response: error_code is no number of VlaResponse.msg (got 99, and 'odd'); "
        "expected is one of 0 NONE, 1 TIMEOUT, 2 BACKEND, 3 OVERLOAD, 4 BAD_REQUEST, 5 BROKEN_OFF, "
        "6 DECLINED"
    )
