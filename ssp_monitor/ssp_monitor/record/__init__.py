"""A recording without a session."""
