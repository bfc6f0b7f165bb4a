"""Road blocks from sites and maps (METHOD 2.1)."""
