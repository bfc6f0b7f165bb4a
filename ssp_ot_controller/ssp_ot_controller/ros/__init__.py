"""What talks to ROS: nodes, their parameters, and conversions of messages."""
