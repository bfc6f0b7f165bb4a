"""A finished recording drawn anew by CARLA: the same states, other pictures."""
