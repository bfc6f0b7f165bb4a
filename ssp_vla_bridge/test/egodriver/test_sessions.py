"""The lifetime of a served session: all is released when no client waits for it any more."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import grpc  # type: ignore[import-untyped] # has no types
import pytest
from carla_driver_interface import protocol as proto
from carla_driver_interface.driver import CameraFrame, SessionState
from carla_driver_interface.geometry import Pose, Trajectory
from carla_driver_interface.testing import FakeCamera

from ssp_vla_bridge.driving.driver import DriverModel
from ssp_vla_bridge.egodriver import policy as policies
from ssp_vla_bridge.egodriver.policy import BridgePolicy, Seat
from ssp_vla_bridge.egodriver.server import Listening, serving
from ssp_vla_bridge.window import find_interface
from tests.support.models.egodrivers import grey
from tests.support.processes.waiting import DEADLINE_S

# It says that it is there, and waits for a word, while it is loaded or asked.
MODEL = """
def wait():
    with open({began!r}, "w") as said:
        said.write("here")
    with open({release!r}) as heard:
        heard.read()

if {loads_slowly}:
    wait()


def answer(request):
    wait()
    return ""
"""


@dataclass
class Gate:
    """A gate at which a model reports that it waits, until the test lets it go on."""

    began: Path
    release: Path

    def await_model(self) -> None:
        with self.began.open() as said:
            assert said.read() == "here"

    def open(self) -> None:
        self.await_model()
        with self.release.open("w") as told:
            told.write("on")


def gated(folder: Path, *, loads_slowly: bool) -> tuple[DriverModel, Gate]:
    gate = Gate(folder / "began", folder / "release")
    os.mkfifo(gate.began)
    os.mkfifo(gate.release)
    name = f"gated_{'load' if loads_slowly else 'answer'}"
    (folder / f"{name}.py").write_text(
        MODEL.format(began=str(gate.began), release=str(gate.release), loads_slowly=loads_slowly)
    )
    return model("python", function=f"{name}:answer", folder=str(folder)), gate


def model(backend: str, **options: Any) -> DriverModel:
    spoken = find_interface("waypoints")
    rules, adapter = spoken.preprocessing, spoken.adapter
    return DriverModel("mine", backend, options, spoken, adapter, rules, timeout_s=DEADLINE_S)


class Client:
    """A client of the contract, without ours."""

    def __init__(self, channel: grpc.Channel) -> None:
        self.stub: Any = proto.EgodriverServiceStub(channel)  # type: ignore[no-untyped-call] # no types

    def start(self, name: str, camera: proto.AvailableCamera | None = None) -> Any:
        request = proto.DriveSessionRequest(session_uuid=name)
        declared = FakeCamera().available_camera() if camera is None else camera
        request.rollout_spec.vehicle.available_cameras.append(declared)
        return self.stub.start_session.future(request)

    def route(self, name: str) -> Any:
        return self.stub.submit_route.future(proto.RouteRequest(session_uuid=name))

    def close(self, name: str) -> None:
        self.stub.close_session(proto.DriveSessionCloseRequest(session_uuid=name))

    def see(self, name: str) -> None:
        """Send one frame and one pose, of the same time."""
        image = proto.RolloutCameraImage(session_uuid=name)
        image.camera_image.logical_id = FakeCamera().logical_id
        image.camera_image.frame_end_us = 1_000_000
        image.camera_image.image_bytes = grey()
        self.stub.submit_image_observation(image)
        motion = proto.RolloutEgoTrajectory(session_uuid=name)
        here = Pose.from_xyz_yaw(0.0, 0.0, 0.0, 0.0)
        motion.trajectory.poses.append(here.to_proto_at_time(1_000_000))
        self.stub.submit_egomotion_observation(motion)


def code(call: Any) -> str:
    error = call.exception()
    return "OK" if error is None else str(error.code().name)


@contextmanager
def served(policy: BridgePolicy) -> Iterator[Client]:
    with (
        serving(policy, "alpasim", Listening(port=0)) as url,
        grpc.insecure_channel(url[7:]) as channel,
    ):
        yield Client(channel)


def await_free(policy: BridgePolicy) -> None:
    with policy._lock:
        assert policy._lock.wait_for(lambda: policy.seat_count == 0, DEADLINE_S)


@pytest.mark.parametrize("how", ["gives up", "closes"])
def test_a_session_that_nobody_waits_for_ends_while_its_model_loads(
    how: str, tmp_path: Path
) -> None:
    """Its model's process ends, and its name and its place are free."""
    slow, gate = gated(tmp_path, loads_slowly=True)
    policy = BridgePolicy(slow, most_sessions=1)
    with served(policy) as client:
        given_up = client.start("one")
        gate.await_model()
        if how == "gives up":
            given_up.cancel()
        else:
            client.close("one")
            assert code(given_up) == "FAILED_PRECONDITION"
        await_free(policy)
        again = client.start("one")
        gate.open()
        assert code(again) == "OK"


def test_a_session_that_is_closed_while_its_model_answers_ends_at_once(tmp_path: Path) -> None:
    slow, gate = gated(tmp_path, loads_slowly=False)
    policy = BridgePolicy(slow, most_sessions=1)
    with served(policy) as client, ThreadPoolExecutor(1) as pool:
        assert code(client.start("one")) == "OK"
        client.see("one")
        asked = client.stub.drive.future(
            proto.DriveRequest(session_uuid="one", time_now_us=1_000_000)
        )
        gate.await_model()
        # It doesn't wait for the answer, which never comes.
        pool.submit(client.close, "one").result(DEADLINE_S)
        assert "ended by SIGKILL" in asked.exception().details()
        await_free(policy)
        assert code(client.start("one")) == "OK"


def test_a_server_that_ends_leaves_no_model_that_loads(tmp_path: Path) -> None:
    slow, gate = gated(tmp_path, loads_slowly=True)
    policy = BridgePolicy(slow)
    with served(policy) as client:
        # A call that nothing refers to is cancelled.
        begun = client.start("one")
        gate.await_model()
    assert begun.exception() is not None
    assert policy.seat_count == 0


def test_a_place_is_given_to_a_new_session_once_no_call_came_for_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Any call counts; and of the session that had it nothing is left, its name included."""
    clock = [0.0]
    monkeypatch.setattr(policies, "time", SimpleNamespace(monotonic=lambda: clock[0]))
    policy = BridgePolicy(model("constant_velocity"), most_sessions=1)
    with served(policy) as client:
        # What a session has used is read when it begins.
        assert code(client.start("one")) == "OK"
        clock[0] = 500.0
        assert code(client.route("one")) == "OK"
        clock[0] = 1099.0
        assert code(client.start("two")) == "RESOURCE_EXHAUSTED"
        clock[0] = 1100.0
        assert code(client.start("two")) == "OK"
        assert code(client.route("one")) == "NOT_FOUND"
        clock[0] = 1700.0
        assert code(client.start("one")) == "OK"
        assert code(client.start("one")) == "ALREADY_EXISTS"
        assert policy.seat_count == 1


def test_each_new_session_has_an_idle_place_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two that begin at once close two idle ones, and a name that is there closes none."""
    monkeypatch.setattr(policies, "IDLE_S", 0.0)
    policy = BridgePolicy(model("constant_velocity"), most_sessions=2)
    for name in ("a", "b"):
        policy.take(name, Seat(lambda: True, driver=cast("Any", object())))
    assert policy.take("a", Seat(lambda: True)) == (policies.EXISTS, "")
    new = [policy.take(name, Seat(lambda: True)) for name in ("c", "d", "e")]
    assert [why.split(" ")[0] for why, _ in new] == ["", "", "there"]
    assert sorted(idle for _, idle in new) == ["", "a", "b"]


def test_what_a_session_keeps_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(policies, "_MOST_FRAME_BYTES", 100)
    policy = BridgePolicy(model("constant_velocity"), camera="front")
    cameras = {name: FakeCamera().available_camera() for name in ("front", "rear")}
    session = SessionState("one", 1, "", cameras)
    assert policy.take("one", Seat(lambda: True)) == ("", "")
    policy.on_session_start(session)
    for k in range(10):
        for name in ("front", "rear", "unheard"):
            frame = CameraFrame(name, k, k, bytes(40))
            session.frame_history.setdefault(name, []).append(frame)
            policy.on_frame(session, frame)
    assert [one.timestamp_us for one in session.frame_history.pop("front")] == [8, 9]
    assert not session.frame_history
    for k in range(5000):
        session.ego_trajectory.append(k, Pose.from_xyz_yaw(float(k), 0.0, 0.0, 0.0))
        session.dynamic_states.append(proto.DynamicState())
        policy.on_egomotion(session, Trajectory.empty())
        assert len(session.dynamic_states) == len(session.ego_trajectory) <= 2000
    assert session.ego_trajectory.timestamps_us[-1000:] == list(range(4000, 5000))
    policy.close()
    assert policy.seat_count == 0


def asked_about(seat: Seat, last_pose_us: int) -> Any:
    """The request of a question at 1 s, of a session that drove backwards at 2 m/s."""
    policy = BridgePolicy(model("constant_velocity"), camera="front")
    cameras = {"front": FakeCamera().available_camera()}
    session = SessionState("one", 1, "", cameras)
    assert policy.take("one", seat) == ("", "")
    policy.on_session_start(session)
    session.frame_history["front"] = [CameraFrame("front", 900_000, 1_000_000, grey())]
    for k in range(2):
        at_us = last_pose_us - 100_000 * (1 - k)
        session.ego_trajectory.append(at_us, Pose.from_xyz_yaw(-0.2 * k, 0.0, 0.0, 0.0))
        state = proto.DynamicState()
        state.linear_velocity.x = -2.0
        session.dynamic_states.append(state)
    try:
        ctx = SimpleNamespace(session=session, time_now_us=1_000_000)
        return policy._request(seat, cast("Any", ctx))
    finally:
        policy.close()


def test_a_vehicle_that_reverses_has_a_negative_speed() -> None:
    request = asked_about(Seat(lambda: True), 1_000_000)
    assert request.ego_provenance == "measured"
    assert request.history[-1].speed_mps == -2.0


def test_motion_without_speeds_is_unknown() -> None:
    """The package takes a missing state for that of a standing vehicle."""
    request = asked_about(Seat(lambda: True, lacks_speeds=True), 1_000_000)
    assert (request.ego_provenance, request.history) == ("unknown", ())


def test_a_pose_of_after_the_question_is_refused() -> None:
    with pytest.raises(ValueError, match=r"its newest pose is 0\.5 s after time_now_us"):
        asked_about(Seat(lambda: True), 1_500_000)


def _no_rotation(camera: proto.AvailableCamera) -> None:
    camera.rig_to_camera.quat.x = math.nan


def _no_focal_length(camera: proto.AvailableCamera) -> None:
    camera.intrinsics.opencv_pinhole_param.focal_length_x = 0.0


def _no_size(camera: proto.AvailableCamera) -> None:
    camera.intrinsics.resolution_h = 0


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (_no_rotation, "has a rig_to_camera that is no pose"),
        (_no_focal_length, "has a focal length or a size that isn't positive"),
        (_no_size, "has a focal length or a size that isn't positive"),
        (lambda camera: camera.intrinsics.Clear(), "is of the kind None"),
    ],
)
def test_a_camera_that_there_can_not_be_is_refused_and_takes_no_place(
    change: Callable[[Any], None], why: str
) -> None:
    policy = BridgePolicy(model("constant_velocity"))
    declared = FakeCamera().available_camera()
    change(declared)
    with served(policy) as client:
        refused = client.start("one", declared)
        assert code(refused) == "FAILED_PRECONDITION"
        assert why in refused.exception().details()
        assert policy.seat_count == 0


def test_messages_that_can_not_be_handled_are_answered_with_their_reason(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """The server's terminal shows no traceback, and the session goes on."""
    policy = BridgePolicy(model("opencv_baseline"))
    with served(policy) as client:
        assert code(client.start("one")) == "OK"
        client.see("one")
        seat = policy.seat("one")
        assert seat is not None
        assert seat.lacks_speeds
        motion = proto.RolloutEgoTrajectory(session_uuid="one")
        motion.trajectory.poses.append(proto.PoseAtTime(timestamp_us=1_100_000))
        motion.trajectory.poses[0].pose.quat.w = math.nan
        moved = client.stub.submit_egomotion_observation.future(motion)
        assert (code(moved), "quaternion" in moved.exception().details()) == (
            "INVALID_ARGUMENT",
            True,
        )
        many = proto.RolloutEgoTrajectory(session_uuid="one")
        many.trajectory.poses.extend([proto.PoseAtTime()] * 10_001)
        moved = client.stub.submit_egomotion_observation.future(many)
        assert moved.exception().details() == "10001 poses, at most 10000 in a message"
        asked = proto.DriveRequest(session_uuid="one", time_now_us=1_000_000)
        assert code(client.stub.drive.future(asked)) == "OK"
        image = proto.RolloutCameraImage(session_uuid="one")
        image.camera_image.logical_id = FakeCamera().logical_id
        image.camera_image.frame_end_us = 1_000_000
        image.camera_image.image_bytes = b"no picture"
        client.stub.submit_image_observation(image)
        drawn = client.stub.drive.future(asked)
        assert drawn.exception().details() == "a frame is no picture that can be read"
    assert not [one for one in caplog.records if one.exc_info]
