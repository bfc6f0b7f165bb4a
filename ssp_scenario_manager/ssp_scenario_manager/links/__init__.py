"""The manager's links to the object targets of a run."""
