"""Stage 5c: what the ego commits itself to."""
