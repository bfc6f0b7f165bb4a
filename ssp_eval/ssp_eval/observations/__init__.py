"""What named persons saw in a recording (METHOD 4.3): asking, storing and combining it."""
