"""What the recorder decides, without ROS: topics, queue, encoding, disk, losses and report."""
