"""The bag's directory is removed, or replaced, while it is being recorded."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.support.processes.waiting import until

from .conftest import Field
from .load import LoadTopic

pytestmark = [pytest.mark.ros, pytest.mark.system]
TOPIC = LoadTopic("/load/frame", rate_hz=50, size_bytes=10_000)


def remove(bag: Path) -> None:
    # A file that the recorder begins meanwhile keeps the directory.
    while bag.exists():
        shutil.rmtree(bag, ignore_errors=True)


def replace(bag: Path) -> None:
    bag.rename(bag.with_name("elsewhere"))
    shutil.copytree(bag.with_name("elsewhere"), bag)


@pytest.mark.parametrize(("strike", "split"), [(remove, "0"), (replace, "0.2")])
def test_a_recording_whose_bag_is_gone_ends_and_says_so(
    field_: Field, strike: object, split: str
) -> None:
    assert callable(strike)
    load = field_.load(TOPIC)
    recording = field_.record(TOPIC.name, "--split-mb", split, "--json")
    until(lambda: recording.size() > 300_000, "data")
    strike(recording.bag)
    assert recording.wait() == 1
    load.stop()
    result = json.loads(recording.out)
    assert "writing failed" in result["ended"] or "can't be opened" in result["ended"]
    assert recording.bag.name in result["ended"]
    assert not result["ok"]
    if strike is remove:
        assert not recording.bag.exists()


def test_a_part_that_is_gone_at_the_end_fails_the_check(field_: Field) -> None:
    load = field_.load(TOPIC)
    recording = field_.record(TOPIC.name, "--split-mb", "0.2", "--json")
    until(lambda: recording.size() > 600_000, "several files")
    (recording.bag / "bag_0.mcap").unlink()
    load.stop()
    assert recording.stop() == 1
    result = json.loads(recording.out)
    assert any("bag_0.mcap" in problem for problem in result["problems"]), result
