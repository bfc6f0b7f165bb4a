"""Text to slots with evidence (METHOD 5.5): rules first, an LLM for what they left empty.

rules (5.5 a) and llm (5.5 b) are held to the same checks (5.5 c); measure and review say how well
they do.
"""

from ssp_eval.extract.rules import extract, extractor_hash

__all__ = ["extract", "extractor_hash"]
