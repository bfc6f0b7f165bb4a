"""Object targets: references, tracking and local safety; the SIL world and its camera."""
