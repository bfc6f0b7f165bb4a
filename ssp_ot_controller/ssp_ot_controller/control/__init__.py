"""Tracking of references by an object, and the room that it needs to stop."""
