"""The one table of what a session's bag holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.world.transforms import TF_TYPE

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"


class Profile(Enum):
    """Named quality of service; node.py maps it to that of ssp_core.ros."""

    STATE = "state"
    COMMAND = "command"
    SENSOR = "sensor"
    LATCHED = "latched"
    TF = "tf"
    TF_STATIC = "tf_static"
    ADAPTED = "adapted"  # not the run's own: heard as its publishers offer it


@dataclass(frozen=True, slots=True)
class TopicSpec:
    """One topic to record.

    Args:
        name: absolute.
        msgtype: full type name.
        profile: what its publishers offer.
        required: its publisher exists before a run; the recorder isn't ready without it.
        session_time: the first stamp of its messages, if any, is on the session's clock.
    """

    name: str
    msgtype: str
    profile: Profile
    required: bool = False
    session_time: bool = True


def bag_topics(run: RunSpec) -> tuple[TopicSpec, ...]:
    """All topics of a session with their types, in the order in which they stand in the bag."""
    state, reference = "ssp_msgs/msg/ObjectState", "ssp_msgs/msg/Reference"
    topics = [TopicSpec(names.state_topic(run.vut.id), state, Profile.STATE, required=True)]
    live = run.mode == "live"
    if not live:
        topics = [
            TopicSpec(names.CLOCK, CLOCK_TYPE, Profile.STATE),
            TopicSpec(names.WORLD_TICK, "ssp_msgs/msg/WorldTick", Profile.STATE, required=True),
            *topics,
        ]
    # In a live session the objects may be spread over several processes.
    if run.states_in_one:
        arrays = "ssp_msgs/msg/ObjectStates"
        topics.append(
            TopicSpec(
                names.OBJECT_STATES,
                arrays,
                Profile.STATE,
                required=True,
            )
        )
    for target in run.targets:
        if not run.states_in_one:
            topics.append(
                TopicSpec(names.state_topic(target.id), state, Profile.STATE, required=True)
            )
        topics += [
            TopicSpec(names.reference_topic(target.id), reference, Profile.COMMAND),
            TopicSpec(names.ack_topic(target.id), "ssp_msgs/msg/ReferenceAck", Profile.COMMAND),
        ]
    latched = Profile.LATCHED
    topics += [
        TopicSpec(names.TF, TF_TYPE, Profile.TF),
        TopicSpec(names.TF_STATIC, TF_TYPE, Profile.TF_STATIC, session_time=False),
        TopicSpec(names.SESSION_STATE, "ssp_msgs/msg/SessionState", latched, required=True),
        TopicSpec(names.HEARTBEAT, "ssp_msgs/msg/Heartbeat", Profile.STATE),
        TopicSpec(
            names.HEARTBEAT_REPLY,
            "ssp_msgs/msg/HeartbeatReply",
            Profile.STATE,
            session_time=False,
        ),
        TopicSpec(names.LINK_STATUS, "ssp_msgs/msg/LinkStatus", Profile.STATE, session_time=False),
        TopicSpec(names.TRIGGER_EVENT, "ssp_msgs/msg/TriggerEvent", latched),
        TopicSpec(names.PHASE_EVENT, "ssp_msgs/msg/PhaseEvent", latched),
        TopicSpec(names.SAFETY_EVENT, "ssp_msgs/msg/SafetyEvent", latched),
        TopicSpec(names.FAULT_EVENT, "ssp_msgs/msg/FaultEvent", latched),
        TopicSpec(names.RECORDER_STATUS, "ssp_msgs/msg/RecorderStatus", Profile.STATE),
    ]
    if run.driver.external:
        topics.append(TopicSpec(names.VUT_COMMAND, "ssp_msgs/msg/ActuatorCommand", Profile.COMMAND))
    if run.camera is not None:
        topics += [
            TopicSpec(
                names.CAMERA_IMAGE, "sensor_msgs/msg/CompressedImage", Profile.SENSOR, required=True
            ),
            TopicSpec(names.CAMERA_INFO, "sensor_msgs/msg/CameraInfo", Profile.SENSOR),
            TopicSpec(names.CAMERA_MOUNT, "geometry_msgs/msg/TransformStamped", latched),
        ]
    return tuple(replace(topic, name=names.absolute(topic.name)) for topic in topics)


def uses_simulated_time(run: RunSpec) -> bool:
    """Whether stamps count from the start of a simulated world, and /clock carries them."""
    return run.mode != "live" and (run.stand_in or run.domain != "physical")
