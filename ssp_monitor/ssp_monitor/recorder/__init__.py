"""The recorder's decisions, without ROS: topics, queue, encoding, disk, losses and report."""
