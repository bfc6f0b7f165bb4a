"""The verbs of ``ssp bag``."""
