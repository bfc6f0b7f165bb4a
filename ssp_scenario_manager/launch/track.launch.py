"""Nodes of a live session on this host: ros2 launch ssp_scenario_manager track.launch.py …

Roles say which: ``manager`` and ``monitor`` on one host, ``targets`` where the objects' bodies are
reached from, ``vut_adapter`` where the VUT's GNSS/INS is a topic. The run file is one that
``ssp run --mode live --wait`` wrote, or a compiled one with mode live. docs/deployment.md has the
rest. ``ssp run --mode live`` does the same for one host without ros2 launch.
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from ssp_core import names
from ssp_core.errors import InputError
from ssp_core.run_file.model import load_run

_UNIT = ("forward_m", "left_m", "yaw_left_rad")
# Parameters of vut_adapter: default, and what they are.
_RECEIVER = {
    "odometry": ("odometry", "topic of the GNSS/INS"),
    "navsat": ("", "instead of it: topic of its places"),
    "heading": ("heading", "with navsat: topic of its headings"),
    "velocity": ("", "with navsat: topic of its velocities"),
    "least_fix": ("gbas", "with navsat: fix, sbas or gbas"),
}
ROLES = ("manager", "monitor", "targets", "vut_adapter")
# Where nothing else is said, drivers publish on our own names.
CAMERA_TOPICS = {"camera_image": names.CAMERA_IMAGE, "camera_info": names.CAMERA_INFO}


def _node(
    package: str,
    executable: str,
    parameters: dict[str, object],
    remappings: list[tuple[str, str]],
) -> Node:
    return Node(
        package=package,
        executable=executable,
        namespace="ssp",
        name=executable,
        output="screen",
        parameters=[parameters] if parameters else [],
        remappings=remappings,
    )


def _roles(text: str) -> list[str]:
    roles = [role for role in text.split(",") if role]
    unknown = sorted(set(roles) - set(ROLES))
    if unknown or not roles:
        raise InputError(
            "is no role of a host",
            field="roles",
            value=",".join(unknown) or text,
            remedy=f"give some of {', '.join(ROLES)}, separated by commas",
        )
    return roles


def _session(context: LaunchContext) -> list[Node | LogInfo]:
    def argument(name: str) -> str:
        return str(LaunchConfiguration(name).perform(context))

    run_file, roles = argument("run_file"), _roles(argument("roles"))
    spec = load_run(run_file)
    if spec.mode != "live":
        raise InputError(
            "is no live session's",
            file=run_file,
            field="mode",
            remedy="`ssp run --mode live --wait` writes one; sil.launch.py is for simulated ones",
        )
    remappings = [(ours, argument(name)) for name, ours in CAMERA_TOPICS.items() if argument(name)]
    run = {"run_file": run_file}
    made: dict[str, list[Node | LogInfo]] = {
        "monitor": [
            _node("ssp_monitor", "monitor", {**run, "bag_dir": argument("bag_dir")}, remappings)
        ],
        "targets": [
            _node(
                "ssp_ot_controller",
                "object_target",
                {**run, "object_ids": argument("object_ids"), "bodies": argument("bodies")},
                [],
            )
        ],
        "vut_adapter": [
            _node(
                "ssp_ot_controller",
                "vut_adapter",
                {
                    **run,
                    **{name: argument(name) for name in _RECEIVER},
                    **{f"unit_{k}": float(argument(f"unit_{k}")) for k in _UNIT},
                },
                [],
            )
        ],
        "manager": [_node("ssp_scenario_manager", "scenario_manager", {**run}, remappings)],
    }
    if "manager" in roles:
        goal = f"ros2 action send_goal --feedback {names.absolute(names.RUN_SCENARIO)}"
        token = spec.session_token or "THE ONE THAT THE MANAGER LOGS"
        request = f"{{run_file: '{run_file}', session_token: '{token}'}}"
        goal += f' ssp_msgs/action/RunScenario "{request}"'
        made["manager"] += [
            LogInfo(msg=f"to see what is connected: ssp doctor --session {run_file}"),
            LogInfo(msg=f"to start the run: {goal}"),
        ]
    if "monitor" in roles and not argument("bag_dir"):
        raise InputError("is missing", field="bag_dir", remedy="the monitor records into it")
    return [entity for role in ROLES if role in roles for entity in made[role]]


def generate_launch_description() -> LaunchDescription:
    """Launch the nodes of this host's roles in namespace /ssp."""
    unit = [
        DeclareLaunchArgument(f"unit_{name}", default_value="0.0", description="of the GNSS/INS")
        for name in _UNIT
    ]
    receiver = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in _RECEIVER.items()
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("run_file", description="path of an ssp.run/1 file, mode live"),
            DeclareLaunchArgument(
                "roles", default_value=",".join(ROLES), description="of this host"
            ),
            DeclareLaunchArgument("bag_dir", default_value="", description="new bag directory"),
            DeclareLaunchArgument(
                "bodies", default_value="", description="ot1=udp://HOST:PORT,ot2=…"
            ),
            DeclareLaunchArgument(
                "object_ids", default_value="", description="ot1,ot2; empty: all"
            ),
            *receiver,
            *unit,
            DeclareLaunchArgument(
                "camera_image", default_value="", description="the driver's compressed image"
            ),
            DeclareLaunchArgument(
                "camera_info", default_value="", description="the driver's camera_info"
            ),
            OpaqueFunction(function=_session),
        ]
    )
