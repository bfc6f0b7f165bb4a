"""Adapters: from a model's raw answer to a trajectory, for each native interface."""
