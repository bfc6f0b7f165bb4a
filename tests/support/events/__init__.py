"""Events, their faults, and the roads that they take place on."""
