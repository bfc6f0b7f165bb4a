"""One driven run, in one process or several, and its picture."""
