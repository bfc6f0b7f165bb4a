"""Models as drivers of the VUT in a session of one process."""
