"""Messages to and from the core's types; nothing is decided here."""

from __future__ import annotations

import json
from array import array
from dataclasses import fields, replace
from typing import Any

from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core.ros import session_ns, stamp_from_ns
from ssp_msgs.msg import EgoSample as EgoSampleMsg
from ssp_msgs.msg import NativeArray as NativeArrayMsg
from ssp_msgs.msg import VlaRequest, VlaResponse, VlaTask
from ssp_vla_bridge.backends.recorded import response_of_message
from ssp_vla_bridge.messages import (
    CameraGeometry,
    DrivingTask,
    EgoSample,
    Frame,
    Request,
    Response,
    bare_name,
    of_message,
)
from ssp_vla_bridge.window import geometry_of


def request_from_msg(msg: Any) -> Request:
    """Return VlaRequest.msg as a Request; a zero matrix K or height stands for unknown.

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
        history=tuple(of_message(EgoSample, sample) for sample in msg.history),
        ego_provenance=msg.ego_provenance,
        task=of_message(DrivingTask, msg.task),
        previous=response_of_message(msg.previous[-1]) if msg.previous else None,
    )


def _camera(msg: Any) -> CameraGeometry | None:
    geometry = geometry_of(msg.camera_info, None)
    if geometry is None or msg.camera_height <= 0.0:
        return geometry
    return replace(geometry, height_m=msg.camera_height, pitch_down_rad=msg.camera_pitch)


def request_to_msg(request: Request) -> Any:
    """Return a Request as VlaRequest.msg, the inverse of request_from_msg."""
    msg = VlaRequest()
    msg.header.stamp = stamp_from_ns(request.stamp_ns)
    msg.request_id = request.request_id
    msg.task = _message(VlaTask, request.task)
    for frame in request.frames:
        image = CompressedImage(format="jpeg", data=array("B", frame.jpeg))
        image.header.stamp = stamp_from_ns(frame.stamp_ns)
        msg.frames.append(image)
    camera = request.camera
    if camera is not None:
        msg.camera_info = CameraInfo(width=camera.width_px, height=camera.height_px)
        msg.camera_info.k = [
            camera.fx_px,
            0.0,
            camera.cx_px,
            0.0,
            camera.fy_px,
            camera.cy_px,
            0.0,
            0.0,
            1.0,
        ]
        msg.camera_height = camera.height_m or 0.0
        msg.camera_pitch = camera.pitch_down_rad or 0.0
    msg.history = [_message(EgoSampleMsg, sample) for sample in request.history]
    msg.ego_provenance = request.ego_provenance
    if request.previous is not None:
        msg.previous = [response_to_msg(request.previous)]
    return msg


def _message(kind: type, value: Any, **given: Any) -> Any:
    """Return a message with a dataclass's fields without their units, as of_message reads it."""
    for name in (one.name for one in fields(value)):
        if name != "stamp_ns" and bare_name(name) not in given:
            own = getattr(value, name)
            given[bare_name(name)] = list(own) if isinstance(own, tuple) else own
    return kind(**given)


def response_to_msg(response: Response) -> Any:
    """Return a Response as VlaResponse.msg.

    Raises:
        ValueError, TypeError, AssertionError or OverflowError: the backend gave what no message
        can hold, such as a negative shape or decoding facts that are no JSON.
    """
    for name in ("model_id", "text", "error_msg"):
        if "\0" in getattr(response, name):
            # The middleware would cut it off there without a word.
            raise ValueError(f"{name} holds a NUL character")
    arrays = [_message(NativeArrayMsg, a, data=array("d", a.data)) for a in response.arrays]
    decoding = json.dumps(dict(response.decoding), sort_keys=True, allow_nan=False)
    code = int(response.error_code)
    msg = _message(VlaResponse, response, arrays=arrays, decoding=decoding, error_code=code)
    msg.header.stamp = stamp_from_ns(response.stamp_ns)
    return msg
