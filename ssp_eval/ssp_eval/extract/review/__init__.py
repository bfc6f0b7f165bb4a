"""A blind review of what was extracted: a subset for two people, and what came back from them."""
