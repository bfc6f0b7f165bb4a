"""What the recorder decides, without ROS."""
