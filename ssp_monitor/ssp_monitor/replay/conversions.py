"""From the terms of a bag to those of ROS."""

from __future__ import annotations

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from ssp_core.bag.types import definition
from ssp_core.errors import HostError, InputError
from ssp_monitor.conversions import message_class
from ssp_monitor.replay.offer import Offer


def profile_of(offer: Offer) -> QoSProfile:
    """The publisher's profile."""
    durable = DurabilityPolicy.TRANSIENT_LOCAL if offer.latched else DurabilityPolicy.VOLATILE
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=offer.depth,
        durability=durable,
        reliability=(
            ReliabilityPolicy.RELIABLE if offer.reliable else ReliabilityPolicy.BEST_EFFORT
        ),
    )


def why_not_installed(msgtype: str, type_hash: str) -> str | None:
    """Why messages of a recorded type can't be published here, None where they can.

    Args:
        msgtype: full name.
        type_hash: of the definition that they were written with, empty where it isn't known.
    """
    try:
        # A name out of a bag is imported only when it is that of an interface package.
        known = definition(msgtype).type_hash
        message_class(msgtype)
    except (InputError, HostError):
        return f"its type {msgtype} is not installed"
    if type_hash and known and type_hash != known:
        return f"it was recorded with another definition of {msgtype} than is installed"
    return None
