"""Starts the operators' page: ros2 launch ssp_monitor page.launch.py [run_file:=…] [port:=8080]"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Launch one node, with the parameters that belong to the session."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "run_file", default_value="", description="path of an ssp.run/1 file"
            ),
            DeclareLaunchArgument(
                "host", default_value="127.0.0.1", description="address to listen on"
            ),
            DeclareLaunchArgument("port", default_value="8080", description="0: any free one"),
            Node(
                package="ssp_monitor",
                executable="page",
                namespace="ssp",
                name="monitor_page",
                output="screen",
                parameters=[
                    {
                        "run_file": LaunchConfiguration("run_file"),
                        "host": LaunchConfiguration("host"),
                        "port": ParameterValue(LaunchConfiguration("port"), value_type=int),
                    },
                ],
            ),
        ]
    )
