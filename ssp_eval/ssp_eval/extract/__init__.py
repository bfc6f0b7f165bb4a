"""Text to slots with evidence (METHOD 5.5): rules first, an LLM for what they left empty.

The rules (engine, over lexicon.yaml and scope.yaml) and llm are held to the same checks; measure
and review say how well they do.
"""

from ssp_eval.extract.engine import extract, extractor_hash

__all__ = ["extract", "extractor_hash"]
