"""What can make real objects move: topics that replay leaves out, nodes that it doesn't join."""

from __future__ import annotations

from collections.abc import Iterable

from ssp_core import names

# Whoever hears one of these may act on it. Also types that other stacks command vehicles with.
COMMAND_TYPES = frozenset(
    (
        "ssp_msgs/msg/Reference",
        "ssp_msgs/msg/ActuatorCommand",
        "ssp_msgs/msg/ActuatorCommands",
        "ssp_msgs/msg/Heartbeat",  # objects stop when it stays away
        "ssp_msgs/msg/WorldTick",  # participants in lockstep step on it
        "ssp_msgs/msg/StepDone",
        "ackermann_msgs/msg/AckermannDrive",
        "ackermann_msgs/msg/AckermannDriveStamped",
        "trajectory_msgs/msg/JointTrajectory",
        "control_msgs/msg/JointJog",
    )
)
_COMMAND_PACKAGES = ("autoware_control_msgs", "autoware_auto_control_msgs", "mavros_msgs")
# In the last part of a topic's name, whatever its type.
_COMMAND_WORDS = frozenset(
    ("cmd", "command", "commands", "setpoint", "reference", "control", "teleop", "goal", "joy")
)

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
    """Whether an object may act on messages of this topic.

    Args:
        topic: absolute name.
        msgtype: full name.
    """
    package = msgtype.split("/")[0]
    if msgtype in COMMAND_TYPES or package in _COMMAND_PACKAGES:
        return True
    if package == "ssp_msgs":  # an acknowledgement of a reference is none, whatever it is called
        return False
    return not _COMMAND_WORDS.isdisjoint(topic.rsplit("/", 1)[-1].lower().split("_"))


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
