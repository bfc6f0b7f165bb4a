"""Says what is installed on this host, what is missing, and whether two processes can talk."""
