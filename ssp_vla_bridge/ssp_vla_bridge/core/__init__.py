"""What the VLA bridges know without ROS: requests, responses, adapters, trajectories."""
