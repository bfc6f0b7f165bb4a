"""What the manager publishes."""
