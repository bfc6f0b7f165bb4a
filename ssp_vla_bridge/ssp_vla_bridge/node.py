"""The node ``vla_bridge``: request topic → backend in a worker thread → response topic."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import replace
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.names import vla_request_topic, vla_response_topic
from ssp_core.ros import VLA, StopRequest, make_node, run_node
from ssp_msgs.msg import VlaRequest, VlaResponse
from ssp_vla_bridge.conversions import request_from_msg, response_to_msg
from ssp_vla_bridge.core.backend import Outcome, failure, make_backend, respond
from ssp_vla_bridge.core.inbox import Inbox, Ticket
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import ErrorCode, Response
from ssp_vla_bridge.params import read_params

_DEADLINE_CHECK_S = 0.05
# A worker that is inside a model can't be interrupted; it is a daemon and dies with the process.
_JOIN_S = 0.5
# Discovery is not symmetric: a client that already reaches this node may not be reached yet.
_LISTENER_WAIT_S = 2.0
_LISTENER_POLL_S = 0.01


class VlaBridge(Node):
    """Serves one model. Every request is answered once: by the model, or with a numbered error."""

    def __init__(self, name: str, **kwargs: Any) -> None:
        super().__init__(name, **kwargs)
        params = read_params(self)
        self._model = params.model
        self._timeout_s = params.timeout_s
        self._backend = make_backend(params.backend, params.backend_options)
        self._inbox = Inbox(params.queue_limit, seconds_to_ns(params.timeout_s))
        self._changed = threading.Condition()
        self._stopping = False
        self._publisher = self.create_publisher(VlaResponse, vla_response_topic(params.model), VLA)
        self.create_subscription(VlaRequest, vla_request_topic(params.model), self._on_request, VLA)
        # Steady: under simulated time a paused bag would pause the deadline too.
        self.create_timer(
            _DEADLINE_CHECK_S, self._on_deadline, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._worker = threading.Thread(target=self._work, name="backend", daemon=True)
        self._worker.start()
        self.get_logger().info(
            f"{params.model}: backend {params.backend} ({self._backend.model_id}) is ready"
        )

    def shutdown(self) -> None:
        """No answer leaves after this, however long the backend still works."""
        with self._changed:
            self._stopping = True
            self._changed.notify_all()
        self._worker.join(_JOIN_S)

    def _on_request(self, msg: Any) -> None:
        now_ns = time.monotonic_ns()
        request = request_from_msg(msg)
        with self._changed:
            ticket = self._inbox.offer(request, now_ns)
            self._changed.notify_all()
            if ticket is None:
                self._refuse(request, ErrorCode.OVERLOAD, "the queue is full", 0.0)

    def _on_deadline(self) -> None:
        now_ns = time.monotonic_ns()
        with self._changed:
            for ticket in self._inbox.expire(now_ns):
                self._refuse(
                    ticket.request,
                    ErrorCode.TIMEOUT,
                    f"no answer within {self._timeout_s:g} s",
                    ns_to_seconds(now_ns - ticket.received_ns),
                )

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._stopping and (ticket := self._inbox.take()) is None:
                    self._changed.wait()
                if self._stopping:
                    return
            if ticket is not None:
                outcome = respond(self._backend, self._model, ticket.request)
                latency_ns = time.monotonic_ns() - ticket.received_ns
                self._await_listener()
                self._finish(ticket, outcome, ns_to_seconds(latency_ns))

    def _await_listener(self) -> None:
        give_up_s = time.monotonic() + _LISTENER_WAIT_S
        while self._publisher.get_subscription_count() == 0 and time.monotonic() < give_up_s:
            time.sleep(_LISTENER_POLL_S)

    def _finish(self, ticket: Ticket, outcome: Outcome, latency_s: float) -> None:
        response = replace(outcome.response, latency_s=latency_s)
        with self._changed:
            if self._stopping:
                return
            if not self._inbox.finish(ticket):
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
        try:
            msg = response_to_msg(response)
        except (ValueError, TypeError, AssertionError, OverflowError) as error:
            reason = f"the answer fits no message: {type(error).__name__}: {error}"
            self.get_logger().error(f"request {response.request_id!r}: {reason}")
            msg = response_to_msg(failure(response, ErrorCode.BACKEND, reason))
        self._publisher.publish(msg)


def main() -> int:
    """Runs the bridge until SIGINT or SIGTERM."""

    def make(_: StopRequest) -> Node:
        return make_node("vla_bridge", VlaBridge)

    return run_node(make, lambda node: node.shutdown())


if __name__ == "__main__":
    sys.exit(main())
