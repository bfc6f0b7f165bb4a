"""Phrases that are too free to list: each module finds one kind, from its first word on."""
