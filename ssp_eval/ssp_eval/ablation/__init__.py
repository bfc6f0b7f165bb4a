"""Ablation of the transfer: one event realised with and without its structure (METHOD 1 to 4)."""
