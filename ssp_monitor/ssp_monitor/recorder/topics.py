"""Which topics are recorded, with which profile they are received, and which are dropped first."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum

from ssp_core import names
from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.world.transforms import TF_TYPE

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
# Of an expression over topic names.
MOST_CHARACTERS = 1000


class Pattern:
    """A regular expression over topic names, as Python's ``re`` understands it.

    Args:
        field: what it is called towards people, such as ``--include``.

    Raises:
        InputError: it is none.
    """

    def __init__(self, text: str, field: str) -> None:
        if len(text) > MOST_CHARACTERS:
            raise InputError(
                f"is longer than {MOST_CHARACTERS} characters", field=field, value=text
            )
        try:
            self._expression = re.compile(text, re.ASCII)
        except (re.error, OverflowError, RecursionError) as error:
            raise InputError(
                f"is no regular expression: {error}",
                field=field,
                value=text,
                remedy="write \\ before a character that is meant as itself",
            ) from error

    def found_in(self, name: str) -> bool:
        """Whether the expression matches somewhere in the name."""
        return self._expression.search(name) is not None


class Profile(Enum):
    """Named quality of service; ``ros/conversions.py`` maps it to that of ssp_core.ros."""

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


# Each reader takes memory and a thread's time. A session's own topics don't count.
MOST_TOPICS = 2000
# What every node has and no one looks for in a bag. Recorded when named, never by a pattern.
NOISE = frozenset(("/parameter_events", "/rosout"))


@dataclass(frozen=True, slots=True)
class Selection:
    """What a person asked for, beside the run's own topics.

    Args:
        everything: all topics of the graph.
        include: of the graph, those in whose names one of these is found.
        exclude: none of these, unless they are named or the run's own.
        own: the run's own topics, which are recorded in any case, by another rule.
    """

    everything: bool = False
    include: tuple[Pattern, ...] = ()
    exclude: tuple[Pattern, ...] = ()
    named: frozenset[str] = frozenset()
    own: frozenset[str] = frozenset()
    most: int = MOST_TOPICS

    @property
    def looks(self) -> bool:
        """Whether there is anything to look for on the graph."""
        return self.everything or bool(self.include or self.named)

    def wants(self, name: str) -> bool:
        """Whether a topic is asked for by its name."""
        if name in self.own:
            return False
        if name in self.named:
            return True
        if name in NOISE or is_hidden(name):
            return False
        if not (self.everything or any(pattern.found_in(name) for pattern in self.include)):
            return False
        return not any(pattern.found_in(name) for pattern in self.exclude)


def is_hidden(name: str) -> bool:
    """Whether a part of the name begins with an underscore, as ROS hides topics."""
    return "/_" in name


@dataclass(slots=True)
class TopicDiscovery:
    """What was found on the graph so far: each name is judged once, and once warned about."""

    selection: Selection
    # Topics by name with their types; those that are of another type too by now; and those that
    # had several types when they were found and are not recorded for that.
    recorded: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    changed: set[str] = field(default_factory=set)
    ambiguous: set[str] = field(default_factory=set)
    _judged: dict[str, bool] = field(default_factory=dict)
    _told: set[str] = field(default_factory=set)
    _refused: list[str] = field(default_factory=list)

    def look(
        self, graph: Iterable[tuple[str, Sequence[str]]], why_not: Callable[[str], str | None]
    ) -> list[TopicSpec]:
        """The topics to record from now on.

        Args:
            graph: names with the types that their publishers and subscribers have.
            why_not: says why a message type can't be recorded, None when it can.

        Returns:
            Those that are new, named ones first, then by name.
        """
        found: list[TopicSpec] = []
        for name, types in self.in_order(graph):
            if name in self.recorded:
                self._look_again(name, types)
            elif not types or not self.wants(name):
                continue
            elif (spec := self._new(name, types, why_not)) is not None:
                self.recorded[name] = spec.msgtype
                found.append(spec)
        return found

    def in_order(
        self, graph: Iterable[tuple[str, Sequence[str]]]
    ) -> list[tuple[str, Sequence[str]]]:
        """A graph as ``look`` goes through it, for who looks at parts of it."""
        return sorted(graph, key=lambda item: (item[0] not in self.selection.named, item[0]))

    def all_warnings(self) -> list[str]:
        if not self._refused:
            return list(self.warnings)
        some = ", ".join(self._refused[:5]) + (", ..." if len(self._refused) > 5 else "")
        limit = (
            f"{len(self._refused)} topics are not recorded, the limit is {self.selection.most}: "
            f"{some}"
        )
        return [*self.warnings, limit]

    def wants(self, name: str) -> bool:
        """As Selection.wants; each name is judged once."""
        judged = self._judged.get(name)
        if judged is None:
            judged = self._judged[name] = self.selection.wants(name)
        return judged

    def _new(
        self, name: str, types: Sequence[str], why_not: Callable[[str], str | None]
    ) -> TopicSpec | None:
        if len(types) > 1:
            self.ambiguous.add(name)
            self._warn(name, f"{_not_recorded(name)}: {', '.join(types)}")
            return None
        if (why := why_not(types[0])) is not None:
            self._warn(name, f"{name} is not recorded: {why}")
            return None
        if len(self.recorded) >= self.selection.most:
            if name not in self._told:
                self._told.add(name)
                self._refused.append(name)
            return None
        if name in self.ambiguous:
            self._settle(name)
        # Stamps of strangers may be of another clock, and nobody knows how many publish.
        return TopicSpec(name, types[0], Profile.ADAPTED, session_time=False)

    def _settle(self, name: str) -> None:
        """One type is left: the topic is recorded, and what came before stays lost."""
        self.ambiguous.discard(name)
        self.warnings = [text for text in self.warnings if not text.startswith(_not_recorded(name))]
        self.warnings.append(f"{name} had several types at first and is recorded since it has one")

    def _look_again(self, name: str, types: Sequence[str]) -> None:
        """A reader of the one type never hears the other; what it says is lost, and nobody can
        count it. rosbag2 does the same, without a word."""
        others = [kind for kind in types if kind != self.recorded[name]]
        if others and name not in self.changed:
            self.changed.add(name)
            self.warnings.append(
                f"{name} is also of type {', '.join(others)} now: only {self.recorded[name]} is "
                "recorded, the rest is lost"
            )

    def _warn(self, name: str, text: str) -> None:
        if name not in self._told:
            self._told.add(name)
            self.warnings.append(text)


def _not_recorded(name: str) -> str:
    return f"{name} has several types and is not recorded"


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
