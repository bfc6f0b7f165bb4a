"""Recordings as they are qualified and scored: origin, states, phases and crop (METHOD 4)."""
