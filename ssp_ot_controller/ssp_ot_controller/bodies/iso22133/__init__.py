"""ISO 22133, wire version 2: messages, framing, units and states, without input or output."""
