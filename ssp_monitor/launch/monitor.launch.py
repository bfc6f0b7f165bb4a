"""Starts the recorder: ros2 launch ssp_monitor monitor.launch.py run_file:=… bag_dir:=…"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Launch one node, with its parameters from config/ and the two that belong to the run."""
    config = PathJoinSubstitution([FindPackageShare("ssp_monitor"), "config", "monitor.param.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("run_file", description="path of an ssp.run/1 file"),
            DeclareLaunchArgument("bag_dir", description="bag directory to make"),
            Node(
                package="ssp_monitor",
                executable="monitor",
                namespace="ssp",
                name="monitor",
                output="screen",
                parameters=[
                    config,
                    {
                        "run_file": LaunchConfiguration("run_file"),
                        "bag_dir": LaunchConfiguration("bag_dir"),
                    },
                ],
            ),
        ]
    )
