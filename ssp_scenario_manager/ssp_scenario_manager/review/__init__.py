"""The way from a candidate to a K* (METHOD 1): a person decides each safety-critical field."""
