"""Rules, learned reader and LLM as one extractor, and its options on the command line."""
