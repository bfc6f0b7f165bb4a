"""What is dropped first when the disk doesn't keep up: the one table of it."""

from __future__ import annotations

from enum import IntEnum

from ssp_core.world.transforms import TF_TYPE
from ssp_monitor.core.topics import Profile, TopicSpec


class Importance(IntEnum):
    """From what is dropped first to what is dropped last. Its order is a promise to users: see
    queue.py for what it means, and docs/recording.md, which shows this table."""

    RAW_IMAGE = 0  # raw pictures, depth maps and point clouds that the run doesn't ask for
    COMPRESSED_IMAGE = 1  # compressed pictures and video that the run doesn't ask for
    OTHER = 2  # whatever else the run doesn't ask for
    DIAGNOSTIC = 3  # what the parts of a session, or anything else, say about their health
    FRAME = 4  # the run's own camera
    STATE = 5  # states of objects, world, clock, the camera's place and lens
    EVENT = 6  # session, triggers, phases, safety, faults, references, acknowledgements, commands


MEANINGS: dict[Importance, str] = {
    Importance.RAW_IMAGE: "raw images, disparity images and point clouds beside the run's topics",
    Importance.COMPRESSED_IMAGE: "compressed images and video beside the run's topics",
    Importance.OTHER: "all other topics beside the run's",
    Importance.DIAGNOSTIC: "diagnostics, logs, markers, heartbeats, link and recorder status",
    Importance.FRAME: "frames of the run's camera",
    Importance.STATE: "states, ticks, /clock, /tf, camera info and mount",
    Importance.EVENT: "session states, events, references, acknowledgements, commands",
}

_BY_TYPE: dict[str, Importance] = {
    "sensor_msgs/msg/Image": Importance.RAW_IMAGE,
    "sensor_msgs/msg/PointCloud": Importance.RAW_IMAGE,
    "sensor_msgs/msg/PointCloud2": Importance.RAW_IMAGE,
    "stereo_msgs/msg/DisparityImage": Importance.RAW_IMAGE,
    "sensor_msgs/msg/CompressedImage": Importance.COMPRESSED_IMAGE,
    "foxglove_msgs/msg/CompressedVideo": Importance.COMPRESSED_IMAGE,
    "diagnostic_msgs/msg/DiagnosticArray": Importance.DIAGNOSTIC,
    "diagnostic_msgs/msg/DiagnosticStatus": Importance.DIAGNOSTIC,
    "rcl_interfaces/msg/Log": Importance.DIAGNOSTIC,
    "visualization_msgs/msg/Marker": Importance.DIAGNOSTIC,
    "visualization_msgs/msg/MarkerArray": Importance.DIAGNOSTIC,
    "ssp_msgs/msg/Heartbeat": Importance.DIAGNOSTIC,
    "ssp_msgs/msg/HeartbeatReply": Importance.DIAGNOSTIC,
    "ssp_msgs/msg/LinkStatus": Importance.DIAGNOSTIC,
    "ssp_msgs/msg/RecorderStatus": Importance.DIAGNOSTIC,
    "ssp_msgs/msg/SessionState": Importance.EVENT,
    "ssp_msgs/msg/TriggerEvent": Importance.EVENT,
    "ssp_msgs/msg/PhaseEvent": Importance.EVENT,
    "ssp_msgs/msg/SafetyEvent": Importance.EVENT,
    "ssp_msgs/msg/FaultEvent": Importance.EVENT,
    "ssp_msgs/msg/Reference": Importance.EVENT,
    "ssp_msgs/msg/ReferenceAck": Importance.EVENT,
    "ssp_msgs/msg/ActuatorCommand": Importance.EVENT,
    "ssp_msgs/msg/ObjectState": Importance.STATE,
    "ssp_msgs/msg/ObjectStates": Importance.STATE,
    "ssp_msgs/msg/WorldTick": Importance.STATE,
    "rosgraph_msgs/msg/Clock": Importance.STATE,
    TF_TYPE: Importance.STATE,
}


def importance(topic: TopicSpec) -> Importance:
    """How long a topic's messages are kept while others are dropped."""
    if topic.profile is Profile.SENSOR and topic.msgtype == "sensor_msgs/msg/CompressedImage":
        return Importance.FRAME
    known = _BY_TYPE.get(topic.msgtype)
    if topic.profile is Profile.ADAPTED:
        return Importance.OTHER if known is None else known
    return Importance.STATE if known is None else known
