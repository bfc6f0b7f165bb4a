"""A constrained LLM for slots that are still empty (METHOD 5.5 b), held to the same checks.

prompt (what is asked) → cache, or the server → reply (what was proposed) → judge (what of it the
text supports, by what holds for any evidence).
"""
