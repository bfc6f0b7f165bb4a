"""Starts the markers and /diagnostics: ros2 launch ssp_monitor view.launch.py run_file:=…"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Launch the node, and RViz if requested."""
    rviz_config = PathJoinSubstitution([FindPackageShare("ssp_monitor"), "config", "ssp.rviz"])
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "run_file", default_value="", description="path of an ssp.run/1 file, or empty"
            ),
            DeclareLaunchArgument("rviz", default_value="false", description="start RViz too"),
            Node(
                package="ssp_monitor",
                executable="view",
                namespace="ssp",
                name="view",
                output="screen",
                parameters=[{"run_file": LaunchConfiguration("run_file")}],
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", rviz_config],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
