"""The node by which a campaign asks models over topics."""
