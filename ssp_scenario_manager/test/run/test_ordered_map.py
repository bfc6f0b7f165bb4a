"""The map over a Ray cluster on which others have work, too."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from ssp_scenario_manager.run import ordered_map


def test_a_cluster_without_room_is_told_and_one_worker_is_enough(
    capsys: pytest.CaptureFixture[str],
) -> None:
    answers = iter([[], [], ["second"]])
    waits = []

    def wait(asked: list[str], num_returns: int, timeout: float) -> tuple[list[str], list[str]]:
        waits.append((num_returns, timeout))
        ready = next(answers)
        return ready, [one for one in asked if one not in ready]

    assert ordered_map._ready_answers(SimpleNamespace(wait=wait), ["first", "second"]) == ["second"]
    assert waits == [(2, 30.0), (1, 30.0), (1, 30.0)]
    assert capsys.readouterr().err.count("has no free processor for a worker yet") == 2
