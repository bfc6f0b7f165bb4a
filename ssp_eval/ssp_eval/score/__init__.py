"""Scoring of behaviour records against labels (METHOD 6), without ROS and images."""
