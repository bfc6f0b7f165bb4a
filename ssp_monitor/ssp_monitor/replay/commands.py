"""What can make real objects move: topics that replay leaves out, nodes that it doesn't join."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ssp_core import names

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
_COMMAND_PACKAGES = frozenset(
    (
        "ackermann_msgs",
        "autoware_auto_control_msgs",
        "autoware_auto_planning_msgs",
        "autoware_auto_vehicle_msgs",
        "autoware_control_msgs",
        "autoware_planning_msgs",
        "autoware_vehicle_msgs",
        "can_msgs",
        "carla_msgs",
        "control_msgs",
        "mavros_msgs",
        "pacmod_msgs",
        "pacmod3_msgs",
        "px4_msgs",
        "tier4_control_msgs",
        "tier4_planning_msgs",
        "tier4_vehicle_msgs",
        "trajectory_msgs",
    )
)
_DRIVE_BY_WIRE = "dbw"
# In a name, of a topic or of a type: as a word of its own ...
_COMMAND_WORDS = frozenset(
    (
        *("accelerator", "actuation", "actuator", "actuators", "autopilot", "command", "commands"),
        *("commanded", "control", "controls", "ctrl", "demand", "desired", "drive", "emergency"),
        *(
            "engage",
            "engaged",
            "estop",
            "gear",
            "goal",
            "goals",
            "jog",
            "joy",
            "mission",
            "pedal",
            "ref",
        ),
        *("reference", "references", "request", "set", "stop", "target", "targets", "torque"),
        *("twist", "vel", "waypoint", "waypoints"),
    )
)
# ... or anywhere in one, as in "cmdvel" or "handbrake".
_COMMAND_STEMS = (
    *("brake", "braking", "cmd", "joystick", "setpoint", "setspeed", "steer", "teleop"),
    *("throttle", "trajector"),
)
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
    """Whether an object may act on messages of a topic as it was recorded.

    What isn't the project's own is judged by words, so that it is rather left out than sent.

    Args:
        topic: absolute name.
        msgtype: full name.
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
    """Whether any part of a name, of a topic or of a type, sounds like something to act on."""
    words = {word.lower() for word in _WORD.findall(name)}
    return not _COMMAND_WORDS.isdisjoint(words) or any(
        stem in name.lower() for stem in _COMMAND_STEMS
    )


def session_signs(
    nodes: Iterable[tuple[str, str]], services: Iterable[tuple[str, Iterable[str]]]
) -> list[str]:
    """What on the graph belongs to a session that is under way, for people; empty: nothing.

    Services tell of nodes that were given other names.

    Args:
        nodes: name and namespace.
        services: name and types.
    """
    found = {f"node {space.rstrip('/')}/{name}" for name, space in nodes if name in SESSION_NODES}
    found |= {
        f"service {name}" for name, types in services if not SESSION_SERVICES.isdisjoint(types)
    }
    return sorted(found)
