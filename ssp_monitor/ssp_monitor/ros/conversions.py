"""The conversion from recorder and replay to ROS: QoS profiles, message classes, status."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import yaml
from rclpy.duration import Duration
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ssp_core import ros
from ssp_core.bag.metadata import MAX_TEXT
from ssp_core.bag.types import definition, installed_file
from ssp_core.clock import NS_PER_S
from ssp_core.errors import HostError, InputError, SspError
from ssp_monitor.recorder.recorder import TopicRecord
from ssp_monitor.recorder.topics import Importance, Profile, TopicSpec, importance
from ssp_monitor.replay.plan import PublisherQos
from ssp_msgs.msg import TopicStatus

PUBLISHED: dict[Profile, QoSProfile] = {
    profile: getattr(ros, profile.name) for profile in Profile if profile is not Profile.ADAPTED
}

# RELIABLE doesn't protect a KEEP_LAST reader that stalls, so there is room for two seconds of a
# world that runs ten times faster than real time.
RECORDER_DEPTH = {
    Profile.STATE: 4000,
    Profile.COMMAND: 1000,
    Profile.SENSOR: 600,
    Profile.LATCHED: 1000,
    Profile.TF: 4000,
    Profile.TF_STATIC: 100,
}
# Of topics that are not the run's own: pictures are large, the rest is many.
PICTURE_DEPTH = 100
OTHER_DEPTH = 1000


def recording_profile(profile: Profile) -> QoSProfile:
    """Return the publishers' profile with a reader's history that is deep enough for a recorder."""
    published = PUBLISHED[profile]
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=RECORDER_DEPTH[profile],
        reliability=published.reliability,
        durability=published.durability,
    )


def adapted_profile(topic: TopicSpec, publishers: Sequence[TopicEndpointInfo]) -> QoSProfile:
    """Return a profile that hears all publishers and asks for as much as all of them offer.

    The rule is rosbag2's: reliable when all are, transient local when all are.
    """
    offered = [publisher.qos_profile for publisher in publishers]
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = is_latched(publishers)
    pictures = importance(topic) <= Importance.COMPRESSED_IMAGE
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=PICTURE_DEPTH if pictures else OTHER_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def is_latched(publishers: Sequence[TopicEndpointInfo]) -> bool:
    """Tell whether all publishers keep their last messages for those that join later."""
    return bool(publishers) and all(
        publisher.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        for publisher in publishers
    )


def is_compatible(publisher: TopicEndpointInfo, msgtype: str, reader_qos: QoSProfile) -> bool:
    """Tell whether a reader of this type and profile hears a publisher."""
    compatible = qos_check_compatible(publisher.qos_profile, reader_qos)[0]
    return bool(publisher.topic_type == msgtype and compatible != QoSCompatibility.ERROR)


def offered_profiles(publishers: Sequence[TopicEndpointInfo]) -> str:
    """Return YAML of what the publishers offer, complete, for the bag.

    Each profile stands once, however many have it, and no more than a bag may hold.

    Publishers don't tell others their history and depth: these are as rosbag2 writes them.
    """
    entries: list[dict[str, Any]] = []
    for publisher in publishers:
        entry = _entry(publisher.qos_profile)
        if entry not in entries:
            entries.append(entry)
    text = ""
    for entry in entries:
        one = yaml.safe_dump([entry], sort_keys=False)
        if len(text) + len(one) > MAX_TEXT:
            break
        text += one
    return text


def _entry(qos: QoSProfile) -> dict[str, Any]:
    return {
        "history": _policy(qos.history),
        "depth": qos.depth,
        "reliability": _policy(qos.reliability),
        "durability": _policy(qos.durability),
        "deadline": _seconds(qos.deadline),
        "lifespan": _seconds(qos.lifespan),
        "liveliness": _policy(qos.liveliness),
        "liveliness_lease_duration": _seconds(qos.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": qos.avoid_ros_namespace_conventions,
    }


def _policy(policy: Any) -> str:
    return str(policy.name).lower()


def _seconds(duration: Duration) -> dict[str, int]:
    sec, nsec = divmod(duration.nanoseconds, NS_PER_S)
    return {"sec": sec, "nsec": nsec}


def why_not_recordable(msgtype: str) -> str | None:
    """Say why messages of a type can't be recorded here, None when they can.

    Args:
        msgtype: as the graph names it: anybody may have sent it.
    """
    if installed_file(msgtype) is None:
        return f"message type {msgtype} is not installed"
    try:
        message_class(msgtype)
        definition(msgtype)
    except SspError as error:
        return str(error)
    return None


def topic_status(
    record: TopicRecord, publishers: int, lost: int, dropped: int, rate_hz: float
) -> TopicStatus:
    """Return one topic as the recorder's status shows it."""
    return TopicStatus(
        name=record.name,
        type=record.msgtype,
        publishers=publishers,
        messages=record.messages,
        bytes=record.bytes,
        lost=lost,
        dropped=dropped,
        rate_hz=rate_hz,
    )


def message_class(msgtype: str) -> type:
    """Return the generated class of a type given as ``package/msg/Name``.

    Raises:
        HostError: this ROS installation lacks it.
    """
    package, _, name = msgtype.partition("/msg/")
    try:
        ros_class: type = getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise HostError(f"message type {msgtype} is not installed: {error}") from error
    return ros_class


def profile_of(offer: PublisherQos) -> QoSProfile:
    """Return the publisher's profile."""
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
    """Say why messages of a recorded type can't be published here, None where they can.

    Args:
        msgtype: ``package/msg/Name``.
        type_hash: of the definition that they were written with, empty where it isn't known.
    """
    try:
        # A name out of a bag is imported only when it is that of an interface package.
        installed_hash = definition(msgtype).type_hash
        message_class(msgtype)
    except (InputError, HostError):
        return f"its type {msgtype} is not installed"
    if type_hash and installed_hash and type_hash != installed_hash:
        return f"it was recorded with another definition of {msgtype} than is installed"
    return None
