"""The kinds of interaction: cut-in, lead braking, crossings; their plans on a block, predicted."""
