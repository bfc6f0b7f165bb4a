"""Listening to a session from outside."""
