"""Nodes, subscriptions, conversions and parameters: all of this package that knows ROS."""
