"""The conventions of labels, as far as tests that go through all combinations need them."""

from __future__ import annotations


def contradicts(critical: str, motion: str | None) -> bool:
    """Tell whether a label goes against them: people who come into our lane cross."""
    return critical == "pedestrian" and (motion or "").startswith("cutting")
