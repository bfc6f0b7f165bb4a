"""``ssp audit observe``: a person looks at a recording and says what can be seen (METHOD 4.3)."""
