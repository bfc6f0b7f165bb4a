"""Files about a run, as models: the run itself, added faults, the shortlist, the verdict."""
