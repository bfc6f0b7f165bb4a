"""The small library that every SSP package shares; it imports without ROS."""

__version__ = "0.1.0"
