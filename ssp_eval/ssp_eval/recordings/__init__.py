"""Recordings as they are qualified and scored: states, geometry, event, clip (METHOD 4)."""
