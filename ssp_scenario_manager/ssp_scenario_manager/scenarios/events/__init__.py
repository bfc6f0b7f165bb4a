"""The kinds of events: what each asks for on a block, and how it goes on there."""
