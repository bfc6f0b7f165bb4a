"""Proposes labels from the states of a recording: what is true at given times (METHOD 5.1)."""
