"""The way from a K* to what a simulator or a track runs (METHOD 2)."""
