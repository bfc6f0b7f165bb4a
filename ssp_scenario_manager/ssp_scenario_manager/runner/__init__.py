"""Runs one session: starts the node processes, has the run done, and ends every process."""
