"""The node over real rclpy, in a process of its own: answers, errors, restart and stop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import CompressedImage

from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from ssp_core.names import DIAGNOSTICS, vla_request_topic, vla_response_topic
from ssp_core.ros import STATE, VLA, make_node, stamp_from_ns
from ssp_msgs.msg import VlaRequest, VlaResponse
from ssp_vla_bridge.backends.recorded import response_of_message
from ssp_vla_bridge.messages import CameraGeometry
from ssp_vla_bridge.ros.conversions import request_from_msg, request_to_msg, response_to_msg
from tests.support.processes.children import end
from tests.support.processes.waiting import DEADLINE_S

pytestmark = pytest.mark.ros

# A backend that does what the request's id says; the bridge finds it as module:factory.
ODD_BACKEND = """
    import time
    from ssp_vla_bridge.messages import Answer, NativeArray

    class Odd:
        model_id = "odd/1"

        def answer(self, request):
            word = request.request_id.split("-")[0]
            if word == "sleep":
                time.sleep(float(request.request_id.split("-")[1]))
            if word == "raise":
                raise RuntimeError("the model fell over")
            if word == "unfit":
                return Answer("x", (NativeArray("a", (-1,), (), "f", "m", 0.0, 0.0),))
            return Answer("done " + request.request_id, decoding={"seed": 1})

    def make(options):
        return Odd()
"""


@pytest.fixture
def domain(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with free_domain() as domain_id:
        yield domain_id
        remove_shared_ports(domain_id)
    remove_stale_shared_memory()


@pytest.fixture
def bridge(tmp_path, domain):
    """Starts bridges; each is gone at the end of the test."""
    started = []
    (tmp_path / "odd_backend.py").write_text(textwrap.dedent(ODD_BACKEND))

    def start(**parameters):
        command = [sys.executable, "-m", "ssp_vla_bridge.ros.vla_bridge", "--ros-args"]
        for name, value in parameters.items():
            command += ["-p", f"{name}:={value}"]
        path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
        process = subprocess.Popen(
            command,
            env={**session_environment(domain), "PYTHONPATH": path.rstrip(os.pathsep)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        end(process)


class Asker:
    """A client node of one model's topics."""

    def __init__(self, model, domain_id):
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node = make_node("asker", context=self.context)
        self.answers = []
        self.model = model
        self.publisher = self.node.create_publisher(VlaRequest, vla_request_topic(model), VLA)
        self.listen()
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def listen(self):
        self.subscription = self.node.create_subscription(
            VlaResponse, vla_response_topic(self.model), self.answers.append, VLA
        )

    def until(self, condition):
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > deadline:
                raise TimeoutError(f"not within {DEADLINE_S} s; answers so far: {self.answers}")
            self.executor.spin_once(timeout_sec=0.05)

    def connect(self, bridges=1):
        self.until(
            lambda: (
                self.publisher.get_subscription_count() == bridges
                and self.subscription.get_publisher_count() == bridges
            )
        )

    def ask(self, request):
        self.publisher.publish(request_to_msg(request))

    def answered(self, request_id):
        self.until(lambda: any(a.request_id == request_id for a in self.answers))
        return next(response_of_message(a) for a in self.answers if a.request_id == request_id)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def asker(domain):
    askers = []

    def make(model):
        askers.append(Asker(model, domain))
        return askers[-1]

    yield make
    for one in askers:
        one.close()


def test_conversions_round_trip(make_request, straight_history, make_response):
    camera = CameraGeometry(626.0, 626.0, 480.0, 270.0, 960, 540, 1.45, 0.03)
    for request in (
        make_request(history=straight_history(8.0), camera=camera),
        make_request(camera=replace(camera, height_m=None, pitch_down_rad=None)),
        make_request(jpegs=[]),
    ):
        assert request_from_msg(request_to_msg(request)) == request
    response = replace(
        make_response([(0, 0), (4, 0.5)]), decoding={"a": [1]}, error_code=2, error_msg="why"
    )
    assert response_of_message(response_to_msg(response)) == response


def test_a_text_that_the_middleware_would_cut_is_refused(make_response):
    with pytest.raises(ValueError, match="text holds a NUL"):
        response_to_msg(replace(make_response(), text="slow down\0 and more"))


def test_answers_with_id_and_stamp_and_in_order(bridge, asker, make_request, straight_history):
    bridge(model="constant_velocity")
    client = asker("constant_velocity")
    client.connect()
    history = straight_history(8.0)
    client.ask(make_request("one", 5_000_000_001, history=history))
    client.ask(make_request("two", 5_500_000_000, history=history))
    second = client.answered("two")
    assert [a.request_id for a in client.answers] == ["one", "two"]
    first = client.answered("one")
    assert first.stamp_ns == 5_000_000_001
    assert second.stamp_ns == 5_500_000_000
    assert first.model == "constant_velocity"
    assert first.text == "I keep my speed and stay in my lane."
    assert first.arrays[0].shape == (5, 2)
    assert 0.0 < first.latency_s < DEADLINE_S


def test_each_failure_costs_its_own_answer_only(bridge, asker, make_request):
    process = bridge(model="odd", backend="odd_backend:make")
    client = asker("odd")
    client.connect()

    def code_and_message(request):
        client.ask(request)
        answer = client.answered(request.request_id)
        return answer.error_code, answer.error_msg

    assert code_and_message(make_request("raise-1")) == (2, "RuntimeError: the model fell over")
    code, message = code_and_message(make_request("unfit-1"))
    assert (code, "fits no message" in message) == (2, True)
    code, message = code_and_message(make_request("bad-1", jpegs=[b"garbage"]))
    assert (code, "frames[0]" in message) == (4, True)
    assert code_and_message(make_request("bad-2", jpegs=[])) == (4, "it has no frames")
    empty = VlaRequest(request_id="empty", frames=[CompressedImage()])
    empty.header.stamp = stamp_from_ns(3)
    client.publisher.publish(empty)
    assert client.answered("empty").error_code == 4
    assert code_and_message(make_request("fine-1")) == (0, "")
    process.terminate()
    output, _ = process.communicate(timeout=DEADLINE_S)
    assert "Traceback" in output
    assert "the model fell over" in output
    assert process.returncode == 0


def test_overload_and_timeout_are_said(bridge, asker, make_request):
    bridge(model="odd", backend="odd_backend:make", queue_limit=1, timeout_s=2.0)
    client = asker("odd")
    client.connect()
    client.ask(make_request("sleep-4"))
    for name in ("wait-1", "wait-2", "wait-3"):
        client.ask(make_request(name))
    client.until(lambda: len(client.answers) == 4)
    # Which one waits depends on when the worker takes the first; at most one ever does.
    codes = {a.request_id: a.error_code for a in client.answers}
    assert codes["sleep-4"] == 1
    assert sorted(codes.values()) in ([1, 1, 3, 3], [1, 3, 3, 3])
    client.ask(make_request("sleep-0"))
    assert client.answered("sleep-0").error_code in (0, 1)
    assert len({a.request_id for a in client.answers}) == len(client.answers)


def test_a_refusal_waits_for_who_can_hear_it(bridge, asker, make_request):
    """The bridge may know of an asker before its answers can reach the asker."""
    process = bridge(model="odd", backend="odd_backend:make")
    client = asker("odd")
    client.node.destroy_subscription(client.subscription)
    client.until(lambda: client.publisher.get_subscription_count() == 1)
    client.ask(make_request("bad-1", jpegs=[]))
    assert any("'bad-1': it has no frames" in line for line in process.stdout)
    client.listen()
    assert client.answered("bad-1").error_code == 4


def test_a_killed_bridge_is_replaced_by_a_new_one(bridge, asker, make_request):
    first = bridge(model="odd", backend="odd_backend:make")
    client = asker("odd")
    client.connect()
    client.ask(make_request("sleep-60"))
    client.ask(make_request("lost"))
    first.kill()
    first.wait()
    bridge(model="odd", backend="odd_backend:make")
    # The killed process' endpoints may linger until their lease ends, so only the new one's
    # answer is waited for.
    deadline = time.monotonic() + DEADLINE_S
    while not client.answers and time.monotonic() < deadline:
        client.ask(make_request("again"))
        client.executor.spin_once(timeout_sec=0.2)
    assert {a.request_id for a in client.answers} == {"again"}


def test_sigterm_stops_it_while_the_backend_works(bridge, asker, make_request):
    process = bridge(model="odd", backend="odd_backend:make")
    client = asker("odd")
    client.connect()
    client.ask(make_request("fine"))
    client.answered("fine")
    client.ask(make_request(f"sleep-{2 * DEADLINE_S:g}"))
    client.executor.spin_once(timeout_sec=0.3)
    process.send_signal(signal.SIGTERM)
    output, _ = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0
    assert "Traceback" not in output


def test_health_is_said_and_names_the_error(bridge, asker, make_request):
    bridge(model="odd", backend="odd_backend:make")
    client = asker("odd")
    heard = []
    client.node.create_subscription(DiagnosticArray, DIAGNOSTICS, heard.append, STATE)
    client.connect()
    client.ask(make_request("fine-1"))
    client.answered("fine-1")
    client.until(lambda: heard and heard[-1].status[0].message == "answering")
    for name in ("raise-1", "raise-2", "raise-3"):
        client.ask(make_request(name))
        client.answered(name)
    client.until(lambda: heard[-1].status[0].level == b"\x02")
    status = heard[-1].status[0]
    assert (status.name, status.hardware_id) == ("ssp: vla_bridge odd", "vla_bridge_odd")
    assert status.message.endswith("RuntimeError: the model fell over")
    values = {value.key: value.value for value in status.values}
    assert (values["answered"], values["errors: backend"]) == ("1", "3")


def test_wrong_parameters_stop_it_with_the_reason(bridge):
    for parameters, words in (
        ({"model": "no_such_model"}, "known:"),
        ({"model": "a/b"}, "letters, digits and underscores"),
        ({"model": "silent", "queue_limit": 0}, "queue_limit"),
        ({"model": "silent", "timeout_s": 0.0}, "timeout_s"),
        ({"model": "silent", "shadow_hz": -1.0}, "shadow_hz"),
        ({"model": "silent", "interface": "telepathy"}, "waypoints"),
        ({"model": "silent", "backend_options": "'[1]'"}, "backend_options"),
    ):
        process = bridge(**parameters)
        output, _ = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1
        assert words in output
        assert "Traceback" not in output
