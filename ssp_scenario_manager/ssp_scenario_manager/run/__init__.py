"""Runs one session: over DDS with processes of its own, or in one process; its faults, result and
report.
"""
