"""What talks to ROS: the bridge node, its parameters, and conversions of messages."""
