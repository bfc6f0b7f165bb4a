"""Road blocks from sites and maps, and the retrieval among them (METHOD 2.1, 2.2)."""
