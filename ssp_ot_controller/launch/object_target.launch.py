"""Object targets alone: ros2 launch ssp_ot_controller object_target.launch.py run_file:=…"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

DEFAULTS = PathJoinSubstitution(
    [FindPackageShare("ssp_ot_controller"), "config", "object_target.param.yaml"]
)


def generate_launch_description() -> LaunchDescription:
    """Launch one process for the named objects, or for all of the run's if none is named."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("run_file", description="path of an ssp.run/1 file"),
            DeclareLaunchArgument(
                "object_ids", default_value="", description="ot1,ot2; empty: all"
            ),
            DeclareLaunchArgument(
                "autostart", default_value="true", description="false: wait for lifecycle commands"
            ),
            Node(
                package="ssp_ot_controller",
                executable="object_target",
                namespace="ssp",
                name="object_target",
                output="screen",
                parameters=[
                    DEFAULTS,
                    {
                        "run_file": ParameterValue(LaunchConfiguration("run_file"), value_type=str),
                        "object_ids": ParameterValue(
                            LaunchConfiguration("object_ids"), value_type=str
                        ),
                        "autostart": ParameterValue(
                            LaunchConfiguration("autostart"), value_type=bool
                        ),
                    },
                ],
            ),
        ]
    )
