"""The ROS side: nodes, their parameters, and conversions of messages."""
