"""Recordings: made, sealed, changed and damaged."""
