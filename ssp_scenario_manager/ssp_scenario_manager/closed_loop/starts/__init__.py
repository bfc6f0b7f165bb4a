"""Starts and their twins, drawn by seed (METHOD 8.1)."""
