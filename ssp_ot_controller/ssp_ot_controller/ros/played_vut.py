"""The VUT's GNSS/INS, played for a vehicle that drives while the session runs.

It sends its odometry, or its places, headings and velocities.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu, NavSatFix

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import load_run
from ssp_core.run_file.participation import POSITIONING, ParticipantKind
from ssp_core.world.transforms import BASE_FRAME
from ssp_msgs.msg import Heartbeat
from ssp_ot_controller.bodies.dynamics import BodyState
from ssp_ot_controller.rehearsal.played import PlayedVehicle
from ssp_ot_controller.ros.endpoints import subscribe_states
from ssp_ot_controller.ros.parameters import PLAYED_VUT

# What its localisation says of itself, one sigma.
_POSITION_STD_M = 0.02
_HEADING_STD_RAD = 0.002


class PlayedVut(Node):
    """Thin node around PlayedVehicle. Its faults are parameters: rate, frame and clock."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__("played_vut", namespace=names.NAMESPACE)
        parameters = ros.declare(self, PLAYED_VUT)
        run = load_run(parameters["run_file"])
        ros.declare_kind(self, ParticipantKind.SIMULATED, names.VUT_ID, POSITIONING)
        self._frame = parameters["frame"]
        self._offset_ns = seconds_to_ns(parameters["clock_offset_s"])
        self._vehicle = PlayedVehicle(run, time.time_ns())
        self._others: dict[str, State] = {}
        self._fix_type = parameters["fix_type"]
        if parameters["navsat"]:
            if run.datum is None:
                raise InputError(
                    "isn't there, and places on the Earth need it",
                    file=parameters["run_file"],
                    field="datum",
                    remedy="give the site file one and compile again, or play --odometry",
                )
            self._datum = run.datum.datum
            self._places = self.create_publisher(NavSatFix, parameters["navsat"], ros.STATE)
            self._headings = self.create_publisher(Imu, parameters["heading"], ros.STATE)
            velocity = parameters["velocity"] or "velocity"
            self._velocities = self.create_publisher(TwistStamped, velocity, ros.STATE)
            self._tell = self._as_places
        else:
            self._pub = self.create_publisher(Odometry, parameters["odometry"], ros.STATE)
            self._tell = self._as_odometry
        sub = ros.subscribe_raw
        beats = steps.decode_heartbeat
        sub(self, Heartbeat, names.HEARTBEAT, beats, self._on_beat, ros.STATE)
        subscribe_states(self, run, [target.id for target in run.targets], self._on_state)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / parameters["rate_hz"], self._publish, clock=steady)

    def _on_beat(self, beat: steps.Heartbeat) -> None:
        self._vehicle.hear(beat.session_state, beat.session_token, time.time_ns())

    def _on_state(self, state: State) -> None:
        self._others[state.object_id] = state

    def _publish(self) -> None:
        others = [self._others[key] for key in sorted(self._others)]
        self._tell(self._vehicle.advance(others, time.time_ns()))

    def _header(self, message: Any) -> None:
        message.header.stamp = ros.stamp_from_ns(self._vehicle.now_ns + self._offset_ns)
        message.header.frame_id = self._frame

    def _as_odometry(self, body: BodyState) -> None:
        message = Odometry()
        self._header(message)
        message.child_frame_id = BASE_FRAME
        pose, twist = message.pose, message.twist.twist
        pose.pose.position.x, pose.pose.position.y = body.x_m, body.y_m
        pose.pose.orientation.z = math.sin(body.yaw_rad / 2.0)
        pose.pose.orientation.w = math.cos(body.yaw_rad / 2.0)
        pose.covariance[0] = pose.covariance[7] = _POSITION_STD_M**2
        twist.linear.x, twist.angular.z = body.speed_mps, body.yaw_rate_radps
        self._pub.publish(message)

    def _as_places(self, body: BodyState) -> None:
        """Publish velocity and heading first: a place is taken with what is there."""
        velocity, heading, place = TwistStamped(), Imu(), NavSatFix()
        for message in (velocity, heading, place):
            self._header(message)
        velocity.twist.linear.x, velocity.twist.angular.z = body.speed_mps, body.yaw_rate_radps
        self._velocities.publish(velocity)
        yaw_rad = self._datum.to_enu(Pose2(body.x_m, body.y_m, body.yaw_rad)).yaw_rad
        heading.orientation.z = math.sin(yaw_rad / 2.0)
        heading.orientation.w = math.cos(yaw_rad / 2.0)
        heading.orientation_covariance[8] = _HEADING_STD_RAD**2
        self._headings.publish(heading)
        there = self._datum.to_place(body.x_m, body.y_m)
        place.latitude, place.longitude = there.latitude_deg, there.longitude_deg
        place.altitude, place.status.status = there.altitude_m, self._fix_type
        place.position_covariance[0] = place.position_covariance[4] = _POSITION_STD_M**2
        place.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
        self._places.publish(place)


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(PlayedVut, lambda _node: None))


if __name__ == "__main__":
    main()
