"""The rules: what a text says, as slots with the words that say it (METHOD 5.5 a).

tokens → matching (phrases of the tables in words, and free_phrases) → hits → scope (what is
asserted) → reading (who does what, with actors, motion, conflict and plan) → world → decide.
A stage knows nothing of those behind it; tokens, hits, world and talk are what they hand on.
"""

from ssp_eval.extract.rules.pipeline import extract, extractor_hash

__all__ = ["extract", "extractor_hash"]
