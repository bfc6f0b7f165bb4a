"""A learned reader for slots that the rules left empty (METHOD 5.5), which abstains when unsure.

clauses (what can be seen in a text) → weights (how much each speaks for a label) → reader (which
slots are filled or taken back, and by which words). It says nothing that its checks can't find in
the text, and they are those for an LLM.
"""
