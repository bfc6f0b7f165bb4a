"""The node ``vla_bridge``: requests from a topic or, in shadow mode, from a session."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core import names
from ssp_core.cdr.states import decode_state
from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.names import DIAGNOSTICS, vla_request_topic, vla_response_topic
from ssp_core.ros import (
    LATCHED,
    SENSOR,
    STATE,
    VLA,
    StopRequest,
    declare,
    diagnostic_array,
    make_node,
    run_node,
    session_ns,
    subscribe_raw,
)
from ssp_core.world.camera import Mounting
from ssp_msgs.msg import ObjectState, VlaRequest, VlaResponse
from ssp_vla_bridge.backend import BackendResult, failure, make_backend, respond
from ssp_vla_bridge.bridge import AnswerQueue, BridgeHealth, RequestQueue, ShadowRequests, Ticket
from ssp_vla_bridge.messages import ErrorCode, Frame, Request, Response
from ssp_vla_bridge.ros.conversions import request_from_msg, response_to_msg
from ssp_vla_bridge.ros.parameters import BRIDGE, BridgeParams, bridge_params
from ssp_vla_bridge.window import find_interface, geometry_of, mounting_of


class Shadow:
    """Feeds a follower from the forward camera and the VUT's own states, and nothing else.

    Args:
        due: called when a request about the newest frame is due.
    """

    def __init__(self, node: Node, follower: ShadowRequests, due: Callable[[], None]) -> None:
        self._follower = follower
        self._due = due
        self._info: Any = None
        self._mount: Mounting | None = None
        node.create_subscription(CameraInfo, names.CAMERA_INFO, self._on_info, LATCHED)
        node.create_subscription(TransformStamped, names.CAMERA_MOUNT, self._on_mount, LATCHED)
        image = names.CAMERA_IMAGE
        subscribe_raw(node, CompressedImage, image, _frame_of, self._on_frame, SENSOR, raw=False)
        topic = names.state_topic(names.VUT_ID)
        subscribe_raw(node, ObjectState, topic, decode_state, follower.state, STATE)

    def _on_info(self, msg: Any) -> None:
        self._info = msg
        self._see_camera()

    def _on_mount(self, msg: Any) -> None:
        self._mount = mounting_of(msg.transform)
        self._see_camera()

    def _see_camera(self) -> None:
        if self._info is not None:
            self._follower.camera = geometry_of(self._info, self._mount)

    def _on_frame(self, frame: Frame) -> None:
        if self._follower.frame(frame):
            self._due()


def _frame_of(msg: Any) -> Frame:
    return Frame(session_ns(msg.header.stamp), bytes(msg.data))


_DEADLINE_CHECK_S = 0.05
_DIAGNOSTICS_S = 1.0
# A worker that is inside a model can't be interrupted; it is a daemon and dies with the process.
_JOIN_S = 0.5


class VlaBridge(Node):
    """Serves one model. Every request is answered once: by the model, or with a numbered error."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        params = bridge_params(declare(self, BRIDGE))
        self._model = params.model
        self._timeout_s = params.timeout_s
        self._backend = make_backend(params.backend, params.backend_options)
        self._queue = RequestQueue(params.queue_limit, seconds_to_ns(params.timeout_s))
        self._health = BridgeHealth(params.model, self._backend.model_id, params.timeout_s)
        self._changed = threading.Condition()
        self._stopping = False
        self._answers = AnswerQueue[VlaResponse](seconds_to_ns(params.timeout_s))
        self._publisher = self.create_publisher(VlaResponse, vla_response_topic(params.model), VLA)
        self.create_subscription(VlaRequest, vla_request_topic(params.model), self._on_request, VLA)
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, STATE)
        self._follower = self._follow(params) if params.shadow_hz else None
        # Steady: under simulated time a paused bag would pause the deadline too.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_DEADLINE_CHECK_S, self._on_deadline, clock=steady)
        self.create_timer(_DIAGNOSTICS_S, self._diagnose, clock=steady)
        self._worker = threading.Thread(target=self._work, name="backend", daemon=True)
        self._worker.start()
        self.get_logger().info(
            f"{params.model}: backend {params.backend} ({self._backend.model_id}) is ready"
        )

    def _follow(self, params: BridgeParams) -> ShadowRequests:
        interface = find_interface(
            params.interface or getattr(self._backend, "interface", "waypoints")
        )
        follower = ShadowRequests(
            params.model,
            round(NS_PER_S / params.shadow_hz),
            interface.preprocessing,
            interface.carries_previous,
        )
        self._shadow = Shadow(self, follower, self._on_due)
        return follower

    def shutdown(self) -> None:
        """Stop answering: nothing leaves after this, however long the backend still works."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._worker.join(_JOIN_S)

    def _on_request(self, msg: Any) -> None:
        now_ns = time.monotonic_ns()
        try:
            request = request_from_msg(msg)
        except ValueError as error:
            request = Request(msg.request_id, _answerable_ns(msg.header.stamp), ())
            with self._changed:
                self._refuse(request, ErrorCode.BAD_REQUEST, str(error), 0.0)
            return
        with self._changed:
            ticket = self._queue.offer(request, now_ns)
            self._changed.notify_all()
            if ticket is None:
                self._refuse(request, ErrorCode.OVERLOAD, "the queue is full", 0.0)

    def _on_due(self) -> None:
        """Ask about the newest frame in shadow mode, or not at all: a queue would grow old."""
        with self._changed:
            if self._queue.busy or self._follower is None:
                self._health.skipped += 1
                return
            self._queue.offer(self._follower.request(), time.monotonic_ns())
            self._changed.notify_all()

    def _diagnose(self) -> None:
        with self._changed:
            status = self._health.status(self._queue.waiting, time.monotonic_ns())
        self._diagnostics.publish(diagnostic_array([status], time.time_ns()))

    def _on_deadline(self) -> None:
        now_ns = time.monotonic_ns()
        with self._changed:
            for ticket in self._queue.expire(now_ns):
                self._refuse(
                    ticket.request,
                    ErrorCode.TIMEOUT,
                    f"no answer within {self._timeout_s:g} s",
                    ns_to_seconds(now_ns - ticket.received_ns),
                )
            self._release()

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._stopping and (ticket := self._queue.take()) is None:
                    self._changed.wait()
                if self._stopping:
                    return
                self._health.busy_since_ns = time.monotonic_ns()
            if ticket is not None:
                outcome = respond(self._backend, self._model, ticket.request)
                latency_ns = time.monotonic_ns() - ticket.received_ns
                self._finish(ticket, outcome, ns_to_seconds(latency_ns))

    def _finish(self, ticket: Ticket, outcome: BackendResult, latency_s: float) -> None:
        response = replace(outcome.response, latency_s=latency_s)
        with self._changed:
            self._health.busy_since_ns = None
            if self._stopping:
                return
            if not self._queue.finish(ticket):
                self._health.late += 1
                self.get_logger().warning(
                    f"request {response.request_id!r}: answered after {latency_s:.2f} s, too late"
                )
                return
            if outcome.traceback:
                self.get_logger().error(
                    f"request {response.request_id!r}: backend raised\n{outcome.traceback}"
                )
            elif response.error_code:
                self.get_logger().warning(f"request {response.request_id!r}: {response.error_msg}")
            self._publish(response)

    def _refuse(self, request: Request, code: ErrorCode, reason: str, latency_s: float) -> None:
        blank = Response(
            request.request_id,
            request.stamp_ns,
            self._model,
            self._backend.model_id,
            latency_s=latency_s,
        )
        self.get_logger().warning(f"request {request.request_id!r}: {reason}")
        self._publish(failure(blank, code, reason))

    def _publish(self, response: Response) -> None:
        self._health.see(
            response.error_code, response.error_msg, response.latency_s, time.monotonic_ns()
        )
        if self._follower is not None:
            response = self._follower.answered(response)
        try:
            msg = response_to_msg(response)
        except (ValueError, TypeError, AssertionError, OverflowError) as error:
            reason = f"the answer fits no message: {type(error).__name__}: {error}"
            self.get_logger().error(f"request {response.request_id!r}: {reason}")
            msg = response_to_msg(failure(response, ErrorCode.BACKEND, reason))
        if self._answers.hold(msg, time.monotonic_ns()):
            self.get_logger().warning("too many answers wait to be sent: the oldest one is lost")
        self._release()

    def _release(self) -> None:
        has_listener = self._publisher.get_subscription_count() > 0
        messages, given_up = self._answers.release(has_listener, time.monotonic_ns())
        if given_up:
            self.get_logger().warning(f"{given_up} answer(s) lost: no listener came in time")
        for msg in messages:
            self._publisher.publish(msg)


def _answerable_ns(stamp: Any) -> int:
    """Return the stamp that a refusal repeats, 0 for one that no answer could carry."""
    with suppress(ValueError):
        return session_ns(stamp)
    return 0


def main() -> int:
    """Run the bridge until SIGINT or SIGTERM."""

    def make(_: StopRequest) -> Node:
        return make_node("vla_bridge", VlaBridge)

    return run_node(make, lambda node: node.shutdown())


if __name__ == "__main__":
    sys.exit(main())
