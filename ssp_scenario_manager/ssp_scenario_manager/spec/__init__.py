"""The event specification K* (METHOD 1): model, checks, graph, versions, extraction, review."""
