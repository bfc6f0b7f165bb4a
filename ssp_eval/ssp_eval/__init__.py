"""Replay, extraction, metrics and reports of SSP."""
