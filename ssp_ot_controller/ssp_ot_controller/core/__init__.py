"""Decisions of object targets and their world, as pure functions without ROS."""
