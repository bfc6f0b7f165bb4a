"""The renderer: from a scene and the weather to the picture of a frame."""
