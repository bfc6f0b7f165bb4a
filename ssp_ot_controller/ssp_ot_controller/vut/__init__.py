"""The vehicle under test of a physical session: what its GNSS/INS says, as the session's state."""
