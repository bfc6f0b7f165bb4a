"""Recorder, live status and bag tools of SSP."""
