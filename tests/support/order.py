"""In which order several workers take the files of tests."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Those that take longest come first, or one of them would be left alone at the end.
LONGEST = ("tests/system/live/", "tests/system/test_demo.py", "tests/system/", "ssp_", "tests/")
# So many of all files that compute are left for the end, where no worker then waits alone.
LEFT = 1 / 6


def waits(item: pytest.Item) -> bool:
    """Tell whether a test starts nodes, sessions or a browser, for which it mostly waits."""
    return any(item.get_closest_marker(name) for name in ("ros", "system", "programs"))


def spread(items: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Order tests so that workers who take file after file have both kinds at any time.

    Args:
        items: tests, in the order of their files.
    """
    files = [list(group) for _, group in groupby(items, key=lambda item: item.path)]
    waiting = sorted((file for file in files if any(map(waits, file))), key=_rank)
    working = [file for file in files if not any(map(waits, file))]
    among = len(working) - int(LEFT * len(working)) if waiting else 0
    ordered: list[pytest.Item] = []
    for number, file in enumerate(waiting):
        few = slice(*(among * n // len(waiting) for n in (number, number + 1)))
        ordered += [item for one in (file, *working[few]) for item in one]
    return ordered + [item for file in working[among:] for item in file]


def _rank(file: Sequence[pytest.Item]) -> int:
    name = file[0].path.relative_to(ROOT).as_posix()
    return next(rank for rank, start in enumerate(LONGEST) if name.startswith(start))
