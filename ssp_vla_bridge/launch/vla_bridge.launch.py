"""One bridge: ``ros2 launch ssp_vla_bridge vla_bridge.launch.py model:=opencv_baseline``."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

DEFAULTS = PathJoinSubstitution(
    [FindPackageShare("ssp_vla_bridge"), "config", "vla_bridge.param.yaml"]
)


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("model", description="name on the topics"),
            DeclareLaunchArgument("backend", default_value="", description="empty: as model"),
            DeclareLaunchArgument("backend_options", default_value="", description="JSON"),
            DeclareLaunchArgument(
                "shadow_hz", default_value="0.0", description="follow a running session, Hz"
            ),
            Node(
                package="ssp_vla_bridge",
                executable="vla_bridge",
                name=["vla_bridge_", LaunchConfiguration("model")],
                namespace="ssp",
                output="screen",
                parameters=[
                    DEFAULTS,
                    {
                        name: ParameterValue(LaunchConfiguration(name), value_type=str)
                        for name in ("model", "backend", "backend_options")
                    },
                    {
                        "shadow_hz": ParameterValue(
                            LaunchConfiguration("shadow_hz"), value_type=float
                        )
                    },
                ],
            ),
        ]
    )
