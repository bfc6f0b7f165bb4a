"""The session for other tools: markers for RViz and Foxglove, and /diagnostics."""
