"""Decisions of the scenario manager: pure, without ROS, without a clock."""
