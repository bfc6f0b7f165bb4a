"""The messages of a driven run: question, answer, and the reference that the plan became."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from ssp_core import names
from ssp_core.bag.types import serialize, typestore
from ssp_core.cdr.references import Acknowledgement, encode_ack, encode_reference
from ssp_core.clock import NS_PER_S
from ssp_core.hashing import sha256_bytes
from ssp_core.motion.trajectory import Trajectory
from ssp_core.run_file.driven import Driven
from ssp_core.world.camera import intrinsics
from ssp_core.world.driver import (
    DriveReport,
    EffectiveAnswer,
    EgoSample,
    GivenAnswer,
    Question,
    Raw,
    RawArray,
)

# REFUSED_LIMIT of ReferenceAck.msg: a plan that passes a limit of METHOD 8.4.
_REFUSED = 6


def drive_messages(
    driven: Driven, vut_id: str, report: DriveReport, now_ns: int
) -> Iterator[tuple[str, bytes]]:
    """Yield topic and bytes of each message of a step.

    Args:
        driven: the driver.
        vut_id: of the VUT, which tracks the plans.
        report: of the step.
        now_ns: session time.
    """
    if report.question is not None:
        yield names.vla_request_topic(driven.driver), _request(report.question)
        if report.answer is not None and driven.latency.measured:
            yield names.vla_latency_topic(driven.driver), _latency(report.question, report.answer)
    if report.effective_answer is not None:
        yield names.vla_response_topic(driven.driver), _response(driven, report.effective_answer)
        ack = _ack(report.effective_answer, vut_id, now_ns)
        yield names.ack_topic(vut_id), encode_ack(ack)
    if report.effective is not None:
        yield names.reference_topic(vut_id), encode_reference(report.effective)


def _request(question: Question) -> bytes:
    """Return the VlaRequest of a question; its frames' pixels are those of the camera's topic."""
    types = typestore().types
    task, picture = types["ssp_msgs/msg/VlaTask"], types["sensor_msgs/msg/CompressedImage"]
    camera = question.camera
    message = types["ssp_msgs/msg/VlaRequest"](
        header=_header(question.stamp_ns),
        request_id=str(question.number),
        task=task(
            instruction="",
            objects=[],
            positions=[],
            motions=[],
            conflicts=[],
            lon_actions=[],
            lat_actions=[],
            trajectory_step=0.0,
            trajectory_horizon=0.0,
        ),
        frames=[
            picture(
                header=_header(frame.stamp_ns),
                format=f"jpeg; {sha256_bytes(frame.jpeg)}",
                data=np.zeros(0, dtype=np.uint8),
            )
            for frame in question.frames
        ],
        camera_info=_camera(question),
        camera_height=0.0 if camera is None else camera.height_m,
        camera_pitch=0.0 if camera is None else camera.pitch_down_rad,
        history=[_sample(one) for one in question.history],
        ego_provenance="measured",
        previous=[],
    )
    return serialize(message)


def _response(driven: Driven, answered: EffectiveAnswer) -> bytes:
    types = typestore().types
    trajectory, raw = answered.answer.trajectory, answered.answer.raw
    if raw is None:
        arrays = [] if trajectory is None else list(_arrays(trajectory))
        raw = Raw(driven.driver)
    else:
        arrays = [_native(array) for array in raw.arrays]
    message = types["ssp_msgs/msg/VlaResponse"](
        header=_header(answered.stamp_ns),
        request_id=str(answered.number),
        model=driven.driver,
        model_id=raw.model_id,
        text=answered.answer.text,
        arrays=arrays,
        decoding=raw.decoding,
        latency=answered.latency_s,
        error_code=raw.error_code,
        error_msg=raw.error_msg,
    )
    return serialize(message)


def _latency(question: Question, answer: GivenAnswer) -> bytes:
    """Return L and its parts, s; the status' message says why the driver ended, if it did."""
    types = typestore().types
    value, status = (
        types[f"diagnostic_msgs/msg/{name}"] for name in ("KeyValue", "DiagnosticStatus")
    )
    latency = answer.latency
    parts = {
        "latency_s": latency.total_ns,
        "encoding_s": latency.encoding_ns,
        "transport_and_inference_s": latency.inference_ns,
        "parsing_s": latency.parsing_ns,
    }
    one = status(
        level=2 if answer.ended else 0,
        name=f"request {question.number}",
        message=answer.ended,
        hardware_id="",
        values=[value(key=key, value=f"{ns / NS_PER_S:.9f}") for key, ns in parts.items()],
    )
    message = types["diagnostic_msgs/msg/DiagnosticArray"](
        header=_header(question.stamp_ns), status=[one]
    )
    return serialize(message)


def _ack(answered: EffectiveAnswer, vut_id: str, now_ns: int) -> Acknowledgement:
    code = _REFUSED if answered.refused else 0
    plan = f"plan-{answered.number}"
    return Acknowledgement(now_ns, plan, vut_id, not answered.refused, code, answered.refused)


def _arrays(trajectory: Trajectory) -> Iterator[Any]:
    """Yield the trajectory's columns as they came: they may be of unequal lengths."""
    for name, unit in (("t_s", "s"), ("x_m", "m"), ("y_m", "m")):
        data = tuple(getattr(trajectory, name))
        yield _native(RawArray(name, (len(data),), data, "ego_xy", unit, 0.0, 0.0))


def _native(array: RawArray) -> Any:
    return typestore().types["ssp_msgs/msg/NativeArray"](
        name=array.name,
        shape=np.array(array.shape, dtype=np.uint32),
        data=np.array(array.data, dtype=np.float64),
        frame=array.frame,
        unit=array.unit,
        step=array.step_s,
        first_time=array.first_time_s,
    )


def _sample(sample: EgoSample) -> Any:
    return typestore().types["ssp_msgs/msg/EgoSample"](
        t=sample.t_s,
        x=sample.x_m,
        y=sample.y_m,
        yaw=sample.yaw_rad,
        speed=sample.speed_mps,
        yaw_rate=sample.yaw_rate_radps,
    )


def _header(stamp_ns: int) -> Any:
    types = typestore().types
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    stamp = types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="")


def _camera(question: Question) -> Any:
    """Return the CameraInfo of a question; one that says nothing where the driver got no frames."""
    types = typestore().types
    region = types["sensor_msgs/msg/RegionOfInterest"](
        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
    )
    lens = None if question.camera is None else intrinsics(question.camera)
    return types["sensor_msgs/msg/CameraInfo"](
        header=_header(0 if lens is None else question.stamp_ns),
        height=0 if lens is None else lens.height_px,
        width=0 if lens is None else lens.width_px,
        distortion_model="",
        d=np.zeros(0),
        k=np.zeros(9) if lens is None else np.array(lens.k()),
        r=np.zeros(9),
        p=np.zeros(12) if lens is None else np.array(lens.p()),
        binning_x=0,
        binning_y=0,
        roi=region,
    )
