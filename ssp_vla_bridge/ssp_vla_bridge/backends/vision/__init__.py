"""Classical computer vision of the baseline: from frames to road users, without weights."""
