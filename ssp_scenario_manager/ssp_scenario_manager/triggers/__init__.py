"""The firing of triggers: conditions, their evaluation, and refusals at load."""
