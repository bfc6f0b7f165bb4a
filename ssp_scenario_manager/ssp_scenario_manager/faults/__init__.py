"""The fault matrix: every fault at every stage of a run, with the required result."""
