"""Adapters and bridges from VLA services to topics."""
