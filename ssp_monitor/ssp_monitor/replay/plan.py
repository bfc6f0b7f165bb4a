"""The topics of a bag that are published, their QoS, and those that are omitted and why."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ssp_core import names
from ssp_core.bag.metadata import parse_offered_qos
from ssp_core.bag.writing.latched import is_static
from ssp_core.errors import InputError
from ssp_core.run_file.participation import CAMERA, POSITIONING, body_of
from ssp_monitor.recorder.topics import CLOCK_TYPE, Pattern

if TYPE_CHECKING:
    from ssp_core.bag.reading.reader import TopicInfo

# Of the project's own types these are acted on. The others report, whatever their topic is called.
COMMAND_TYPES = frozenset(
    (
        "ssp_msgs/msg/Reference",
        "ssp_msgs/msg/ActuatorCommand",
        "ssp_msgs/msg/ActuatorCommands",
        "ssp_msgs/msg/Heartbeat",  # objects stop when it stays away
        "ssp_msgs/msg/WorldTick",  # participants in lockstep step on it
        "ssp_msgs/msg/StepDone",
    )
)
_OWN_PACKAGE = "ssp_msgs"
# Packages whose messages go to vehicles and machines; some report too, and are left out with them.
_PACKAGES = """
    ackermann_msgs autoware_auto_control_msgs autoware_auto_planning_msgs
    autoware_auto_vehicle_msgs autoware_control_msgs autoware_planning_msgs
    autoware_vehicle_msgs can_msgs carla_msgs control_msgs mavros_msgs pacmod_msgs pacmod3_msgs
    px4_msgs tier4_control_msgs tier4_planning_msgs tier4_vehicle_msgs trajectory_msgs
"""
_COMMAND_PACKAGES = frozenset(_PACKAGES.split())
_DRIVE_BY_WIRE = "dbw"
# In a name, of a topic or of a type: as a word of its own ...
_WORDS = """
    accelerator actuation actuator actuators autopilot command commands commanded control
    controls ctrl demand desired drive emergency engage engaged estop gear goal goals jog joy
    mission pedal ref reference references request set stop target targets torque twist vel
    waypoint waypoints
"""
_COMMAND_WORDS = frozenset(_WORDS.split())
# ... or anywhere in one, as in "cmdvel" or "handbrake".
_STEMS = """
    brake braking cmd joystick setpoint setspeed steer teleop throttle trajector
"""
_COMMAND_STEMS = tuple(_STEMS.split())
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")

# Nodes and services that only a session has: those that move objects, and the one that tells them.
SESSION_NODES = frozenset(
    (
        names.SCENARIO_MANAGER,
        names.OBJECT_TARGET,
        names.SIL_WORLD,
        names.VUT_ADAPTER,
        names.VUT_DRIVER,
    )
)
SESSION_SERVICES = frozenset(("ssp_msgs/srv/ObjectCommand", "ssp_msgs/srv/LoadScenario"))


def is_command(topic: str, msgtype: str) -> bool:
    """Tell whether an object may act on messages of a topic as it was recorded.

    What isn't the project's own is judged by words, so that it is rather left out than sent.
    """
    package, _, kind = msgtype.partition("/")
    if package == _OWN_PACKAGE:  # an acknowledgement of a reference is none
        return msgtype in COMMAND_TYPES
    return (
        package in _COMMAND_PACKAGES
        or _DRIVE_BY_WIRE in package.split("_")
        or is_command_name(kind)
        or is_command_name(topic)
    )


def is_command_name(name: str) -> bool:
    """Tell whether any part of a name, of a topic or of a type, sounds like something to act on."""
    words = {word.lower() for word in _WORD.findall(name)}
    return not _COMMAND_WORDS.isdisjoint(words) or any(
        stem in name.lower() for stem in _COMMAND_STEMS
    )


def session_signs(
    nodes: Iterable[tuple[str, str]], services: Iterable[tuple[str, Iterable[str]]]
) -> list[str]:
    """List the signs on the graph of a session that is under way, for people; empty: none.

    Services tell of nodes that were given other names.
    """
    signs = {f"node {space.rstrip('/')}/{name}" for name, space in nodes if name in SESSION_NODES}
    signs |= {
        f"service {name}" for name, types in services if not SESSION_SERVICES.isdisjoint(types)
    }
    return sorted(signs)


# Room for a subscriber that stalls for a moment. What a subscriber has acknowledged is forgotten,
# so that it costs nothing while all keep up.
VOLATILE_DEPTH = 500
# A bag's own word for it must not make this process keep any number of messages for good.
MOST_LATCHED = 1000
_LATCHED_DEPTH = 20  # as in ssp_core.ros
_LATCHED_NAMES = frozenset(
    names.absolute(name)
    for name in (
        names.SESSION_STATE,
        names.TRIGGER_EVENT,
        names.PHASE_EVENT,
        names.SAFETY_EVENT,
        names.FAULT_EVENT,
        names.CAMERA_MOUNT,
        names.CAMERA_RENDERER,
        names.WORLD_PLANT,
        names.TF_STATIC,
    )
)
# As words, and as the numbers that rosbag2 wrote before them.
_BEST_EFFORT = ("best_effort", 2)
_TRANSIENT_LOCAL = ("transient_local", 1)


@dataclass(frozen=True, slots=True)
class PublisherQos:
    """The publisher's offer.

    Deadline, lifespan and liveliness are left at their defaults: a replay that is paused or slowed
    down couldn't keep them.

    Args:
        reliable: lost packets are sent again.
        latched: transient local, the last ``depth`` messages are kept for those who come later.
        depth: messages.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = VOLATILE_DEPTH


def _whole(value: Any) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 1


def offer_of(topic: str, offered_qos: str, msgtype: str = "") -> PublisherQos:
    """Return the offer for a topic.

    Of several recorded publishers the strongest offer is taken, which every subscriber that heard
    one of them takes too, with room for what each of them kept.

    Args:
        topic: absolute name; decides where the bag says nothing of use.
        offered_qos: YAML of the channel, or empty.
        msgtype: static transforms are sent as tf2 sends them, each message with all of them.
    """
    if is_static(topic, msgtype):
        return PublisherQos(latched=True, depth=1)
    try:
        profiles = parse_offered_qos(offered_qos)
    except ValueError:
        profiles = []
    if not profiles:
        latched = topic in _LATCHED_NAMES
        return PublisherQos(latched=latched, depth=_LATCHED_DEPTH if latched else VOLATILE_DEPTH)
    reliable = any(profile.get("reliability") not in _BEST_EFFORT for profile in profiles)
    latched = any(profile.get("durability") in _TRANSIENT_LOCAL for profile in profiles)
    if not latched:
        return PublisherQos(reliable=reliable)
    # Each publisher kept its own.
    depth = min(sum(_whole(profile.get("depth")) for profile in profiles), MOST_LATCHED)
    return PublisherQos(reliable=reliable, latched=True, depth=depth)


DEFAULT_CLOCK_HZ = 100.0
FRAME_TYPES = frozenset(
    (
        "sensor_msgs/msg/CompressedImage",
        "sensor_msgs/msg/Image",
        "foxglove_msgs/msg/CompressedVideo",
    )
)
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+\Z")
_MOST_NAME = 246  # what the middleware takes
# Says why a type can't be published here, with the hash that the bag has for it; None: it can.
Missing = Callable[[str, str], str | None]


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    """The options that a person chose.

    Args:
        topics: names or expressions; empty: all.
        remap: recorded name to the name to publish under.
        commands: topics that may move objects too.
        clock_hz: of a /clock that is made here; 0: none is; None: only where none is recorded.
        rate: bag seconds per second.
        start_s: from the bag's first message.
        end_s: from the bag's first message; None: to the end.
        loop: from the beginning again at the end.
        paused: it begins with a pause.
        wait_for: subscribers of each topic, without which it doesn't begin.
        beside_session: also where a session is under way.
    """

    topics: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    remap: Mapping[str, str] = field(default_factory=dict)
    commands: bool = False
    clock_hz: float | None = None
    rate: float = 1.0
    start_s: float = 0.0
    end_s: float | None = None
    loop: bool = False
    paused: bool = False
    wait_for: int = 0
    beside_session: bool = False
    json: bool = False


@dataclass(frozen=True, slots=True)
class PlannedTopic:
    """One topic that is published."""

    recorded: str
    topic: str
    msgtype: str
    offer: PublisherQos
    count: int


@dataclass(frozen=True, slots=True)
class OmittedTopic:
    """One topic that was wanted, or not unwanted, and isn't published."""

    topic: str
    count: int
    why: str
    is_command: bool = False


@dataclass(frozen=True, slots=True)
class Plan:
    """The topics that are published.

    Args:
        clock_hz: of a /clock that is made here; 0: the recorded one, or none.
        clock_recorded: the bag's own /clock is among the lines.
    """

    lines: tuple[PlannedTopic, ...]
    left_out: tuple[OmittedTopic, ...]
    clock_hz: float
    clock_recorded: bool

    @property
    def frames(self) -> frozenset[str]:
        """Recorded names of topics with camera frames."""
        return frozenset(line.recorded for line in self.lines if line.msgtype in FRAME_TYPES)


def make_plan(recorded: Mapping[str, TopicInfo], wishes: ReplayOptions, missing: Missing) -> Plan:
    """Return the plan for a bag's topics.

    Raises:
        InputError: a wish names nothing in the bag, or nothing is left.
    """
    remap = _remapped(recorded, wishes.remap)
    topic_names = _matching(recorded, wishes.topics, "--topics") if wishes.topics else set(recorded)
    topic_names -= _matching(recorded, wishes.exclude, "--exclude")
    if not topic_names:
        raise InputError(
            "names no topic that is left",
            field="--topics and --exclude",
            remedy="exclude less; `ssp bag info` lists the topics",
        )
    lines, left_out = [], []
    for name in sorted(topic_names):
        info, topic = recorded[name], remap.get(name, name)
        if topic == names.CLOCK and wishes.clock_hz is not None:
            continue
        # A new name could make a command of what was none, whatever its type.
        renamed = topic != name and is_command_name(topic)
        command = is_command(name, info.msgtype) or renamed
        if _DECLARED in (_folder_of(name), _folder_of(topic)):
            left_out.append(OmittedTopic(name, info.count, _OF_THE_RECORDED_SESSION))
        elif command and not wishes.commands:
            left_out.append(OmittedTopic(name, info.count, "may move objects", is_command=True))
        elif (why := _obstacle(topic, info, missing)) is not None:
            left_out.append(OmittedTopic(name, info.count, why))
        else:
            offer = offer_of(name, info.offered_qos, info.msgtype)
            lines.append(PlannedTopic(name, topic, info.msgtype, offer, info.count))
    _check(lines, left_out)
    clock_recorded = any(line.topic == names.CLOCK for line in lines)
    clock_hz = DEFAULT_CLOCK_HZ if wishes.clock_hz is None else wishes.clock_hz
    return Plan(tuple(lines), tuple(left_out), 0.0 if clock_recorded else clock_hz, clock_recorded)


def played(lines: Iterable[PlannedTopic]) -> tuple[str, ...]:
    """Return participants that a replay plays: VUT, positioning, camera, objects, bodies."""
    participants: set[str] = set()
    for line in lines:
        place, _, _ = line.topic.removeprefix(f"{names.NAMESPACE}/").rpartition("/")
        if line.topic == names.absolute(names.CAMERA_IMAGE):
            participants.add(CAMERA)
        elif line.topic == names.absolute(names.state_topic(place)) and "/" not in place:
            is_vut = place == names.VUT_ID
            participants |= {place, POSITIONING if is_vut else body_of(place)}
    return tuple(sorted(participants))


def _folder_of(topic: str) -> str:
    """Return an absolute name's first two words: ``/ssp/declared`` of ``/ssp/declared/vut``."""
    return "/".join(topic.split("/")[:3])


_DECLARED = names.absolute(names.declared_topic("")).rstrip("/")
_OF_THE_RECORDED_SESSION = "says what took part in the recorded session; a replay is `played`"


def _matching(recorded: Mapping[str, TopicInfo], wishes: tuple[str, ...], field: str) -> set[str]:
    """Return topics that are named or, where a wish is no topic's name, whose names hold it."""
    matches: set[str] = set()
    for wish in wishes:
        exact = {name for name in (wish, names.absolute(wish)) if name in recorded}
        if not exact:
            pattern = Pattern(wish, field)
            exact = {name for name in recorded if pattern.occurs_in(name)}
        if not exact:
            some = ", ".join(sorted(recorded)[:6])
            raise InputError(
                "is found in no topic of the bag",
                field=field,
                value=wish,
                remedy=f"it has {some}{', ...' if len(recorded) > 6 else ''}",
            )
        matches |= exact
    return matches


def _remapped(recorded: Mapping[str, TopicInfo], remap: Mapping[str, str]) -> dict[str, str]:
    new_names = {}
    for wish, topic in remap.items():
        name = wish if wish in recorded else names.absolute(wish)
        if name not in recorded:
            raise InputError(
                "is no topic of the bag",
                field="--remap",
                value=wish,
                remedy="`ssp bag info` lists them",
            )
        if not is_name(names.absolute(topic)):
            raise InputError(
                "is no topic name",
                field="--remap",
                value=topic,
                remedy="begin with a letter, and use letters, digits, underscores and slashes",
            )
        new_names[name] = names.absolute(topic)
    return new_names


def is_name(topic: str) -> bool:
    """Tell whether the middleware takes it as the absolute name of a topic."""
    return len(topic) <= _MOST_NAME and _NAME.match(topic) is not None


def _obstacle(topic: str, info: TopicInfo, missing: Missing) -> str | None:
    if not is_name(topic):
        return "is no name of a ROS topic; --remap gives it another"
    if topic == names.CLOCK and info.msgtype != CLOCK_TYPE:
        return f"has the type {info.msgtype}, which is none for /clock"
    return missing(info.msgtype, info.type_hash)


def _check(lines: list[PlannedTopic], left_out: list[OmittedTopic]) -> None:
    kinds: dict[str, str] = {}
    for line in lines:
        if kinds.setdefault(line.topic, line.msgtype) != line.msgtype:
            raise InputError(
                f"gives {line.topic} two types, {kinds[line.topic]} and {line.msgtype}",
                field="--remap",
                remedy="give one of the two another name",
            )
    if not lines:
        raise InputError(
            "leaves nothing to publish: "
            + "; ".join(f"{one.topic} {one.why}" for one in left_out[:5]),
            field="bag",
            remedy="--commands publishes also what may move objects"
            if any(one.is_command for one in left_out)
            else None,
        )
