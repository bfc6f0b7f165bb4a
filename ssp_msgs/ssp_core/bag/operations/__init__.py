"""Checks, cuts and repairs of whole bags."""
