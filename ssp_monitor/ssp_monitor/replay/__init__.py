"""Publishes a recorded bag again, each message as it was recorded and when it was recorded."""
