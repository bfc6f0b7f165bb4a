"""The vut_adapter node: nav_msgs/Odometry of the VUT's GNSS/INS in, vut/state out."""

from __future__ import annotations

import sys
import time

from nav_msgs.msg import Odometry
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr.states import encode_state
from ssp_core.errors import InputError
from ssp_core.run_file.model import load_run
from ssp_msgs.msg import ObjectState
from ssp_ot_controller.bodies.odometry import Fix, LeverArm, Unusable, VutStates
from ssp_ot_controller.ros.parameters import VUT_ADAPTER

# At most one message on unusable fixes in so many seconds.
_TELL_EVERY_S = 2.0


class VutAdapter(Node):
    """Thin node around bodies.odometry.VutStates."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.VUT_ADAPTER, namespace=names.NAMESPACE)
        given = ros.declare(self, VUT_ADAPTER)
        run = load_run(given["run_file"])
        if run.mode != "live":
            raise InputError(
                "has its VUT in the simulated world",
                field="mode",
                value=run.mode,
                remedy="start vut_adapter in live sessions only",
            )
        unit = given["unit_forward_m"], given["unit_left_m"], given["unit_yaw_left_rad"]
        self._states = VutStates(run.vut, LeverArm(*unit), names.MAP_FRAME)
        self._unusable = 0
        self._pub = self.create_publisher(ObjectState, names.state_topic(names.VUT_ID), ros.STATE)
        self.create_subscription(Odometry, given["odometry"], self._on_odometry, ros.DRIVER)

    def _on_odometry(self, message: Odometry) -> None:
        try:
            state = self._states.take(_fix(message), time.time_ns())
        except (Unusable, ValueError) as error:
            self._unusable += 1
            self.get_logger().error(
                f"fix dropped ({self._unusable} so far): {error}",
                throttle_duration_sec=_TELL_EVERY_S,
            )
            return
        self._pub.publish(encode_state(state))


def _fix(message: Odometry) -> Fix:
    """A message of the receiver; ValueError for a stamp that is none."""
    pose, twist = message.pose, message.twist.twist
    q = pose.pose.orientation
    return Fix(
        stamp_ns=ros.session_ns(message.header.stamp),
        frame_id=message.header.frame_id,
        x_m=pose.pose.position.x,
        y_m=pose.pose.position.y,
        quaternion=(q.x, q.y, q.z, q.w),
        forward_mps=twist.linear.x,
        left_mps=twist.linear.y,
        yaw_rate_radps=twist.angular.z,
        variance_x_m2=float(pose.covariance[0]),
        variance_y_m2=float(pose.covariance[7]),
    )


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(VutAdapter, lambda node: None))


if __name__ == "__main__":
    main()
