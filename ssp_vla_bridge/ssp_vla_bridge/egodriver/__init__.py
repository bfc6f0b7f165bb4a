"""AlpaSim's EgodriverService: our client for its policies, and our bridges behind a server."""
