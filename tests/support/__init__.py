"""Builders and counterparts that the tests of all packages share; imported as ``tests.support``."""
