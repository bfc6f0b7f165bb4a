"""What every recording is made of, with a session or without."""
