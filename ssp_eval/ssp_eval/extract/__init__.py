"""Text to slots with evidence (METHOD 5.5), stage by stage.

text → tokens → match (phrases of the vocabulary, and free rules) → scope (what is
asserted) → reader (who does what: actors, motions, plan → world) → decide → checks.
"""

from ssp_eval.extract.rules import extract, extractor_hash

__all__ = ["extract", "extractor_hash"]
