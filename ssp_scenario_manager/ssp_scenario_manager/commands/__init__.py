"""The services that command a session."""
