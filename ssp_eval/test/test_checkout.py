"""Which tests ``ssp test`` runs, and in which order its workers take them."""

from __future__ import annotations

import os
from itertools import groupby
from types import SimpleNamespace
from typing import Any

import pytest

from ssp_eval.checkout import _checks
from tests.support.order import ROOT, spread

# Tests of each file, and their marker.
FILES = {
    "ssp_msgs/test/test_a.py": (40, None),
    "ssp_msgs/test/test_node.py": (3, "ros"),
    "ssp_eval/test/test_b.py": (30, None),
    "ssp_eval/test/test_c.py": (1, None),
    "ssp_eval/test/test_d.py": (25, None),
    "tests/system/test_page.py": (2, "system"),
    "tests/system/live/test_live.py": (4, "system"),
    "tests/test_e.py": (10, None),
}


def made(name: str, marker: str | None) -> Any:
    return SimpleNamespace(path=ROOT / name, get_closest_marker=lambda asked: asked == marker)


@pytest.mark.parametrize("workers", [1, 2, 3, 5, 20])
def test_each_worker_gets_tests_that_wait_among_tests_that_work(workers: int) -> None:
    items = [made(name, marker) for name, (n, marker) in FILES.items() for _ in range(n)]
    ordered = spread(items, workers)
    assert sorted(map(id, ordered)) == sorted(map(id, items))
    files = [path.relative_to(ROOT).as_posix() for path, _ in groupby(i.path for i in ordered)]
    assert sorted(files) == sorted(FILES), "a file's tests stay together"
    waiting = [name for name in files if FILES[name][1]]
    if workers == 1:
        assert files[0] == "tests/system/live/test_live.py", "those that take longest come first"
        assert waiting[1] == "tests/system/test_page.py"
        assert all(FILES[name][1] is None for name in (files[1], files[-1]))
    if workers == 3:
        share = len(items) / workers
        begins = [ordered[round(number * share)].path.name for number in range(3)]
        assert begins[0] == "test_live.py"
        assert [waiting[1], waiting[2]] == [
            "tests/system/test_page.py",
            "ssp_msgs/test/test_node.py",
        ]


def test_one_more_than_there_are_processors_runs_all_of_them() -> None:
    (*_, (name, command)) = _checks((), False, False)
    assert name == "tests"
    assert command[-2:] == ["-n", str((os.cpu_count() or 1) + 1)]
    assert "-m" not in command[3:]
    (*_, (_, quick)) = _checks((), True, False)
    assert quick[quick.index("-m", 3) + 1] == "not system and not programs"
