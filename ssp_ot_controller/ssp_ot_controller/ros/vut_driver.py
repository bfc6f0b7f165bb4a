"""The vut_driver node: a driver leads the VUT of a driven session (METHOD 8).

A baseline answers at once. A model takes its time, in a thread of its own: the node says meanwhile
that it waits, the world holds at the step of the frame, and only the model's own limit ends it.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.bag.drive_messages import drive_messages
from ssp_core.cdr import steps
from ssp_core.cdr.states import decode_state
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import SeeingDriver, make_driver
from ssp_core.world.driver_answers import NODE_ANSWERS_FILE, answers_in_event
from ssp_core.world.event_messages import encode_limit
from ssp_core.world.plant import LimitFact
from ssp_msgs.msg import (
    ActuatorCommand,
    ObjectState,
    Reference,
    ReferenceAck,
    SafetyEvent,
    SessionState,
    VlaRequest,
    VlaResponse,
    WorldTick,
)
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.driving.kept import KeptModel
from ssp_ot_controller.driving.pilot import pilot_of
from ssp_ot_controller.driving.seat import DriverSeat, DriverStep
from ssp_ot_controller.ros.parameters import VUT_DRIVER
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S

# Before the VUT's first state: the driver is there, and commands nothing.
NOT_YET = Command(math.nan, 0.0, math.nan)
# A node that waits for its model says so this often.
HOLD_PERIOD_S = 0.2


class VutDriver(Node):
    """Thin node around driving.seat.DriverSeat."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.VUT_DRIVER, namespace=names.NAMESPACE)
        parameters = ros.declare(self, VUT_DRIVER)
        run = load_run(parameters["run_file"])
        driven = run.driven
        if driven is None or not run.has_driver_node:
            raise InputError(
                "names no driver that answers with plans",
                file=parameters["run_file"],
                field="driven",
                remedy="give ssp run --drive NAME, which starts this node",
            )
        self._stop = stop
        self._failure: BaseException | None = None
        self._run, self._driven = run, driven
        recorded = answers_in_event(Path(parameters["answers"])) if parameters["answers"] else None
        # A model may load for minutes: it does so before anybody can see this node.
        self._driver = make_driver(
            driven.driver, driven.options, recorded, lambda: stop.reason is None
        )
        self._seat = DriverSeat(pilot_of(run, driven, self._driver))
        self._is_end_reported = False
        self._model: KeptModel | None = None
        self._worker: ThreadPoolExecutor | None = None
        if isinstance(self._driver, SeeingDriver):
            answers = Path(parameters["run_file"]).parent / NODE_ANSWERS_FILE
            self._model = KeptModel(self._driver, answers)
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="driver")
        self._work: list[Future[None]] = []
        self._since_ns = 0
        self._held_step = -1
        self._make_endpoints()

    def _make_endpoints(self) -> None:
        pub, driver, vut = self.create_publisher, self._driven.driver, self._run.vut.id
        self._command = pub(ActuatorCommand, names.VUT_COMMAND, ros.COMMAND)
        self._safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._report_publishers: dict[str, Any] = {
            names.vla_request_topic(driver): pub(
                VlaRequest, names.vla_request_topic(driver), ros.COMMAND
            ),
            names.vla_response_topic(driver): pub(
                VlaResponse, names.vla_response_topic(driver), ros.COMMAND
            ),
            names.reference_topic(vut): pub(Reference, names.reference_topic(vut), ros.COMMAND),
            names.ack_topic(vut): pub(ReferenceAck, names.ack_topic(vut), ros.COMMAND),
        }
        if self._driven.latency.measured:
            topic = names.vla_latency_topic(driver)
            self._report_publishers[topic] = pub(DiagnosticArray, topic, ros.COMMAND)
        if self._model is not None:
            phase, take = names.SESSION_STATE, self._model.take_phase
            ros.subscribe_raw(self, SessionState, phase, _phase_of, take, ros.LATCHED, raw=False)
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(HOLD_PERIOD_S, self._on_hold_timer, clock=steady)
        state, raw = names.state_topic(vut), ros.subscribe_raw
        raw(self, ObjectState, state, decode_state, self._on_state, ros.STATE)
        raw(self, WorldTick, names.WORLD_TICK, steps.decode_tick, self._on_tick, ros.STATE)

    def _on_state(self, state: State) -> None:
        self._do(lambda: self._seat.take_state(state))

    def _on_tick(self, tick: steps.WorldTick) -> None:
        self._held_step = tick.step
        self._do(lambda: self._seat.take_tick(tick))

    def _do(self, take: Callable[[], None]) -> None:
        """Take what arrived, and answer: at once, or in the thread that waits for the model."""

        def work() -> None:
            take()
            self._answer()

        if self._worker is None:
            work()
            return
        if not self._work:
            self._since_ns = time.monotonic_ns()
        self._work.append(self._worker.submit(work))
        self._look()

    def _look(self) -> None:
        """Forget what is done; what failed ends the node."""
        while self._work and self._work[0].done():
            error = self._work.pop(0).exception()
            self._since_ns = time.monotonic_ns()
            if error is not None and self._failure is None:
                self._failure = error
                self._stop.set("no answer")

    def _on_hold_timer(self) -> None:
        """Say that the step is waited for while the model is asked."""
        self._look()
        if self._work and time.monotonic_ns() - self._since_ns >= seconds_to_ns(HOLD_PERIOD_S):
            self._command.publish(self._encoded(self._held_step, 0, NOT_YET))

    def _answer(self) -> None:
        answer = self._seat.step()
        if answer is None:
            return
        if answer.report is not None:
            ended = answer.report.died
            if self._model is not None:
                self._model.keep(answer.report)
                ended = self._model.ending(answer.report)
            drive = drive_messages(self._driven, self._run.vut.id, answer.report, answer.now_ns)
            for topic, message in drive:
                self._report_publishers[topic].publish(message)
            if ended and not self._is_end_reported:
                self._is_end_reported = True
                self._announce(f"it ended: {ended}", answer.now_ns)
        self._send(answer)

    def _send(self, answer: DriverStep) -> None:
        """Send the command, which is the answer that the world waits for."""
        encoded = self._encoded(answer.step, answer.now_ns, answer.command or NOT_YET)
        self._command.publish(encoded)

    def _encoded(self, step: int, now_ns: int, command: Command) -> bytes:
        body = steps.BodyCommand(
            self._run.vut.id,
            step,
            command.acceleration_mps2,
            command.curvature_1pm,
            command.heading_rad,
            command.emergency_stop,
        )
        return steps.encode_command(now_ns, body)

    def _announce(self, words: str, now_ns: int) -> None:
        passed = LimitFact(
            SafetyCode.PARTICIPANT_LOST,
            self.get_name(),
            names.VUT_DRIVER,
            0.0,
            DRIVER_TIMEOUT_S,
            now_ns,
            words,
        )
        self._safety.publish(encode_limit(passed))
        self.get_logger().error(words)

    def close(self) -> None:
        """End the model; raise what its thread failed by."""
        if self._worker is not None:
            self._worker.shutdown(wait=False, cancel_futures=True)
        if isinstance(self._driver, SeeingDriver):
            self._driver.close()
        if self._worker is not None:
            self._worker.shutdown()
        self._work = [one for one in self._work if not one.cancelled()]
        self._look()
        if self._failure is not None:
            raise self._failure


def _phase_of(message: SessionState) -> SessionPhase:
    return SessionPhase(message.state)


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(VutDriver, lambda node: node.close()))


if __name__ == "__main__":
    main()
