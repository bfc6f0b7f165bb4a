"""Conversion of third-party recordings into bags that can be audited and evaluated."""
