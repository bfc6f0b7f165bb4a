"""Messages to and from the core's types; nothing is decided here."""

from __future__ import annotations

import json
from array import array
from dataclasses import replace
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core.ros import session_ns, stamp_from_ns
from ssp_msgs.msg import EgoSample as EgoSampleMsg
from ssp_msgs.msg import NativeArray as NativeArrayMsg
from ssp_msgs.msg import VlaRequest, VlaResponse, VlaTask
from ssp_vla_bridge.backends.recorded import response_of_message
from ssp_vla_bridge.messages import CameraGeometry, DrivingTask, EgoSample, Frame, Request, Response
from ssp_vla_bridge.window import geometry_of


def request_from_msg(msg: Any) -> Request:
    """VlaRequest.msg as a Request; a zero matrix K or height is what the message calls unknown.

    Raises:
        ValueError: a stamp is none, or the previous answer in it can't be read.
    """
    return Request(
        request_id=msg.request_id,
        stamp_ns=session_ns(msg.header.stamp),
        frames=tuple(
            Frame(session_ns(frame.header.stamp), bytes(frame.data)) for frame in msg.frames
        ),
        camera=_camera(msg),
        history=tuple(EgoSample(s.t, s.x, s.y, s.yaw, s.speed, s.yaw_rate) for s in msg.history),
        ego_provenance=msg.ego_provenance,
        task=DrivingTask(
            instruction=msg.task.instruction,
            objects=tuple(msg.task.objects),
            positions=tuple(msg.task.positions),
            motions=tuple(msg.task.motions),
            conflicts=tuple(msg.task.conflicts),
            lon_actions=tuple(msg.task.lon_actions),
            lat_actions=tuple(msg.task.lat_actions),
            trajectory_step_s=msg.task.trajectory_step,
            trajectory_horizon_s=msg.task.trajectory_horizon,
        ),
        previous=response_of_message(msg.previous[-1]) if msg.previous else None,
    )


def _camera(msg: Any) -> CameraGeometry | None:
    geometry = geometry_of(msg.camera_info, None)
    if geometry is None or msg.camera_height <= 0.0:
        return geometry
    return replace(geometry, height_m=msg.camera_height, pitch_down_rad=msg.camera_pitch)


def request_to_msg(request: Request) -> Any:
    """A Request as VlaRequest.msg: the inverse of request_from_msg."""
    msg = VlaRequest()
    msg.header.stamp = stamp_from_ns(request.stamp_ns)
    msg.request_id = request.request_id
    msg.task = _task_to_msg(request.task)
    for frame in request.frames:
        image = CompressedImage(format="jpeg", data=array("B", frame.jpeg))
        image.header.stamp = stamp_from_ns(frame.stamp_ns)
        msg.frames.append(image)
    camera = request.camera
    if camera is not None:
        msg.camera_info = CameraInfo(width=camera.width_px, height=camera.height_px)
        msg.camera_info.k = [
            camera.fx_px, 0.0, camera.cx_px, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 1.0,
        ]  # fmt: skip
        msg.camera_height = camera.height_m or 0.0
        msg.camera_pitch = camera.pitch_down_rad or 0.0
    msg.history = [
        EgoSampleMsg(t=s.t_s, x=s.x_m, y=s.y_m, yaw=s.yaw_rad, speed=s.speed_mps,
                     yaw_rate=s.yaw_rate_radps)
        for s in request.history
    ]  # fmt: skip
    msg.ego_provenance = request.ego_provenance
    if request.previous is not None:
        msg.previous = [response_to_msg(request.previous)]
    return msg


def _task_to_msg(task: DrivingTask) -> Any:
    return VlaTask(
        instruction=task.instruction,
        objects=list(task.objects),
        positions=list(task.positions),
        motions=list(task.motions),
        conflicts=list(task.conflicts),
        lon_actions=list(task.lon_actions),
        lat_actions=list(task.lat_actions),
        trajectory_step=task.trajectory_step_s,
        trajectory_horizon=task.trajectory_horizon_s,
    )


def response_to_msg(response: Response) -> Any:
    """A Response as VlaResponse.msg.

    Raises:
        ValueError, TypeError, AssertionError or OverflowError: the backend gave what no message
        can hold, such as a negative shape or decoding facts that are no JSON.
    """
    for name in ("model_id", "text", "error_msg"):
        if "\0" in getattr(response, name):
            # The middleware would cut it off there without a word.
            raise ValueError(f"{name} holds a NUL character")
    msg = VlaResponse()
    msg.header.stamp = stamp_from_ns(response.stamp_ns)
    msg.request_id = response.request_id
    msg.model = response.model
    msg.model_id = response.model_id
    msg.text = response.text
    msg.arrays = [
        NativeArrayMsg(
            name=a.name,
            shape=list(a.shape),
            data=array("d", a.data),
            frame=a.frame,
            unit=a.unit,
            step=a.step_s,
            first_time=a.first_time_s,
        )
        for a in response.arrays
    ]
    msg.decoding = json.dumps(dict(response.decoding), sort_keys=True, allow_nan=False)
    msg.latency = response.latency_s
    msg.error_code = int(response.error_code)
    msg.error_msg = response.error_msg
    return msg
