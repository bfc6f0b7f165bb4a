"""Object states out of decoded bag messages, without ROS."""

from __future__ import annotations

import struct
from typing import Any

from ssp_core.clock import NS_PER_S
from ssp_core.state import ObjectState, Size
from ssp_core.vocab import ControlState, ObjectClass, Role


def stamp_ns(header: Any) -> int:
    """The stamp of a decoded std_msgs/Header in ns."""
    return int(header.stamp.sec) * NS_PER_S + int(header.stamp.nanosec)


def peek_stamp_ns(cdr: bytes) -> int:
    """The header stamp of a serialised message that begins with a std_msgs/Header.

    Reading eight bytes instead of the whole message is what makes an index over camera frames
    cheap.

    Raises:
        ValueError: it is too short for a header.
    """
    if len(cdr) < 12:
        raise ValueError(f"{len(cdr)} bytes hold no header")
    seconds, nanoseconds = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def object_state(msg: Any) -> ObjectState:
    """A decoded ssp_msgs/ObjectState.

    Raises:
        ValueError: a number that stands for no class, role or control state.
    """
    return ObjectState(
        object_id=str(msg.object_id),
        object_class=ObjectClass(msg.object_class),
        role=Role(msg.role),
        stamp_ns=stamp_ns(msg.header),
        x_m=float(msg.x),
        y_m=float(msg.y),
        yaw_rad=float(msg.yaw),
        speed_mps=float(msg.speed),
        acceleration_mps2=float(msg.acceleration),
        yaw_rate_radps=float(msg.yaw_rate),
        size=Size(float(msg.front), float(msg.rear), float(msg.width), float(msg.height)),
        sequence=int(msg.sequence),
        control_state=ControlState(msg.control_state),
        position_std_m=float(msg.position_std),
        reference_id=str(msg.reference_id),
        error_longitudinal_m=float(msg.error_longitudinal),
        error_lateral_m=float(msg.error_lateral),
        error_yaw_rad=float(msg.error_yaw),
    )
