"""Questions and answers as messages of the EgodriverService, and back.

Frames: the rig is x forward, y left, z up, on the ground under the rear axle, which is the VUT's
ego frame. ``local`` is east, north, up with its origin at the VUT's place at the first question,
since positions are float32. Times are whole µs of the session.
"""

from __future__ import annotations

import json
import math
import pickletools
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from carla_driver_interface import geometry as rigid
from carla_driver_interface import protocol as proto
from carla_driver_interface.contract import CONTRACT_REVISION, camera_to_revision
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped] # has no types

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.model import Camera
from ssp_core.world.camera import Mounting, intrinsics, optical_axes
from ssp_core.world.driver import ROUTE_STEP_M, EgoSample, Question, RawArray
from ssp_vla_bridge.messages import CameraGeometry

ROUTE_POINTS = 20
# Spacing of a route's points, a multiple of that in a question.
_LEAST_M, _MOST_M = 3.5, 4.5
_EVERY = round(4.0 / ROUTE_STEP_M)
MOST_POINTS = 10_000
MOST_SAMPLES = 64
# Of one answer in all, three to a point; as of a bridge's.
MOST_NUMBERS = 1 << 18
MOST_TEXT_BYTES = 64 << 10
# A principal point counts from the picture's edge there, and from the first pixel's centre here.
_HALF_PX = 0.5
_STILL_M = 1e-3
_TEXT_KEYS = ("text", "reasoning")


def micros(stamp_ns: int) -> int:
    """Return a time of the session as messages have it."""
    return stamp_ns // 1000


def local_pose(origin: Pose2, pose: Pose2) -> Pose2:
    """Return a pose of the map frame in the local frame, whose axes are the map's."""
    return Pose2(pose.x_m - origin.x_m, pose.y_m - origin.y_m, pose.yaw_rad)


def available_camera(camera: Camera, name: str, revision: int) -> proto.AvailableCamera:
    """Return a camera as a contract revision declares it.

    Args:
        camera: of the run.
        name: under which frames are sent.
        revision: that the server speaks: 1 declares the camera's body, 2 its optical frame.
    """
    lens = intrinsics(camera)
    axes = optical_axes(camera.pitch_down_rad, camera.yaw_left_rad, camera.roll_right_rad)
    turn = Rotation.from_matrix(axes.T)
    place = [camera.forward_m, camera.left_m, camera.height_m]
    spec = proto.CameraSpec(
        opencv_pinhole_param=proto.OpenCVPinholeCameraParam(
            principal_point_x=lens.cx_px + _HALF_PX,
            principal_point_y=lens.cy_px + _HALF_PX,
            focal_length_x=lens.fx_px,
            focal_length_y=lens.fy_px,
        ),
        logical_id=name,
        resolution_w=lens.width_px,
        resolution_h=lens.height_px,
        shutter_type=proto.ShutterType.GLOBAL,
    )
    declared = proto.AvailableCamera(
        intrinsics=spec,
        rig_to_camera=rigid.Pose.from_rotation(place, turn).to_proto(),
        logical_id=name,
    )
    return camera_to_revision(declared, CONTRACT_REVISION, revision)


def geometry_of_camera(camera: proto.AvailableCamera) -> CameraGeometry:
    """Return the geometry of a declared camera of the present revision.

    Raises:
        ValueError: it is no pinhole camera without distortion, with what it is, or has values that
            no camera has.
    """
    spec = camera.intrinsics
    kind = spec.WhichOneof("camera_param")
    if kind != "opencv_pinhole_param":
        raise ValueError(f"is of the kind {kind}, and opencv_pinhole_param alone is read")
    lens = spec.opencv_pinhole_param
    if spec.WhichOneof("external_distortion") is not None:
        raise ValueError("is seen through a windscreen, and a pinhole alone is read")
    distortions = (lens.radial_coeffs, lens.tangential_coeffs, lens.thin_prism_coeffs)
    if any(value != 0.0 for values in distortions for value in values):
        raise ValueError("is distorted, and a pinhole without distortion alone is read")
    positive = (lens.focal_length_x, lens.focal_length_y, spec.resolution_w, spec.resolution_h)
    if not all(0.0 < value < math.inf for value in positive):
        raise ValueError("has a focal length or a size that isn't positive")
    if not all(map(math.isfinite, (lens.principal_point_x, lens.principal_point_y))):
        raise ValueError("has a principal point that is no number")
    try:
        mount = mounting_of_camera(camera)
    except ValueError as error:
        raise ValueError(f"has a rig_to_camera that is no pose: {error}") from error
    if not all(map(math.isfinite, (mount.height_m, mount.pitch_down_rad))):
        raise ValueError("has a rig_to_camera that is no pose")
    return CameraGeometry(
        fx_px=lens.focal_length_x,
        fy_px=lens.focal_length_y,
        cx_px=lens.principal_point_x - _HALF_PX,
        cy_px=lens.principal_point_y - _HALF_PX,
        width_px=spec.resolution_w,
        height_px=spec.resolution_h,
        height_m=mount.height_m,
        pitch_down_rad=mount.pitch_down_rad,
    )


def mounting_of_camera(camera: proto.AvailableCamera) -> Mounting:
    """Return where a declared camera of the present revision sits in the rig."""
    pose = rigid.Pose.from_proto(camera.rig_to_camera)
    x, y, z = (float(value) for value in pose.position)
    qx, qy, qz, qw = (float(value) for value in pose.quat_xyzw)
    return Mounting.of_transform((x, y, z), (qx, qy, qz, qw))


def egomotion(
    session: str, question: Question, origin: Pose2, after_us: int | None
) -> proto.RolloutEgoTrajectory:
    """Return the VUT's motion since an instant, oldest first.

    Args:
        session: its name.
        question: that the motion belongs to.
        origin: of the local frame, in the map frame.
        after_us: time of the last pose that was sent; None: none was.
    """
    message = proto.RolloutEgoTrajectory(session_uuid=session)
    here = local_pose(origin, question.pose)
    for sample in question.history:
        at_us = micros(question.stamp_ns + round(sample.t_s * 1e9))
        if after_us is not None and at_us <= after_us:
            continue
        x, y = here.to_parent(sample.x_m, sample.y_m)
        pose = rigid.Pose.from_xyz_yaw(x, y, 0.0, here.yaw_rad + sample.yaw_rad)
        message.trajectory.poses.append(pose.to_proto_at_time(at_us))
        message.dynamic_states.append(
            proto.DynamicState(
                linear_velocity=proto.Vec3(x=sample.speed_mps),
                angular_velocity=proto.Vec3(z=sample.yaw_rate_radps),
            )
        )
    return message


def samples_of(
    times_us: Sequence[int],
    poses: Sequence[rigid.Pose],
    states: Sequence[proto.DynamicState],
    now_us: int,
) -> tuple[EgoSample, ...]:
    """Return poses of the local frame as samples in the rig frame of the last one.

    Args:
        times_us: rising, at least one.
        poses: of the rig in the local frame.
        states: in the rig frame.
        now_us: the question's time.
    """
    places = [Pose2(float(p.position[0]), float(p.position[1]), p.yaw) for p in poses]
    here = places[-1]
    samples = []
    for at_us, place, state in zip(times_us, places, states, strict=True):
        x, y = here.to_local(place.x_m, place.y_m)
        turned = wrap_angle(place.yaw_rad - here.yaw_rad)
        velocity = state.linear_velocity
        speed = math.copysign(math.hypot(velocity.x, velocity.y), velocity.x)
        rate = float(state.angular_velocity.z)
        samples.append(EgoSample((at_us - now_us) / 1e6, x, y, turned, speed, rate))
    return tuple(samples)


def route_points(route_m: Sequence[tuple[float, float]]) -> list[tuple[float, float, float]]:
    """Return the route of a message: so many points of the centre line, the rest no numbers.

    The centre line ends where two of them are too near to each other, or too far apart.
    """
    points = [(x, y, 0.0) for x, y in route_m[::_EVERY]][:ROUTE_POINTS]
    for i, (a, b) in enumerate(pairwise(points)):
        if not _LEAST_M <= math.dist(a, b) <= _MOST_M:
            points = points[: i + 1]
            break
    nothing = (math.nan, math.nan, math.nan)
    return points + [nothing] * (ROUTE_POINTS - len(points))


def route(session: str, question: Question) -> proto.RouteRequest:
    """Return the centre line of the VUT's lane ahead, in the rig frame."""
    waypoints = [proto.Vec3(x=x, y=y, z=z) for x, y, z in route_points(question.route_m)]
    ahead = proto.Route(timestamp_us=micros(question.stamp_ns), waypoints=waypoints)
    return proto.RouteRequest(session_uuid=session, route=ahead)


def image(
    session: str, camera: str, stamp_ns: int, exposure_s: float, jpeg: bytes
) -> proto.RolloutCameraImage:
    """Return one frame; its stamp is the end of its shutter."""
    end_us = micros(stamp_ns)
    message = proto.RolloutCameraImage(session_uuid=session)
    message.camera_image.logical_id = camera
    message.camera_image.frame_start_us = max(0, end_us - round(exposure_s * 1e6))
    message.camera_image.frame_end_us = end_us
    message.camera_image.image_bytes = jpeg
    return message


# Times of poses are whole microseconds.
_ROUNDED_S = 2e-6


def trajectory_of(message: proto.Trajectory, here: Pose2, now_us: int) -> Trajectory | None:
    """Return a plan of the local frame in the VUT's ego frame; None: there is none to come.

    Of what a plan whose times rise says of the past, the last pose is kept, so that it covers the
    question's time; one that begins a step after it begins at the VUT (METHOD 5.4).

    Args:
        message: at most ``MOST_POINTS`` poses.
        here: pose of the VUT at the question, local frame.
        now_us: the question's time.
    """
    if not message.poses:
        return None
    rows = [
        ((one.timestamp_us - now_us) / 1e6, *here.to_local(one.pose.vec.x, one.pose.vec.y))
        for one in message.poses
    ]
    times = [row[0] for row in rows]
    if all(a < b for a, b in pairwise(times)):
        if times[-1] <= 0.0:
            return None
        past = [row for row in rows if row[0] <= 0.0][-1:]
        rows = [*past, *(row for row in rows if row[0] > 0.0)]
        if not past and len(rows) > 1 and 2.0 * rows[0][0] <= rows[1][0] + _ROUNDED_S:
            rows.insert(0, (0.0, 0.0, 0.0))
    t_s, x_m, y_m = (tuple(row[k] for row in rows) for k in range(3))
    return Trajectory(t_s, x_m, y_m)


def plan_in_rig(plan: Trajectory, now_us: int) -> rigid.Trajectory:
    """Return a plan of the ego frame as poses of the rig, each looking along its motion."""
    trajectory = rigid.Trajectory.empty()
    yaw = 0.0
    before = (0.0, 0.0)
    for t_s, x, y in zip(plan.t_s, plan.x_m, plan.y_m, strict=True):
        if math.dist(before, (x, y)) > _STILL_M:
            yaw = math.atan2(y - before[1], x - before[0])
        before = (x, y)
        trajectory.append(now_us + round(t_s * 1e6), rigid.Pose.from_xyz_yaw(x, y, 0.0, yaw))
    return trajectory


def sampled_arrays(samples: Sequence[proto.Trajectory]) -> tuple[RawArray, ...]:
    """Return the other plans that a policy considered, as they came: µs, then local x and y."""
    arrays = []
    for k, sample in enumerate(samples):
        rows = [(float(p.timestamp_us), p.pose.vec.x, p.pose.vec.y) for p in sample.poses]
        data = tuple(np.ravel(rows).tolist())
        arrays.append(RawArray(f"sample_{k}", (len(rows), 3), data, "local", "us, m", 0.0, 0.0))
    return tuple(arrays)


@dataclass(frozen=True)
class DebugText:
    """The content of ``unstructured_debug_info``.

    Args:
        text: of the policy; empty: there is none.
        left_out: why the field isn't taken; empty: it is, or there is none.
        value: the JSON object that it is; None: it is none.
    """

    text: str = ""
    left_out: str = ""
    value: dict[str, object] | None = None


def debug_text(data: bytes) -> DebugText:
    """Read ``unstructured_debug_info``; what isn't text is left out, and nothing is unpickled."""
    if not data:
        return DebugText()
    if len(data) > MOST_TEXT_BYTES:
        return DebugText(left_out=f"{len(data)} bytes, at most {MOST_TEXT_BYTES}")
    if _is_pickle(data):
        return DebugText(left_out="a pickle, which is never loaded")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        return DebugText(left_out="not text in UTF-8")
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        value = text
    content = value
    if isinstance(value, dict):
        content = next((value[key] for key in _TEXT_KEYS if isinstance(value.get(key), str)), text)
    plain_text = content if isinstance(content, str) else text
    json_object = value if isinstance(value, dict) else None
    if not _is_plain(plain_text):
        return DebugText(left_out="not text: it has control characters", value=json_object)
    return DebugText(plain_text, value=json_object)


def _is_plain(text: str) -> bool:
    """Tell whether a text has no control characters but white space, and no lone surrogates."""
    return not any(unicodedata.category(c) in ("Cc", "Cs") and c not in "\t\r\n" for c in text)


def _is_pickle(data: bytes) -> bool:
    """Tell whether bytes are a pickle of any protocol, by its opcodes; none is carried out."""
    if data[0] == 0x80:
        return True
    try:
        ends = [place for op, _, place in pickletools.genops(data) if op.name == "STOP"]
    except Exception:  # genops raises whatever its readers meet
        return False
    return ends == [len(data) - 1] and len(data) > 1
