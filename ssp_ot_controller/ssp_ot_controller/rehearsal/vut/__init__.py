"""The played VUT."""
