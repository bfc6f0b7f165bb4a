"""In which order several workers take the tests."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Those that take longest come first, or one of them would be left alone at the end.
LONGEST = ("tests/system/test_demo.py", "tests/system/live/", "tests/system/", "ssp_", "tests/")
Files = Sequence[Sequence[pytest.Item]]


def starts_processes(item: pytest.Item) -> bool:
    """Tell whether a test starts nodes, sessions or a browser, for which it mostly waits."""
    return any(item.get_closest_marker(name) for name in ("ros", "system", "programs"))


def spread(items: Sequence[pytest.Item], workers: int) -> list[pytest.Item]:
    """Order tests so that each worker always has both kinds: those that wait, and those that work.

    Each worker begins with a share of about the same number of tests, one behind the other. What a
    file holds stays together, since its tests share what they set up.

    Args:
        items: tests, in the order of their files.
        workers: how many processes share them.
    """
    files = [list(group) for _, group in groupby(items, key=lambda item: item.path)]
    waiting = [file for file in files if any(map(starts_processes, file))]
    working = iter([file for file in files if not any(map(starts_processes, file))])
    waiting.sort(key=_rank)
    ordered: list[pytest.Item] = []
    for number in range(workers):
        share = waiting[number::workers]
        wanted = len(items) * (number + 1) // workers - len(ordered) - sum(map(len, share))
        ordered += _mixed(share, _taken(working, wanted, last=number == workers - 1))
    return ordered


def _rank(file: Sequence[pytest.Item]) -> int:
    name = file[0].path.relative_to(ROOT).as_posix()
    return next(rank for rank, start in enumerate(LONGEST) if name.startswith(start))


def _taken(files: Iterator[Sequence[pytest.Item]], wanted: int, *, last: bool) -> Files:
    """Take files of about so many tests; the last share is what is left."""
    taken: list[Sequence[pytest.Item]] = []
    while (last or wanted > 0) and (file := next(files, None)):
        taken.append(file)
        wanted -= len(file)
    return taken


def _mixed(waiting: Files, working: Files) -> Iterator[pytest.Item]:
    """One file that waits, then the next few that work."""
    for number, file in enumerate(waiting):
        yield from file
        few = slice(*(len(working) * n // len(waiting) for n in (number, number + 1)))
        for other in working[few]:
            yield from other
    if not waiting:
        for other in working:
            yield from other
