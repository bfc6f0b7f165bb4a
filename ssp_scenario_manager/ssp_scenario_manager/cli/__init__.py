"""The commands that this package gives to ``ssp``."""
