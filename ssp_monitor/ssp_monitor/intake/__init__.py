"""Reception of what is recorded."""
