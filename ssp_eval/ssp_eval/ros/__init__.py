"""The node ``evaluator`` and its parameters."""
