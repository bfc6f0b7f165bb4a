"""From the recorder's terms to those of ROS."""

from __future__ import annotations

import importlib

from rclpy.qos import HistoryPolicy, QoSProfile

from ssp_core import ros
from ssp_core.errors import HostError
from ssp_monitor.core.topics import Profile

PUBLISHED: dict[Profile, QoSProfile] = {
    Profile.STATE: ros.STATE,
    Profile.COMMAND: ros.COMMAND,
    Profile.SENSOR: ros.SENSOR,
    Profile.LATCHED: ros.LATCHED,
}

# RELIABLE doesn't protect a KEEP_LAST reader that stalls, so there is room for two seconds of a
# world that runs ten times faster than real time.
RECORDER_DEPTH = {
    Profile.STATE: 4000,
    Profile.COMMAND: 1000,
    Profile.SENSOR: 600,
    Profile.LATCHED: 1000,
}


def recording_profile(profile: Profile) -> QoSProfile:
    """The publishers' profile with a reader's history that is deep enough for a recorder."""
    published = PUBLISHED[profile]
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=RECORDER_DEPTH[profile],
        reliability=published.reliability,
        durability=published.durability,
    )


def message_class(msgtype: str) -> type:
    """The generated class of a type given as ``package/msg/Name``.

    Raises:
        HostError: this ROS installation lacks it.
    """
    package, _, name = msgtype.partition("/msg/")
    try:
        found: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise HostError(f"message type {msgtype} is not installed: {error}") from error
    return found
