"""Event specification, triggers, session and supervisor of SSP."""
