"""Synthetic clips, one module per scenario: closed formulas of time, no dynamics, no control."""
