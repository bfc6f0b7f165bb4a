"""Bags: MCAP recordings that rosbag2, Foxglove and rosbags read, written and read without ROS."""
