"""The starts of a campaign: drawn by seed, counted by kind, and sealed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from ssp_core.errors import HostError, InputError
from ssp_scenario_manager.cli.loop import loop
from ssp_scenario_manager.closed_loop.campaigns import seal
from ssp_scenario_manager.closed_loop.campaigns.plan_file import (
    LoopPlan,
)
from ssp_scenario_manager.closed_loop.campaigns.seal import draw_starts
from tests.support.bags.full_disk import largest_file
from tests.support.runs import START_FACTS

PLAN = {
    "schema": "ssp.loop/1",
    "events": ["cut_in"],
    "latencies": ["zero", "fixed:1"],
    "starts": 1,
    "others": 0,
}


def plan_of(**changes: Any) -> LoopPlan:
    return LoopPlan.model_validate({**PLAN, **changes})


def test_a_full_disk_keeps_nothing_of_a_campaign_without_starts(tmp_path: Path) -> None:
    plan, out = tmp_path / "plan.yaml", tmp_path / "loop"
    plan.write_text(yaml.safe_dump(PLAN))
    with largest_file(10_000):
        failed = CliRunner().invoke(loop, [str(plan), "--out", str(out)])
    assert isinstance(failed.exception, HostError)
    assert "tasks/0/task/event.yaml: can't be written: File too large" in str(failed.exception)
    assert [entry.name for entry in tmp_path.iterdir()] == ["plan.yaml"]


def test_seeds_are_tried_in_order_however_many_processes_share_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each third seed is critical here; both ways must find the same ones."""
    drawn: dict[int, list[int]] = {}

    def judge(*arguments: Any) -> tuple[str, dict[str, Any]]:
        seed = arguments[-1]
        return ("critical" if seed % 3 == 0 else "off_spec"), {"seed": seed}

    @contextmanager
    def in_order(_jobs: int, *_: object) -> Iterator[Any]:
        yield map

    monkeypatch.setattr(seal, "_draw_facts", judge)
    monkeypatch.setattr(seal, "ordered_map", in_order)
    for jobs in (1, 2, 5):
        (tmp_path / str(jobs)).mkdir()
        found = draw_starts(plan_of(starts=4), tmp_path / str(jobs), jobs, lambda _: None)
        drawn[jobs] = [one["seed"] for one in found]
    assert all(seeds == [3, 6, 9, 12] for seeds in drawn.values()), drawn


def test_each_call_tells_what_was_drawn_and_the_seal_binds_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kinds = (
        *("off_spec", "harmless", "harmless", "critical"),
        *("unavoidable", "short_run_up", "short_run_up", "critical"),
    )

    def judge(*arguments: Any) -> tuple[str, dict[str, Any]]:
        seed = arguments[-1]
        return kinds[seed - 1], {**START_FACTS, "seed": seed, "hash": f"s{seed}", "run": {}}

    @contextmanager
    def in_order(*_: object) -> Iterator[Any]:
        yield map

    monkeypatch.setattr(seal, "_draw_facts", judge)
    monkeypatch.setattr(seal, "ordered_map", in_order)
    said: list[list[str]] = [[], []]
    for told in said:
        draw_starts(plan_of(starts=2), tmp_path, 1, told.append)
    shares = (
        "2 critical (25 %), 2 harmless (25 %), 1 unavoidable (12 %), 1 off_spec (12 %), "
        "2 short_run_up (25 %)"
    )
    assert said[0] == [
        f"starts of cut_in: {shares}, of 8 drawn by seed from 1 on",
        "cut_in is driven without traffic and adaptation, which no driven session has",
    ]
    assert said[1] == said[0]
    text = (tmp_path / "starts.json").read_text()
    assert '"off_spec": 1' in text
    (tmp_path / "starts.json").write_text(text.replace('"off_spec": 1', '"off_spec": 0'))
    with pytest.raises(InputError, match="was changed after it was sealed"):
        draw_starts(plan_of(starts=2), tmp_path, 1, lambda _: None)
