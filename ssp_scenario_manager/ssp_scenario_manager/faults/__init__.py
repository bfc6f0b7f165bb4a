"""The fault matrix: every fault at every stage of a run, with what must come of it."""
