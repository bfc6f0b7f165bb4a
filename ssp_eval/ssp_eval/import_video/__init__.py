"""Makes a bag of a source video, so that it is evaluated like any recording."""
