"""The evaluator's nodes and parameters: the only part of this package that knows ROS."""
