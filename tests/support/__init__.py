"""Builders that the tests of all packages share; imported as ``support``."""
