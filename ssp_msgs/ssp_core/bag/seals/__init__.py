"""Seals of a bag, its verdict, and words that are added to it."""
