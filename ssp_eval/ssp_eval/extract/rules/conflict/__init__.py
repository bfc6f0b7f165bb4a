"""Whether there is a conflict, and with whom: stated, or what somebody may do."""
