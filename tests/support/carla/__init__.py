"""A counterpart of a CARLA server, and what tests do with it."""
