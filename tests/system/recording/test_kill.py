"""SIGKILL at any moment costs at most one second, and leaves no gap before it."""

from __future__ import annotations

import random
import re
import time
from pathlib import Path

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.errors import InputError

from .checks import held, kept_until_ns, missing
from .conftest import DEADLINE_S, Field, Recording
from .load import LoadTopic, payload

pytestmark = [pytest.mark.ros, pytest.mark.system]

TOPICS = (
    LoadTopic("/load/state", rate_hz=200, size_bytes=200),
    LoadTopic("/load/frame", rate_hz=30, size_bytes=60_000),
    LoadTopic("/load/rare", rate_hz=3, size_bytes=100),
    LoadTopic("/load/map", rate_hz=0, size_bytes=5_000, latched=True),
)
NAMES = [topic.name for topic in TOPICS]
# Of a message: its number, and a word that belongs to its topic.
_HEAD = re.compile(rb"\d{10} [0-9a-f]{64} ")
AT_ONCE = 4
SEED = 0
# Of each four: without splitting, by size, by time, and in the first moments of a recording.
SPLITS = (("--split-mb", "0"), ("--split-mb", "1"), ("--split-s", "0.5"), ("--split-mb", "0"))


def _after_s(seed: int, place: int) -> float:
    """Return how long after it holds every topic, or in the last place after its bag, one is
    killed.
    """
    chance = random.Random(f"{seed} {place}")
    return chance.uniform(0.0, 0.6) if place == AT_ONCE - 1 else chance.uniform(0.3, 2.5)


def _kill_all(recordings: list[Recording], seed: int) -> list[int]:
    """Kills each at its moment; returns the steady times just before."""
    kill_at: dict[int, float] = {}
    killed: dict[int, int] = {}
    deadline = time.monotonic() + DEADLINE_S
    while len(killed) < len(recordings):
        now = time.monotonic()
        assert now < deadline, "a recorder did not begin to write"
        for place, recording in enumerate(recordings):
            if place in killed:
                continue
            early = place == AT_ONCE - 1
            if place not in kill_at:
                if recording.bag.is_dir() and (early or _holds_all(recording.bag)):
                    kill_at[place] = now + _after_s(seed, place)
            elif now >= kill_at[place]:
                killed[place] = recording.kill()
        time.sleep(0.002)
    return [killed[place] for place in range(len(recordings))]


def _holds_all(bag: Path) -> bool:
    """Tell whether something of each topic is written: on a busy machine they are met one by
    one.
    """
    data = b"".join(file.read_bytes() for file in bag.glob("*.mcap"))
    heads = set(_HEAD.findall(data))
    return all(
        any(payload(name, int(head[:10]), len(head)) == head for head in heads) for name in NAMES
    )


def test_a_kill_at_a_random_moment_costs_at_most_a_second(field_: Field) -> None:
    load = field_.load(*TOPICS)
    recordings = [
        field_.record(*NAMES, *split, name=f"bag_{place}") for place, split in enumerate(SPLITS)
    ]
    killed_ns = _kill_all(recordings, SEED)
    sent = load.stop()
    for place, (recording, kill_ns) in enumerate(zip(recordings, killed_ns, strict=True)):
        target = field_.folder / f"recovered_{place}"
        if place == AT_ONCE - 1 and not _has_data(recording.bag):
            with pytest.raises(InputError):
                recover(recording.bag, target)
            continue
        recover(recording.bag, target)
        assert check_bag(target).problems == ()
        # One that was killed in its first moments had met some of the topics.
        had = held(target, TOPICS)
        met = [topic for topic in TOPICS if place < AT_ONCE - 1 or had[topic.name]]
        until_ns = kept_until_ns(sent, kill_ns)
        assert missing(target, met, sent, until_ns) == [], f"recorder {place}"
        if place in (1, 2):
            assert len(list(recording.bag.glob("*.mcap"))) > 1


def _has_data(bag: Path) -> bool:
    return any(file.stat().st_size > 8 for file in bag.glob("*.mcap"))
