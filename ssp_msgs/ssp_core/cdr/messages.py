"""The fields read out of messages without ROS: of decoded ones from any reader, and of raw bytes.

A message decoded by rclpy and one decoded by rosbags have the same attributes, so that one function
serves both.
"""

from __future__ import annotations

import struct
from typing import Any

from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState, Size
from ssp_core.vocabulary import ControlState, ObjectClass, Role

_LITTLE = struct.Struct("<iI")
_BIG = struct.Struct(">iI")
_ENCAPSULATION_BYTES = 4


def stamp_ns(stamp: Any) -> int:
    """Return a decoded builtin_interfaces/Time in ns."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def leading_stamp_ns(cdr: bytes, at: int = _ENCAPSULATION_BYTES) -> int | None:
    """Return the stamp with which a serialised message begins, ns; None when there is no valid one.

    Eight bytes instead of the whole message are what makes an index over camera frames cheap.

    Layout: four bytes of encapsulation (the second one's low bit: little endian), int32 seconds,
    uint32 nanoseconds; ``at`` is where they stand. Stamps before 0 can't stand in a bag and are
    none.
    """
    if len(cdr) < at + _LITTLE.size:
        return None
    layout = _LITTLE if cdr[1] & 1 else _BIG
    seconds, nanoseconds = layout.unpack_from(cdr, at)
    return seconds * NS_PER_S + nanoseconds if seconds >= 0 else None


def peek_stamp_ns(cdr: bytes) -> int:
    """Read a stamp as leading_stamp_ns does, of a message that must have one.

    Raises:
        ValueError: it has none.
    """
    stamp = leading_stamp_ns(cdr)
    if stamp is None:
        raise ValueError(f"{len(cdr)} bytes don't begin with a stamp")
    return stamp


def object_state(message: Any) -> ObjectState:
    """Return a decoded ssp_msgs/ObjectState.

    Raises:
        ValueError: a number that stands for no class, role or control state.
    """
    return ObjectState(
        object_id=str(message.object_id),
        object_class=ObjectClass(message.object_class),
        role=Role(message.role),
        stamp_ns=stamp_ns(message.header.stamp),
        x_m=float(message.x),
        y_m=float(message.y),
        yaw_rad=float(message.yaw),
        speed_mps=float(message.speed),
        acceleration_mps2=float(message.acceleration),
        yaw_rate_radps=float(message.yaw_rate),
        size=Size(
            float(message.front), float(message.rear), float(message.width), float(message.height)
        ),
        sequence=int(message.sequence),
        control_state=ControlState(message.control_state),
        position_std_m=float(message.position_std),
        reference_id=str(message.reference_id),
        error_longitudinal_m=float(message.error_longitudinal),
        error_lateral_m=float(message.error_lateral),
        error_yaw_rad=float(message.error_yaw),
    )
