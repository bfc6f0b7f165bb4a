"""Readers of a bag: within bounds, by index, from MCAP or SQLite."""
