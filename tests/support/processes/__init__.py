"""Processes that tests start, wait for and end."""
