"""EgodriverServices on loopback, and questions to their clients, for tests."""

from __future__ import annotations

import math
import socket
from collections.abc import Iterator, Sequence
from concurrent import futures
from contextlib import contextmanager
from typing import Any

import cv2
import grpc  # type: ignore[import-untyped] # has no types
import numpy as np
from carla_driver_interface import protocol as proto

from ssp_core.geometry import Pose2
from ssp_core.run_file.model import Camera
from ssp_core.world.driver import ROUTE_STEP_M, EgoSample, Question, SeenFrame

SMALL = Camera(width_px=64, height_px=64)
STEP_NS = 100_000_000
STRAIGHT_M = tuple((ROUTE_STEP_M * k, 0.0) for k in range(81))
# As far from the origin as UTM is.
PLACE = Pose2(500_000.0, 5_600_000.0, 0.6)


def grey(camera: Camera = SMALL) -> bytes:
    """A picture of nothing."""
    pixels = np.full((camera.height_px, camera.width_px, 3), 90, np.uint8)
    return bytes(cv2.imencode(".jpg", pixels)[1])


def question(
    number: int = 1,
    speed_mps: float = 10.0,
    pose: Pose2 = PLACE,
    camera: Camera = SMALL,
    route_m: Sequence[tuple[float, float]] = STRAIGHT_M,
    seed: int = 7,
) -> Question:
    """A question to a VUT that has driven straight on, one step after the one before."""
    stamp_ns = 10_000_000_000 + number * STEP_NS
    ahead = speed_mps * 0.1 * number
    x, y = pose.to_parent(ahead, 0.0)
    return Question(
        number=number,
        stamp_ns=stamp_ns,
        history=tuple(
            EgoSample(-0.1 * k, -0.1 * k * speed_mps, 0.0, 0.0, speed_mps, 0.0)
            for k in range(17, -1, -1)
        ),
        route_m=tuple(route_m),
        frames=(SeenFrame(stamp_ns, grey(camera)),),
        camera=camera,
        pose=Pose2(x, y, pose.yaw_rad),
        seed=seed,
    )


class Straight(proto.EgodriverServiceServicer):
    """A policy that keeps its speed; it keeps all that it was sent, in order.

    Attributes:
        calls: name of the call, message and metadata.
    """

    def __init__(self) -> None:
        self.calls: list[tuple[str, Any, dict[str, Any]]] = []

    def took(self, call: str, message: Any, context: grpc.ServicerContext) -> None:
        metadata = {
            key: value for key, value in context.invocation_metadata() if key != "user-agent"
        }
        self.calls.append((call, message, metadata))

    def sent(self, call: str) -> list[Any]:
        """The messages of a call."""
        return [message for name, message, _ in self.calls if name == call]

    def get_version(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("get_version", request, context)
        context.send_initial_metadata((("carla-driver-interface-contract", "2"),))
        return proto.VersionId(version_id="straight")

    def start_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("start_session", request, context)
        return proto.SessionRequestStatus()

    def close_session(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("close_session", request, context)
        return proto.Empty()

    def submit_image_observation(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("submit_image_observation", request, context)
        return proto.Empty()

    def submit_egomotion_observation(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("submit_egomotion_observation", request, context)
        return proto.Empty()

    def submit_route(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("submit_route", request, context)
        return proto.Empty()

    def drive(self, request: Any, context: grpc.ServicerContext) -> Any:
        self.took("drive", request, context)
        return self.answer(request)

    def answer(self, request: Any) -> Any:
        """Return a plan from where the VUT was last, at the speed that it had."""
        plan = proto.Trajectory()
        motion = self.sent("submit_egomotion_observation")[-1]
        last, state = motion.trajectory.poses[-1], motion.dynamic_states[-1]
        yaw = 2.0 * math.atan2(last.pose.quat.z, last.pose.quat.w)
        for k in range(41):
            way = 0.1 * k * state.linear_velocity.x
            place = proto.Vec3(
                x=last.pose.vec.x + way * math.cos(yaw), y=last.pose.vec.y + way * math.sin(yaw)
            )
            pose = proto.Pose(vec=place, quat=last.pose.quat)
            at_us = request.time_now_us + 100_000 * k
            plan.poses.append(proto.PoseAtTime(pose=pose, timestamp_us=at_us))
        return proto.DriveResponse(trajectory=plan)


@contextmanager
def nobody() -> Iterator[str]:
    """Hold a port of loopback that accepts no connection, as long as the block runs."""
    with socket.socket() as held:
        held.bind(("127.0.0.1", 0))
        yield f"grpc://127.0.0.1:{held.getsockname()[1]}"


@contextmanager
def serving(servicer: Any, most_bytes: int = -1) -> Iterator[str]:
    """Serve on a free port of loopback; the block gets the address as ``--drive`` takes it."""
    settings = [("grpc.max_send_message_length", most_bytes)]
    server = grpc.server(futures.ThreadPoolExecutor(8), options=settings)
    proto.add_EgodriverServiceServicer_to_server(servicer, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        yield f"grpc://127.0.0.1:{port}"
    finally:
        server.stop(None).wait()
