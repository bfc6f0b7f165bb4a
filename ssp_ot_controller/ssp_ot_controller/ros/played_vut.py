"""Plays the VUT's GNSS/INS: nav_msgs/Odometry of a vehicle that drives while the session runs."""

from __future__ import annotations

import math
import sys
import time

from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.transforms import BASE_FRAME
from ssp_msgs.msg import Heartbeat
from ssp_ot_controller.rehearsal.played import PlayedVehicle
from ssp_ot_controller.ros.endpoints import subscribe_states
from ssp_ot_controller.ros.parameters import PLAYED_VUT

# What its localisation says of itself, one sigma.
_POSITION_STD_M = 0.02


class PlayedVut(Node):
    """Thin node around PlayedVehicle. Its faults are parameters: rate, frame and clock."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__("played_vut", namespace=names.NAMESPACE)
        given = ros.declare(self, PLAYED_VUT)
        run = load_run(given["run_file"])
        self._frame = given["frame"]
        self._offset_ns = seconds_to_ns(given["clock_offset_s"])
        self._vehicle = PlayedVehicle(run, time.time_ns())
        self._others: dict[str, State] = {}
        self._pub = self.create_publisher(Odometry, given["odometry"], ros.STATE)
        sub = ros.subscribe_raw
        beats = steps.decode_heartbeat
        sub(self, Heartbeat, names.HEARTBEAT, beats, self._on_beat, ros.STATE)
        subscribe_states(self, run, [target.id for target in run.targets], self._on_state)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / given["rate_hz"], self._publish, clock=steady)

    def _on_beat(self, beat: steps.Heartbeat) -> None:
        self._vehicle.hear(SessionPhase(beat.session_state), time.time_ns())

    def _on_state(self, state: State) -> None:
        self._others[state.object_id] = state

    def _publish(self) -> None:
        others = [self._others[key] for key in sorted(self._others)]
        body = self._vehicle.advance(others, time.time_ns())
        message = Odometry()
        message.header.stamp = ros.stamp_from_ns(self._vehicle.now_ns + self._offset_ns)
        message.header.frame_id = self._frame
        message.child_frame_id = BASE_FRAME
        pose, twist = message.pose, message.twist.twist
        pose.pose.position.x, pose.pose.position.y = body.x_m, body.y_m
        pose.pose.orientation.z = math.sin(body.yaw_rad / 2.0)
        pose.pose.orientation.w = math.cos(body.yaw_rad / 2.0)
        pose.covariance[0] = pose.covariance[7] = _POSITION_STD_M**2
        twist.linear.x, twist.angular.z = body.speed_mps, body.yaw_rate_radps
        self._pub.publish(message)


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(PlayedVut, lambda node: None))


if __name__ == "__main__":
    main()
