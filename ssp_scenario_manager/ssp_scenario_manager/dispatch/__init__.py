"""References that a session dispatches, and their adaptation to a VUT of another speed."""
