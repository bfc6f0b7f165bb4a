"""Shadow mode: a bridge that follows a running session and is asked about what it sees."""
