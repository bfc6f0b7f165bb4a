"""Labels of slots as answers write them, and what the rules read in them."""

from __future__ import annotations

import re
from collections.abc import Callable

# Where the next word of a name like turnLeft begins.
HUMP = re.compile(r"(?<=[a-z]{2})(?=[A-Z])")
ACTIONS = frozenset({"lon_action", "lat_action"})
SIDES = {"left": ("lat_action",), "right": ("lat_action",)}  # which alone the rules don't read
CLEAR = 0.2  # by which the largest share leads
NAME = r"(?:[^\W\d_]|[^\W\d][\w /-]{0,28}\w)"
QUOTES = r"[\"'*_]{0,2}"
Values = Callable[[str], dict[str, object]]


def words(label: str) -> str:
    """Write a label as words: turn_left and turnLeft are turn left."""
    return HUMP.sub(" ", label).replace("_", " ").lower()
