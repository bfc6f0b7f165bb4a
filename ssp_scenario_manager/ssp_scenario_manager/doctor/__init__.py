"""Says what is installed on this host, what is missing, and what is connected to a session."""
