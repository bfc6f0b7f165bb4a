"""The vut_driver node: a driver leads the VUT of a driven session (METHOD 8)."""

from __future__ import annotations

import math
import sys
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.bag.drive_messages import drive_messages
from ssp_core.cdr import steps
from ssp_core.cdr.states import decode_state
from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.safety.codes import SafetyCode
from ssp_core.world.driver import COMMANDED, SeeingDriver, make_driver
from ssp_core.world.event_messages import encode_limit
from ssp_core.world.plant import LimitFact
from ssp_msgs.msg import (
    ActuatorCommand,
    ObjectState,
    Reference,
    ReferenceAck,
    SafetyEvent,
    VlaRequest,
    VlaResponse,
    WorldTick,
)
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.driving.pilot import Pilot
from ssp_ot_controller.driving.seat import DriverSeat, DriverStep
from ssp_ot_controller.ros.parameters import VUT_DRIVER
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S

# Before the VUT's first state: the driver is there, and commands nothing.
NOT_YET = Command(math.nan, 0.0, math.nan)


class VutDriver(Node):
    """Thin node around driving.seat.DriverSeat."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__(names.VUT_DRIVER, namespace=names.NAMESPACE)
        given = ros.declare(self, VUT_DRIVER)
        run = load_run(given["run_file"])
        driven = run.driven
        if driven is None or driven.driver in COMMANDED:
            raise InputError(
                "names no driver that answers with plans",
                file=given["run_file"],
                field="driven",
                remedy="give ssp run --drive NAME, which starts this node",
            )
        driver = make_driver(driven.driver, driven.options)
        if driver is None or isinstance(driver, SeeingDriver):
            raise InputError(
                "sees frames, and drives in one process only",
                file=given["run_file"],
                field="driven.driver",
                value=driven.driver,
                remedy="give --in-process",
            )
        self._run, self._driven = run, driven
        self._seat = DriverSeat(Pilot(run, driven, driver))
        self._died = False
        self._make_endpoints()

    def _make_endpoints(self) -> None:
        pub, driver, vut = self.create_publisher, self._driven.driver, self._run.vut.id
        self._command = pub(ActuatorCommand, names.VUT_COMMAND, ros.COMMAND)
        self._safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._said: dict[str, Any] = {
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
            self._said[topic] = pub(DiagnosticArray, topic, ros.COMMAND)
        state, raw = names.state_topic(vut), ros.subscribe_raw
        raw(self, ObjectState, state, decode_state, self._on_state, ros.STATE)
        raw(self, WorldTick, names.WORLD_TICK, steps.decode_tick, self._on_tick, ros.STATE)

    def _on_state(self, state: State) -> None:
        self._seat.take_state(state)
        self._answer()

    def _on_tick(self, tick: steps.WorldTick) -> None:
        self._seat.take_tick(tick)
        self._answer()

    def _answer(self) -> None:
        answer = self._seat.step()
        if answer is None:
            return
        if answer.report is not None:
            drive = drive_messages(self._driven, self._run.vut.id, answer.report, answer.now_ns)
            for topic, message in drive:
                self._said[topic].publish(message)
            if answer.report.died and not self._died:
                self._died = True
                self._announce(f"it ended: {answer.report.died}", answer.now_ns)
        self._send(answer)

    def _send(self, answer: DriverStep) -> None:
        """Send the command, which is the answer that the world waits for."""
        command = answer.command or NOT_YET
        body = steps.BodyCommand(
            self._run.vut.id,
            answer.step,
            command.acceleration_mps2,
            command.curvature_1pm,
            command.heading_rad,
            command.emergency_stop,
        )
        self._command.publish(steps.encode_command(answer.now_ns, body))

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


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(VutDriver, lambda _node: None))


if __name__ == "__main__":
    main()
