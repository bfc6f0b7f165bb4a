"""The world of a run: road, scenery, camera and frames, and the interfaces to its simulation."""
