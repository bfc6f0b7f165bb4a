"""The observations of a recording by named persons (METHOD 4.3): asking, storing and combining."""
