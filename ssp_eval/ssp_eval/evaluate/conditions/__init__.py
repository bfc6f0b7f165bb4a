"""The conditions that a model is asked under: other pictures, twins, and their order."""
