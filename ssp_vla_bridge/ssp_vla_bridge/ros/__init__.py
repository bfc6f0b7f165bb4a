"""The ROS side: the bridge node, its parameters, and conversions of messages."""
