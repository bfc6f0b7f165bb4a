"""Text to slots with evidence (METHOD 5.5): rules first, then a learned reader, then an LLM.

The rules are engine, over lexicon.yaml and scope.yaml; reader and llm fill what is left empty and
are held to the same checks; combined joins the three; measure and review say how well they do.
"""

from ssp_eval.extract.engine import extract, extractor_hash

__all__ = ["extract", "extractor_hash"]
