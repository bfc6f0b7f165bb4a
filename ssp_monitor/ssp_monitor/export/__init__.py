"""Exports a bag as pictures, videos and tables."""
