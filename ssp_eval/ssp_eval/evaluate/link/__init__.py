"""The evaluator's end of the topics."""
