"""Calls shared with helper processes: each is done once, in order, and none outlives its block."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from ssp_core.errors import HostError
from ssp_eval.package.helpers import Helpers, results
from tests.support.processes.calls import meet, stay
from tests.support.processes.waiting import until


def test_without_helpers_each_call_is_done_here_and_only_when_its_result_is_asked_for() -> None:
    done: list[int] = []
    with Helpers(0) as helpers:
        calls = [helpers.begin(done.append, number) for number in range(3)]
        assert done == []
        assert results(calls) == [None] * 3
    assert sorted(done) == [0, 1, 2]


def test_this_process_and_a_helper_work_at_the_same_time_and_the_order_is_kept(
    tmp_path: Path,
) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    with Helpers(1) as helpers:
        calls = [
            helpers.begin(meet, one, other),
            helpers.begin(abs, -1),  # waits in the helper's queue
            helpers.begin(meet, other, one),
        ]
        first, second, third = results(calls)
    assert first != os.getpid()
    assert second == 1
    assert third == os.getpid()


def test_a_helper_takes_no_call_before_it_has_done_the_one_that_it_has(tmp_path: Path) -> None:
    one, other = tmp_path / "one", tmp_path / "other"
    with Helpers(1) as helpers:
        held = helpers.begin(meet, one, other)
        further = [helpers.begin(os.getpid) for _ in range(3)]
        until(one.exists)  # the helper has begun the first
        assert results(further) == [os.getpid()] * 3
        other.touch()
        assert held.result() != os.getpid()


def test_a_helper_ends_at_once_when_its_block_is_left_early(tmp_path: Path) -> None:
    began = tmp_path / "began"

    def interrupted() -> None:
        with Helpers(1) as helpers:
            helpers.begin(stay, began)
            until(began.exists)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with pytest.raises(ProcessLookupError):
        os.kill(int(began.read_text()), 0)


def test_a_helper_that_was_killed_is_named(tmp_path: Path) -> None:
    began = tmp_path / "began"
    with Helpers(1) as helpers:
        call = helpers.begin(stay, began)
        until(began.exists)
        os.kill(int(began.read_text()), signal.SIGKILL)
        with pytest.raises(HostError, match="a helper process was killed"):
            call.result()
