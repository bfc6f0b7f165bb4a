"""Recordings beside a recording that differ from it in one cause, and what they show of a model."""
