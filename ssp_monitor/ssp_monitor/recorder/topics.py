"""The topics that are recorded, the profiles that receive them, and the order of dropping."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum

from ssp_core import names
from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import declaring
from ssp_core.world.transforms import TF_TYPE

CLOCK_TYPE = "rosgraph_msgs/msg/Clock"
TEXT_TYPE = "std_msgs/msg/String"
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
                f"is longer than {MOST_CHARACTERS} characters",
                field=field,
                value=text,
                remedy="give a shorter one",
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

    def occurs_in(self, name: str) -> bool:
        """Tell whether the expression matches somewhere in the name."""
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

    @property
    def speaks_early(self) -> bool:
        """Tell whether its publisher sends before a run, so that a first message can be awaited."""
        return self.required and self.profile in (Profile.STATE, Profile.SENSOR)


def bag_topics(run: RunSpec) -> tuple[TopicSpec, ...]:
    """Return all topics of a session with their types, in the order of the bag."""
    specs: list[TopicSpec] = []

    def add(
        name: str, kind: str, profile: Profile, *, required: bool = False, session: bool = True
    ) -> None:
        msgtype = kind if "/" in kind else f"ssp_msgs/msg/{kind}"
        specs.append(TopicSpec(names.absolute(name), msgtype, profile, required, session))

    state, command, latched = Profile.STATE, Profile.COMMAND, Profile.LATCHED
    if run.mode != "live":
        add(names.CLOCK, CLOCK_TYPE, state)
        add(names.WORLD_TICK, "WorldTick", state, required=True)
    if run.plant == "carla":
        add(names.WORLD_PLANT, TEXT_TYPE, latched, required=True, session=False)
    add(names.state_topic(run.vut.id), "ObjectState", state, required=True)
    # In a live session the objects may be spread over several processes.
    if run.states_in_one:
        add(names.OBJECT_STATES, "ObjectStates", state, required=True)
    for target in run.targets:
        if not run.states_in_one:
            add(names.state_topic(target.id), "ObjectState", state, required=True)
        add(names.reference_topic(target.id), "Reference", command)
        add(names.ack_topic(target.id), "ReferenceAck", command)
        add(names.rules_topic(target.id), "ObjectRules", latched, session=False)
        if run.mode == "live":
            # Only objects that speak ISO 22133 have it, and a run file doesn't say which do.
            add(names.iso_frames_topic(target.id), "IsoFrames", state)
    add(names.TF, TF_TYPE, Profile.TF)
    add(names.TF_STATIC, TF_TYPE, Profile.TF_STATIC, session=False)
    add(names.SESSION_STATE, "SessionState", latched, required=True)
    add(names.HEARTBEAT, "Heartbeat", state)
    add(names.HEARTBEAT_REPLY, "HeartbeatReply", state, session=False)
    add(names.LINK_STATUS, "LinkStatus", state, session=False)
    add(names.TRIGGER_EVENT, "TriggerEvent", latched)
    add(names.PHASE_EVENT, "PhaseEvent", latched)
    add(names.SAFETY_EVENT, "SafetyEvent", latched)
    add(names.FAULT_EVENT, "FaultEvent", latched)
    add(names.RECORDER_STATUS, "RecorderStatus", state)
    if run.mode == "live":
        for who in declaring(run):
            add(names.declared_topic(who), TEXT_TYPE, latched, session=False)
        # Of a VUT whose states a vut_adapter makes.
        add(names.LOCALISATION_STATUS, "LocalisationStatus", state)
        add(names.BODY_STATUS, "BodyStatus", state)
    if run.driver.external:
        add(names.VUT_COMMAND, "ActuatorCommand", command)
    if run.driven is not None:
        add(names.vla_request_topic(run.driven.driver), "VlaRequest", command)
        add(names.vla_response_topic(run.driven.driver), "VlaResponse", command)
        if run.driven.latency.measured:
            latency = names.vla_latency_topic(run.driven.driver)
            add(latency, "diagnostic_msgs/msg/DiagnosticArray", command)
        add(names.reference_topic(run.vut.id), "Reference", command)
        add(names.ack_topic(run.vut.id), "ReferenceAck", command)
    if run.camera is not None:
        add(names.CAMERA_IMAGE, "sensor_msgs/msg/CompressedImage", Profile.SENSOR, required=True)
        # A camera of a proving ground may know no such numbers.
        ours = run.mode != "live"
        add(names.CAMERA_INFO, "sensor_msgs/msg/CameraInfo", Profile.SENSOR, required=ours)
        add(names.CAMERA_MOUNT, "geometry_msgs/msg/TransformStamped", latched)
        if run.camera.renderer == "carla":
            add(names.CAMERA_RENDERER, TEXT_TYPE, latched, required=True, session=False)
    return tuple(specs)


def uses_simulated_time(run: RunSpec) -> bool:
    """Tell whether stamps count from the start of a simulated world, and /clock carries them."""
    return run.mode != "live"


# Each reader takes memory and a thread's time. A session's own topics don't count.
MOST_TOPICS = 2000
# What every node has and no one looks for in a bag. Recorded when named, never by a pattern.
NOISE = frozenset(("/parameter_events", "/rosout"))


@dataclass(frozen=True, slots=True)
class Selection:
    """A person's selection, beside the run's own topics.

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
        """Tell whether there is anything to look for on the graph."""
        return self.everything or bool(self.include or self.named)

    def wants(self, name: str) -> bool:
        """Tell whether a topic is asked for by its name."""
        if name in self.own:
            return False
        if name in self.named:
            return True
        if name in NOISE or is_hidden(name):
            return False
        if not (self.everything or any(pattern.occurs_in(name) for pattern in self.include)):
            return False
        return not any(pattern.occurs_in(name) for pattern in self.exclude)


def is_hidden(name: str) -> bool:
    """Tell whether a part of the name begins with an underscore, as ROS hides topics."""
    return "/_" in name


@dataclass(slots=True)
class TopicDiscovery:
    """The topics found on the graph so far: each name is judged once, and once warned about."""

    selection: Selection
    # Topics by name with their types; those that are of another type too by now; and those that
    # had several types when they were found and are not recorded for that.
    recorded: dict[str, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    changed: set[str] = field(default_factory=set)
    ambiguous: set[str] = field(default_factory=set)
    _choices: dict[str, bool] = field(default_factory=dict)
    _reported_names: set[str] = field(default_factory=set)
    _refused: list[str] = field(default_factory=list)

    def look(
        self, graph: Iterable[tuple[str, Sequence[str]]], why_not: Callable[[str], str | None]
    ) -> list[TopicSpec]:
        """Return the topics to record from now on.

        Args:
            graph: names with the types that their publishers and subscribers have.
            why_not: says why a message type can't be recorded, None when it can.

        Returns:
            Those that are new, named ones first, then by name.
        """
        new_topics: list[TopicSpec] = []
        for name, types in self.in_order(graph):
            if name in self.recorded:
                self._look_again(name, types)
            elif not types or not self.wants(name):
                continue
            elif (spec := self._new(name, types, why_not)) is not None:
                self.recorded[name] = spec.msgtype
                new_topics.append(spec)
        return new_topics

    def in_order(
        self, graph: Iterable[tuple[str, Sequence[str]]]
    ) -> list[tuple[str, Sequence[str]]]:
        """Return a graph in the order of ``look``, for callers that look at parts of it."""
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
        """Tell the same as Selection.wants; each name is judged once."""
        is_wanted = self._choices.get(name)
        if is_wanted is None:
            is_wanted = self._choices[name] = self.selection.wants(name)
        return is_wanted

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
            if name not in self._reported_names:
                self._reported_names.add(name)
                self._refused.append(name)
            return None
        if name in self.ambiguous:
            self._settle(name)
        # Stamps of strangers may be of another clock, and nobody knows how many publish.
        return TopicSpec(name, types[0], Profile.ADAPTED, session_time=False)

    def _settle(self, name: str) -> None:
        """Take a topic whose one type is left; what came before stays lost."""
        self.ambiguous.discard(name)
        self.warnings = [text for text in self.warnings if not text.startswith(_not_recorded(name))]
        self.warnings.append(f"{name} had several types at first and is recorded since it has one")

    def _look_again(self, name: str, types: Sequence[str]) -> None:
        """Warn that a topic has got another type, whose messages are lost uncounted.

        A reader of the one type never hears the other. rosbag2 does the same, without a word.
        """
        others = [kind for kind in types if kind != self.recorded[name]]
        if others and name not in self.changed:
            self.changed.add(name)
            self.warnings.append(
                f"{name} is also of type {', '.join(others)} now: only {self.recorded[name]} is "
                "recorded, the rest is lost"
            )

    def _warn(self, name: str, text: str) -> None:
        if name not in self._reported_names:
            self._reported_names.add(name)
            self.warnings.append(text)


def _not_recorded(name: str) -> str:
    return f"{name} has several types and is not recorded"


class Importance(IntEnum):
    """The order of dropping, from first to last.

    It is a promise to users: see DropQueue for its effect, and docs/recording.md, which shows this
    table.
    """

    RAW_IMAGE = 0  # raw pictures, depth maps and point clouds that the run doesn't ask for
    COMPRESSED_IMAGE = 1  # compressed pictures and video that the run doesn't ask for
    OTHER = 2  # whatever else the run doesn't ask for
    DIAGNOSTIC = 3  # what the parts of a session, or anything else, say about their health
    FRAME = 4  # the run's own camera
    STATE = 5  # states of objects, world, clock, camera's place and lens; frames of ISO 22133
    EVENT = 6  # session, triggers, phases, safety, faults, references, acknowledgements, commands


MEANINGS: dict[Importance, str] = {
    Importance.RAW_IMAGE: "raw images, disparity images and point clouds beside the run's topics",
    Importance.COMPRESSED_IMAGE: "compressed images and video beside the run's topics",
    Importance.OTHER: "all other topics beside the run's",
    Importance.DIAGNOSTIC: "diagnostics, logs, markers, heartbeats, link and recorder status",
    Importance.FRAME: "frames of the run's camera",
    Importance.STATE: "states, ticks, /clock, /tf, camera info and mount, frames of ISO 22133",
    Importance.EVENT: "session states, events, references, acknowledgements, commands",
}

_OF_TYPES: dict[Importance, str] = {
    Importance.RAW_IMAGE: """sensor_msgs/Image sensor_msgs/PointCloud sensor_msgs/PointCloud2
        stereo_msgs/DisparityImage""",
    Importance.COMPRESSED_IMAGE: "sensor_msgs/CompressedImage foxglove_msgs/CompressedVideo",
    Importance.DIAGNOSTIC: """diagnostic_msgs/DiagnosticArray diagnostic_msgs/DiagnosticStatus
        rcl_interfaces/Log visualization_msgs/Marker visualization_msgs/MarkerArray
        ssp_msgs/Heartbeat ssp_msgs/HeartbeatReply ssp_msgs/LinkStatus ssp_msgs/RecorderStatus
        ssp_msgs/LocalisationStatus ssp_msgs/BodyStatus""",
    Importance.EVENT: """ssp_msgs/SessionState ssp_msgs/TriggerEvent ssp_msgs/PhaseEvent
        ssp_msgs/SafetyEvent ssp_msgs/FaultEvent ssp_msgs/Reference ssp_msgs/ReferenceAck
        ssp_msgs/ActuatorCommand""",
    Importance.STATE: """ssp_msgs/ObjectState ssp_msgs/ObjectStates ssp_msgs/WorldTick
        ssp_msgs/IsoFrames
        rosgraph_msgs/Clock tf2_msgs/TFMessage""",
}
_BY_TYPE = {
    name.replace("/", "/msg/"): rank for rank, types in _OF_TYPES.items() for name in types.split()
}


def importance(topic: TopicSpec) -> Importance:
    """Return how long a topic's messages are kept while others are dropped."""
    if topic.profile is Profile.SENSOR and topic.msgtype == "sensor_msgs/msg/CompressedImage":
        return Importance.FRAME
    type_importance = _BY_TYPE.get(topic.msgtype)
    if topic.profile is Profile.ADAPTED:
        return Importance.OTHER if type_importance is None else type_importance
    return Importance.STATE if type_importance is None else type_importance
