"""Measurements of an event in states, pictures and observations of recordings, and the reasons."""
