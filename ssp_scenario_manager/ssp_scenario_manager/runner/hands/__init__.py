"""The runner's hands and eyes in a session with injected faults."""
