"""The HTML report of a campaign: one self-contained file."""
