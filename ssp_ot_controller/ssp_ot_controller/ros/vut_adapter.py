"""The vut_adapter node: odometry or places of the VUT's GNSS/INS in, vut/state out."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from geometry_msgs.msg import Twist, TwistStamped, TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu, NavSatFix

from ssp_core import names, ros
from ssp_core.cdr.states import encode_state
from ssp_core.errors import InputError
from ssp_core.geodesy import Place
from ssp_core.motion.state import ObjectState as State
from ssp_core.run_file.model import RunSpec, load_run
from ssp_msgs.msg import LocalisationStatus, ObjectState
from ssp_ot_controller.bodies.gnss import FixType, Gate, GnssStates, Heading, NavSat, Speed
from ssp_ot_controller.bodies.odometry import Fix, LeverArm, Unusable, VutStates
from ssp_ot_controller.ros.parameters import VUT_ADAPTER

# At most one message on unusable fixes in so many seconds.
_TELL_EVERY_S = 2.0
STATUS_PERIOD_S = 0.5
_TWISTS = {
    "geometry_msgs/msg/TwistStamped": (TwistStamped, lambda message: message.twist),
    "geometry_msgs/msg/TwistWithCovarianceStamped": (
        TwistWithCovarianceStamped,
        lambda message: message.twist.twist,
    ),
}


class VutAdapter(Node):
    """Thin node around bodies.odometry.VutStates and bodies.gnss.GnssStates."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__(names.VUT_ADAPTER, namespace=names.NAMESPACE)
        parameters = ros.declare(self, VUT_ADAPTER)
        run = load_run(parameters["run_file"])
        if run.mode != "live":
            raise InputError(
                "has its VUT in the simulated world",
                field="mode",
                value=run.mode,
                remedy="start vut_adapter in live sessions only",
            )
        unit = (
            parameters["unit_forward_m"],
            parameters["unit_left_m"],
            parameters["unit_yaw_left_rad"],
        )
        lever = LeverArm(*unit)
        self._states = VutStates(run.vut, lever, names.MAP_FRAME)
        self._used = self._unusable = self._message_count = self._reported_count = 0
        self._reason = ""
        self._velocity = ""
        self._pub = self.create_publisher(ObjectState, names.state_topic(names.VUT_ID), ros.STATE)
        self._status = self.create_publisher(
            LocalisationStatus, names.LOCALISATION_STATUS, ros.STATE
        )
        if parameters["navsat"]:
            self._places = parameters["navsat"]
            self._hear_gnss(run, parameters, lever)
        else:
            self._places = parameters["odometry"]
            self.create_subscription(Odometry, self._places, self._on_odometry, ros.DRIVER)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(STATUS_PERIOD_S, self._tell_status, clock=steady)

    def _hear_gnss(self, run: RunSpec, parameters: dict[str, Any], lever: LeverArm) -> None:
        if run.datum is None:
            raise InputError(
                "is missing: --navsat gives latitudes, and the site's position is unknown",
                file=parameters["run_file"],
                field="datum",
                remedy="give the site file one, compile again, or take --odometry in frame map",
            )
        gate = Gate(FixType[parameters["least_fix"].upper()], run.limits.state_age_s)
        self._velocity = parameters["velocity"]
        by_course = run.vut.id in run.limits.heading_by_course
        self._gnss = GnssStates(
            self._states,
            lever,
            run.datum.datum,
            gate,
            speeds=bool(self._velocity),
            start_yaw_rad=run.vut.start.yaw_rad if by_course else None,
        )
        sub = self.create_subscription
        sub(NavSatFix, self._places, self._on_place, ros.DRIVER)
        sub(Imu, parameters["heading"], self._on_heading, ros.DRIVER)

    # -- what arrives --------------------------------------------------------------------------

    def _on_odometry(self, message: Odometry) -> None:
        self._publish(lambda: self._states.take(_fix(message), time.time_ns()))

    def _on_place(self, message: NavSatFix) -> None:
        self._publish(lambda: self._gnss.take(_nav_sat(message), time.time_ns()))

    def _on_heading(self, message: Imu) -> None:
        self._tolerate("heading", lambda: self._gnss.hear_heading(_heading(message)))

    def _on_velocity(self, twist_of: Callable[[Any], Twist], message: Any) -> None:
        self._tolerate("velocity", lambda: self._gnss.hear_speed(_speed(message, twist_of)))

    def _publish(self, make: Callable[[], State]) -> None:
        self._message_count += 1
        try:
            state = make()
        except (Unusable, ValueError) as error:
            self._refuse("fix dropped", str(error))
            self._reason = str(error)
            return
        self._used += 1
        self._reason = ""
        self._pub.publish(encode_state(state))

    def _tolerate(self, what: str, hear: Callable[[], None]) -> None:
        """Hear a message; what can't be used here the next fix says it lacks."""
        try:
            hear()
        except (Unusable, ValueError) as error:
            self._refuse(f"{what} dropped", str(error))

    def _refuse(self, what: str, why: str) -> None:
        self._unusable += 1
        self.get_logger().error(
            f"{what} ({self._unusable} so far): {why}", throttle_duration_sec=_TELL_EVERY_S
        )

    # -- what is told --------------------------------------------------------------------------

    def _tell_status(self) -> None:
        if self._velocity:
            self._find_velocity()
        status = LocalisationStatus(object_id=names.VUT_ID)
        status.header.stamp = ros.stamp_from_ns(time.time_ns())
        status.used, status.refused = self._used, self._unusable
        silent = f"nothing arrives on {names.absolute(self._places)}"
        status.reason = self._reason if self._message_count > self._reported_count else silent
        self._reported_count = self._message_count
        self._status.publish(status)

    def _find_velocity(self) -> None:
        """Hear the topic once it is there: only its publisher says of which type it is."""
        topic = self.resolve_topic_name(self._velocity)
        for name in dict(self.get_topic_names_and_types()).get(topic, ()):
            if name in _TWISTS:
                kind, twist_of = _TWISTS[name]
                take = partial(self._on_velocity, twist_of)
                self.create_subscription(kind, self._velocity, take, ros.DRIVER)
                self._velocity = ""
                return


def _fix(message: Odometry) -> Fix:
    """Convert a message of the receiver; raise ValueError for a stamp that is none."""
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


def _nav_sat(message: NavSatFix) -> NavSat:
    """Convert a place; a driver's variance from DOP or from nothing can't be relied on."""
    stated = message.position_covariance_type >= NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    east, north = (float(message.position_covariance[i]) for i in (0, 4))
    return NavSat(
        stamp_ns=ros.session_ns(message.header.stamp),
        status=message.status.status,
        place=Place(message.latitude, message.longitude, message.altitude),
        variance_m2=max(east, north) if stated and min(east, north) > 0.0 else math.nan,
    )


def _speed(message: Any, twist_of: Callable[[Any], Twist]) -> Speed:
    linear = twist_of(message).linear
    return Speed(ros.session_ns(message.header.stamp), math.hypot(linear.x, linear.y))


def _heading(message: Imu) -> Heading:
    q, covariance = message.orientation, message.orientation_covariance
    none = covariance[0] < 0.0  # as sensor_msgs says it
    return Heading(
        stamp_ns=ros.session_ns(message.header.stamp),
        quaternion=(q.x, q.y, q.z, q.w),
        variance_rad2=-1.0 if none else float(covariance[8]),
    )


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(VutAdapter, lambda _node: None))


if __name__ == "__main__":
    main()
