"""Publishes a bag again: which topics, as what, and when; without ROS."""
