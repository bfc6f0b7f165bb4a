"""From K* to what a simulator or a track runs (METHOD 2)."""
