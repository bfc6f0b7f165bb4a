"""Runs of one session, over DDS or in one process; their faults, results and reports."""
