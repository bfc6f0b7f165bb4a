"""The client of an EgodriverService: what it sends, in which order, and how it reads answers."""

from __future__ import annotations

import json
import math
import pickle
import re
import threading
from collections.abc import Sequence
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from carla_driver_interface import geometry as rigid
from carla_driver_interface import protocol as proto
from carla_driver_interface.contract import camera_to_revision
from carla_driver_interface.testing import FakeCamera

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.motion.trajectory import check_trajectory
from ssp_core.run_file.model import Camera
from ssp_core.world.camera import project, view_from
from ssp_core.world.driver import ROUTE_STEP_M, GivenAnswer
from ssp_vla_bridge.egodriver import client, wire
from ssp_vla_bridge.egodriver.client import EgodriverDriver
from ssp_vla_bridge.egodriver.options import read_options
from tests.support.models.egodrivers import Straight, question, serving

# Pitched and yawed, and off the middle: each wrong convention moves a point by many pixels.
TURNED = Camera(
    width_px=640,
    height_px=360,
    forward_m=1.7,
    left_m=0.3,
    height_m=1.5,
    pitch_down_rad=0.12,
    yaw_left_rad=0.35,
    roll_right_rad=0.05,
)


def driver(url: str, **given: Any) -> EgodriverDriver:
    return EgodriverDriver("mine", read_options({"url": url, "deadline_s": 60.0, **given}, "mine"))


def drive(
    servicer: Any, count: int = 1, deadline_s: float = 60.0, **given: Any
) -> list[GivenAnswer]:
    with serving(servicer) as url:
        one = driver(url, deadline_s=deadline_s)
        assert not one.problem
        got = [one.give(question(k + 1, **given)) for k in range(count)]
        one.close()
    return got


def test_frames_motion_and_route_are_there_before_the_decision() -> None:
    servicer = Straight()
    first, second = drive(servicer, 2)
    step = ["submit_image_observation", "submit_egomotion_observation", "submit_route", "drive"]
    made = ["get_version", "start_session", *step, *step, "close_session"]
    assert [name for name, _, _ in servicer.calls] == made
    assert len({m.session_uuid for _, m, _ in servicer.calls[1:]}) == 1
    (asked, later) = servicer.sent("drive")
    assert (asked.time_now_us, asked.time_query_us) == (10_100_000, 10_200_000)
    assert later.time_now_us == 10_200_000
    assert asked.renderer_data == b""
    begun = servicer.sent("start_session")[0]
    assert (begun.random_seed, begun.debug_info.scene_id) == (7, "")
    image = servicer.sent("submit_image_observation")[0].camera_image
    assert image.frame_end_us == asked.time_now_us
    assert image.image_bytes[:2] == b"\xff\xd8"
    for got in (first, second):
        assert got.answer is not None
        plan = got.answer.trajectory
        assert plan is not None
        assert plan.t_s == pytest.approx([0.1 * k for k in range(41)])
        assert plan.x_m == pytest.approx(list(range(41)), abs=1e-4)
        assert plan.y_m == pytest.approx([0.0] * 41, abs=1e-4)


def test_all_poses_since_the_last_call_are_sent_from_the_first_questions_place() -> None:
    """UTM northings in float32 would be rounded to half a metre."""
    servicer = Straight()
    drive(servicer, 2)
    first, second = servicer.sent("submit_egomotion_observation")
    assert len(first.trajectory.poses) == len(first.dynamic_states) == 18
    last = first.trajectory.poses[-1]
    assert (last.pose.vec.x, last.pose.vec.y, last.timestamp_us) == (0.0, 0.0, 10_100_000)
    assert rigid.Pose.from_proto(last.pose).yaw == pytest.approx(0.6)
    (new,) = second.trajectory.poses
    assert (new.pose.vec.x, new.pose.vec.y) == pytest.approx((math.cos(0.6), math.sin(0.6)))
    assert second.dynamic_states[0].linear_velocity.x == 10.0


def test_the_same_questions_send_the_same_bytes_but_for_the_name_of_the_session() -> None:
    def sent() -> list[tuple[str, bytes, dict[str, Any]]]:
        servicer = Straight()
        drive(servicer, 3)
        for _, message, _ in servicer.calls:
            if hasattr(message, "session_uuid"):
                message.session_uuid = ""
        return [(name, m.SerializeToString(), more) for name, m, more in servicer.calls]

    assert sent() == sent()


def test_the_name_of_a_session_is_new_each_time() -> None:
    """One that comes again would tell a policy which of an event and its twin it drives."""
    servicer = Straight()
    with serving(servicer) as url:
        for _ in range(3):
            one = driver(url)
            one.give(question())
            one.close()
    assert len({one.session_uuid for one in servicer.sent("start_session")}) == 3


def test_the_begin_of_a_session_is_no_part_of_the_latency(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    start, clock = EgodriverDriver._start, [0.0]

    def slowly(self: EgodriverDriver, *given: Any) -> None:
        start(self, *given)
        clock[0] += 100.0

    monkeypatch.setattr(EgodriverDriver, "_start", slowly)
    monkeypatch.setattr(client, "time", Mock(perf_counter=lambda: clock[0]))
    (got,) = drive(Straight())
    assert clock == [100.0]
    assert got.latency.total_ns == 0


@pytest.mark.parametrize(
    ("took_s", "why"),
    [
        ({"start_session": 3000.0, "submit_route": 200.0, "drive": 100.0}, ""),
        (
            {"start_session": 3000.0, "submit_route": 700.0},
            "gave no answer to drive within its deadline_s of 3600 s for the whole question, "
            "most of which start_session took",
        ),
        (
            {"start_session": 1500.0, "submit_image_observation": 1500.0, "submit_route": 700.0},
            "gave no answer to drive within its deadline_s of 3600 s for the whole question",
        ),
        (
            {"start_session": 3700.0},
            "gave no answer to submit_image_observation within its deadline_s of 3600 s for the "
            "whole question, most of which start_session took",
        ),
    ],
)
def test_all_calls_of_a_question_have_one_deadline(
    took_s: dict[str, float], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]

    class Slow(Straight):
        def took(self, call: str, message: Any, context: Any) -> None:
            super().took(call, message, context)
            clock[0] += took_s.get(call, 0.0)

    monkeypatch.setattr(client, "time", Mock(perf_counter=lambda: clock[0]))
    servicer = Slow()
    (got,) = drive(servicer, deadline_s=3600.0)
    assert got.ended == why
    # It is told at once that it is over.
    assert servicer.sent("close_session")


def test_a_driver_that_an_abort_closes_ends_whether_it_is_asked_then_or_before() -> None:
    class Aborted(Straight):
        def took(self, call: str, message: Any, context: Any) -> None:
            super().took(call, message, context)
            if call == "submit_route":
                one.close()

    servicer = Aborted()
    with serving(servicer) as url:
        one = driver(url)
        while_asked, afterwards = (one.give(question(step)) for step in (1, 2))
        one.close()
    assert not servicer.sent("drive")
    # It closes in the midst of a call, or just before the next one.
    assert re.match("(submit_route|drive) failed: CANCELLED: ", while_asked.ended)
    assert afterwards.ended == "its connection was closed"


def test_a_driver_that_is_no_longer_wanted_waits_for_no_server() -> None:
    """An abort while a session loads its models ends at once, whatever their servers do."""
    asked, release = threading.Event(), threading.Event()

    class Hanging(Straight):
        def took(self, call: str, message: Any, context: Any) -> None:
            super().took(call, message, context)
            asked.set()
            release.wait()

    with serving(Hanging()) as url:
        options = read_options({"url": url, "deadline_s": 60.0}, "mine")
        one = EgodriverDriver("mine", options, is_wanted=lambda: not asked.is_set())
        release.set()
    assert "it was given up while it was loaded" in one.problem


@pytest.mark.parametrize(
    ("version", "given", "revision"),
    [
        ("mine-carla-driver-interface-1.1.1", {}, 1),
        ("alpamayo 0.55", {}, 2),
        ("alpamayo 0.55", {"revision": 1}, 1),
        ("mine-carla-driver-interface-1.1.1", {"revision": 2}, 2),
    ],
)
def test_a_server_that_declares_no_revision_is_told_by_its_version(
    version: str, given: dict[str, Any], revision: int
) -> None:
    """AlpaSim's own drivers declare none, as the package did before 2.0, and mean another frame."""

    class Undeclared(Straight):
        def get_version(self, request: Any, context: Any) -> Any:
            self.took("get_version", request, context)
            return proto.VersionId(version_id=version)

    servicer = Undeclared()
    with serving(servicer) as url:
        one = driver(url, **given)
        one.give(question(camera=TURNED))
        one.close()
    ((_, begun, declared),) = [one for one in servicer.calls if one[0] == "start_session"]
    assert declared == {"carla-driver-interface-contract": str(revision)}
    (sent,) = begun.rollout_spec.vehicle.available_cameras
    # The optical axis, left and down, is the first one of a body and the third of an optical frame.
    axis = {1: 0, 2: 2}[revision]
    ahead = rigid.Pose.from_proto(sent.rig_to_camera).rotation_matrix[:, axis]
    yaw, pitch = math.atan2(ahead[1], ahead[0]), -math.asin(ahead[2])
    assert (yaw, pitch) == pytest.approx((TURNED.yaw_left_rad, TURNED.pitch_down_rad), abs=1e-6)


def test_a_name_that_another_session_holds_is_not_taken_from_it() -> None:
    from carla_driver_interface.policies.constant_speed import ConstantSpeedPolicy
    from carla_driver_interface.service import EgodriverServicer

    with serving(EgodriverServicer(ConstantSpeedPolicy(cruise_speed_mps=10.0), "alpasim")) as url:
        drivers = [driver(url) for _ in range(3)]
        answers = [one.give(question()).answer for one in drivers]
        assert all(a is not None and a.trajectory is not None for a in answers)
        for one in drivers:
            one.close()


@pytest.mark.parametrize(("length_m", "points"), [(80.0, 20), (30.0, 8), (0.0, 1), (1000.0, 20)])
def test_a_route_has_twenty_points_and_what_is_not_there_is_no_number(
    length_m: float, points: int
) -> None:
    line = [(ROUTE_STEP_M * k, 0.0025 * k * k) for k in range(int(length_m / ROUTE_STEP_M) + 1)]
    found = np.array(wire.route_points(line))
    assert found.shape == (20, 3)
    assert np.isfinite(found).all(axis=1).tolist() == [k < points for k in range(20)]
    gaps = np.linalg.norm(np.diff(found[:points], axis=0), axis=1)
    assert ((gaps >= 3.5) & (gaps <= 4.5)).all()


def _pixel(camera: proto.AvailableCamera, point: Sequence[float]) -> np.ndarray[Any, Any]:
    """Return the pixel of a point of the rig, by the contract's optical frame."""
    lens = camera.intrinsics.opencv_pinhole_param
    x, y, z = rigid.Pose.from_proto(camera.rig_to_camera).inverse().transform_points(point)[0]
    return np.array(
        [
            lens.focal_length_x * x / z + lens.principal_point_x,
            lens.focal_length_y * y / z + lens.principal_point_y,
        ]
    )


@pytest.mark.parametrize("revision", [1, 2])
def test_a_known_point_lies_where_our_camera_shows_it(revision: int) -> None:
    declared = wire.available_camera(TURNED, "front", revision)
    read = camera_to_revision(declared, revision, 2)
    point = (14.0, 4.0, 0.7)
    shown = project(view_from(Pose2(0.0, 0.0, 0.0), TURNED), point)
    ours = np.array([shown.u_px[0], shown.v_px[0]])
    assert 0 < ours[0] < 640
    assert 0 < ours[1] < 360
    # Pixels count from the centre of the first one here, and from the picture's edge there.
    assert _pixel(read, point) == pytest.approx(ours + 0.5, abs=1e-3)
    if revision == 1:
        assert np.abs(_pixel(declared, point) - ours).max() > 50.0


def test_a_declared_camera_is_read_as_it_is_mounted() -> None:
    """The package's camera, through which its loop draws, against our projection."""
    fake = FakeCamera(x=2.0, y=0.4, z=1.6, pitch_down_deg=7.0, yaw_left_deg=20.0)
    declared = fake.available_camera()
    mount = wire.mounting_of_camera(declared)
    geometry = wire.geometry_of_camera(declared)
    assert math.degrees(mount.pitch_down_rad) == pytest.approx(7.0, abs=1e-4)
    assert math.degrees(mount.yaw_left_rad) == pytest.approx(20.0, abs=1e-4)
    assert mount.roll_right_rad == pytest.approx(0.0, abs=1e-6)
    assert (geometry.height_m, geometry.pitch_down_rad) == (mount.height_m, mount.pitch_down_rad)
    hfov = 2.0 * math.degrees(math.atan(fake.width / 2.0 / geometry.fx_px))
    ours = Camera(
        width_px=fake.width,
        height_px=fake.height,
        hfov_deg=hfov,
        forward_m=mount.forward_m,
        left_m=mount.left_m,
        height_m=mount.height_m,
        pitch_down_rad=mount.pitch_down_rad,
        yaw_left_rad=mount.yaw_left_rad,
    )
    shown = project(view_from(Pose2(0.0, 0.0, 0.0), ours), (20.0, 6.0, 1.0))
    there = _pixel(declared, (20.0, 6.0, 1.0))
    assert there == pytest.approx([shown.u_px[0] + 0.5, shown.v_px[0] + 0.5], abs=1e-3)
    assert (geometry.cx_px, geometry.cy_px) == pytest.approx((319.5, 179.5))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda spec: spec.opencv_pinhole_param.radial_coeffs.append(0.1), "distorted"),
        (lambda spec: spec.ftheta_param.SetInParent(), "ftheta_param"),
    ],
)
def test_a_camera_that_is_no_pinhole_is_refused(change: Any, why: str) -> None:
    declared = FakeCamera().available_camera()
    change(declared.intrinsics)
    with pytest.raises(ValueError, match=why):
        wire.geometry_of_camera(declared)


@pytest.mark.parametrize(
    ("data", "text", "left_out"),
    [
        (b"", "", ""),
        ("Ich bremse für ihn.".encode(), "Ich bremse für ihn.", ""),
        (json.dumps({"reasoning": "A car cuts in."}).encode(), "A car cuts in.", ""),
        (b'{"a": 1}', '{"a": 1}', ""),
        (pickle.dumps({"reasoning_text": "I brake."}), "", "a pickle"),
        (pickle.dumps({"reasoning_text": "I brake."}, protocol=0), "", "a pickle"),
        (b"\xff\xfe", "", "not text in UTF-8"),
        (b"\n\x03abc", "", "control characters"),
        (b"x" * 65537, "", "65537 bytes"),
        (b"[" * 60000, "[" * 60000, ""),
    ],
)
def test_text_is_taken_and_nothing_is_unpickled(data: bytes, text: str, left_out: str) -> None:
    said = wire.debug_text(data)
    assert said.text == text
    assert left_out in said.left_out
    assert bool(said.left_out) == bool(left_out)


class Trap:
    """A pickle that would run code in the process that loads it."""

    def __reduce__(self) -> Any:
        return exec, ("raise SystemExit('it was loaded')",)


def test_a_pickle_that_acts_when_it_is_loaded_is_left_out(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "_TOLD", set())

    class Trapped(Straight):
        def answer(self, request: Any) -> Any:
            response = super().answer(request)
            response.debug_info.unstructured_debug_info = pickle.dumps(Trap())
            return response

    got = drive(Trapped(), 3)
    assert all(one.answer is not None and one.answer.trajectory is not None for one in got)
    assert capsys.readouterr().err.count("left out: a pickle") == 1


def test_a_plan_that_begins_a_step_later_begins_at_the_vut() -> None:
    here = Pose2(3.0, 4.0, math.pi / 2)

    def plan(times_us: Sequence[int]) -> proto.Trajectory:
        place = proto.Vec3(x=3.0, y=6.0)
        poses = [proto.PoseAtTime(pose=proto.Pose(vec=place), timestamp_us=t) for t in times_us]
        return proto.Trajectory(poses=poses)

    assert wire.trajectory_of(proto.Trajectory(), here, 5_000_000) is None
    assert wire.trajectory_of(plan([4_900_000, 5_000_000]), here, 5_000_000) is None
    read = wire.trajectory_of(plan([4_800_000, 4_900_000, 5_100_000]), here, 5_000_000)
    assert read is not None
    assert read.t_s == (-0.1, 0.1)
    assert (read.x_m[1], read.y_m[1]) == pytest.approx((2.0, 0.0))
    # Of thirds of a second, in whole microseconds.
    later = wire.trajectory_of(plan([5_333_334, 5_666_667]), here, 5_000_000)
    assert later is not None
    assert (later.t_s[0], later.x_m[0], later.y_m[0]) == (0.0, 0.0, 0.0)
    for times_us in ([8_000_000], [7_000_000, 8_000_000], [5_200_000, 5_300_000]):
        late = wire.trajectory_of(plan(times_us), here, 5_000_000)
        assert late is not None
        assert set(check_trajectory(late)) & {"coverage", "shape"}
    back = wire.trajectory_of(plan([5_100_000, 4_900_000]), here, 5_000_000)
    assert back is not None
    assert back.t_s == (0.1, -0.1)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"url": "grpc://192.0.2.1:50051"}, "isn't loopback"),
        ({"url": "grpc://driver.example:50051"}, "--drive-insecure"),
        ({"url": "grpc://me:word@127.0.0.1:50051"}, "is no address"),
        ({"url": "http://127.0.0.1:50051"}, "is no address"),
        ({"url": "grpc://127.0.0.1"}, "grpc://127.0.0.1:50051"),
        ({"url": "grpc://127.0.0.1:1", "deadline_s": 0.0}, "0.05 to 3600 s"),
        ({"url": "grpc://127.0.0.1:1", "deadlines": 1}, "known: url, deadline_s"),
    ],
)
def test_a_wrong_or_open_connection_is_refused(given: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError) as refused:
        read_options(given, "mine")
    assert why in str(refused.value)
    assert "word" not in str(refused.value)


def test_another_host_is_asked_in_plain_text_by_name_alone() -> None:
    assert read_options({"url": "grpc://192.0.2.1:1", "insecure": True}, "m").insecure
    assert read_options({"url": "grpc://192.0.2.1:1", "tls": "ca.pem"}, "m").tls
