"""Stage 5: goes through the hits of a text and binds who does what."""
