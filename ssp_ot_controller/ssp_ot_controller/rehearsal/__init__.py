"""Rehearsal of a live session: plays the hardware that it would meet."""
