"""The order in which several workers take the files of tests."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Those that take longest come first, or one of them would be left alone at the end.
LONGEST = ("tests/system/test_demo.py", "tests/system/", "ssp_", "tests/")
# Sessions on the wall's clock, whose limits on silence are short: few of them run at one time.
LIVE = "tests/system/live/"
# So many of the files that wait lie between two of live sessions, at most.
APART = 5
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
    waiting = _apart(sorted((file for file in files if any(map(waits, file))), key=_rank))
    working = sorted((file for file in files if not any(map(waits, file))), key=_rank)
    among = len(working) - int(LEFT * len(working)) if waiting else 0
    ordered: list[pytest.Item] = []
    for number, file in enumerate(waiting):
        few = slice(*(among * n // len(waiting) for n in (number, number + 1)))
        ordered += [item for one in (file, *working[few]) for item in one]
    return ordered + [item for file in working[among:] for item in file]


def _apart(files: Sequence[list[pytest.Item]]) -> list[list[pytest.Item]]:
    live = [file for file in files if _name(file).startswith(LIVE)]
    others = [file for file in files if not _name(file).startswith(LIVE)]
    between = min(APART, len(others) // len(live)) if live else 0
    ordered: list[list[pytest.Item]] = []
    for number, file in enumerate(live):
        ordered += [file, *others[between * number : between * (number + 1)]]
    return ordered + others[between * len(live) :]


def _rank(file: Sequence[pytest.Item]) -> int:
    return next(rank for rank, start in enumerate(LONGEST) if _name(file).startswith(start))


def _name(file: Sequence[pytest.Item]) -> str:
    return file[0].path.relative_to(ROOT).as_posix()
