"""Plays the objects of a run for tests of the page: loads the run, and sends states of everybody.

python played_objects.py RUN_FILE RATE_HZ MOVING [single]: all of them in one array, or each on a
topic of its own; at their starts, or with MOVING 1 in slow circles. The VUT has its own topic.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import ControlState, Role
from ssp_msgs.msg import ObjectState, ObjectStates
from ssp_msgs.srv import LoadScenario

RADIUS_M = 6.0
TURN_RADPS = 0.5


def standing(who: ParticipantSpec, role: Role) -> State:
    """An object at its start."""
    return State(
        who.id,
        who.cls,
        role,
        0,
        who.start.x_m,
        who.start.y_m,
        who.start.yaw_rad,
        0.0,
        0.0,
        0.0,
        who.size,
        control_state=ControlState.DISARMED if role is Role.OT else ControlState.OFF,
    )


class Played(Node):
    """Publishes, and asks the manager to load the run until it has."""

    def __init__(self) -> None:
        super().__init__("played_objects", namespace=names.NAMESPACE)
        self._run_file = sys.argv[1]
        run = load_run(self._run_file)
        self._moving = sys.argv[3] == "1"
        self._vut = standing(run.vut, Role.VUT)
        self._targets = [standing(target, Role.OT) for target in run.targets]
        self._count = 0
        self._vut_states = self.create_publisher(
            ObjectState, names.state_topic(run.vut.id), ros.STATE
        )
        self._single = (
            [
                self.create_publisher(ObjectState, names.state_topic(t.id), ros.STATE)
                for t in run.targets
            ]
            if "single" in sys.argv
            else []
        )
        self._states = self.create_publisher(ObjectStates, names.OBJECT_STATES, ros.STATE)
        self._client = self.create_client(LoadScenario, names.LOAD_SCENARIO)
        self._loaded = False
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / float(sys.argv[2]), self._send, clock=steady)
        self._asking = self.create_timer(0.5, self._load, clock=steady)

    def _load(self) -> None:
        if not self._loaded and self._client.service_is_ready():
            asked = self._client.call_async(LoadScenario.Request(run_file=self._run_file))
            asked.add_done_callback(self._on_loaded)

    def _on_loaded(self, asked: object) -> None:
        answer = asked.result()  # type: ignore[attr-defined]
        print(f"loaded: {answer.accepted} {answer.error_msg}", flush=True)
        self._loaded = True

    def _send(self) -> None:
        self._count += 1
        now_ns = self.get_clock().now().nanoseconds
        moved = [self._at(state, now_ns) for state in (self._vut, *self._targets)]
        self._vut_states.publish(encode_state(moved[0]))
        for publisher, state in zip(self._single, moved[1:], strict=False):
            publisher.publish(encode_state(state))
        if self._single:
            return
        array = StateArray(now_ns, self.get_name(), tuple(moved[1:]))
        self._states.publish(encode_states(array))

    def _at(self, state: State, now_ns: int) -> State:
        state = replace(state, stamp_ns=now_ns, sequence=self._count)
        if not self._moving:
            return state
        angle = TURN_RADPS * (now_ns % 10**12) / 1e9
        return replace(
            state,
            x_m=state.x_m + RADIUS_M * math.cos(angle),
            y_m=state.y_m + RADIUS_M * math.sin(angle),
            yaw_rad=math.remainder(angle + math.pi / 2, 2 * math.pi),
            speed_mps=RADIUS_M * TURN_RADPS,
        )


if __name__ == "__main__":
    sys.exit(ros.run_node(lambda _: Played(), lambda _: None))
