"""The room that the bags of a campaign take on the disk, by estimate, before a driver runs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ssp_core.errors import HostError
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_scenario_manager.closed_loop.campaigns.row_bags import Bags, bag_folder
from ssp_scenario_manager.closed_loop.campaigns.runs import Job
from ssp_scenario_manager.closed_loop.outcomes.careful import CAREFUL

# Measured on bags of the baselines, rounded up: task, index and view, then packed messages.
_RUN_BYTES = 350_000
_OBJECT_BYTES_PER_S = 15_000
# JPEG pictures of streets.
_BYTES_PER_PIXEL = 0.15
_GB = 1e9
# What else writes to the disk finds this much.
_LEFT_BYTES = 1_000_000_000


def check_room(jobs: Sequence[Job], folder: Path, which: Bags, say: Callable[[str], None]) -> None:
    """Say what the bags that are missing take, and refuse them where the disk has no room.

    Only bags of all runs are refused: how many runs fail isn't known before.

    Args:
        jobs: of the campaign.
        folder: of the campaign.
        which: of the runs are recorded.
        say: takes the estimate, for people.

    Raises:
        HostError: the disk has no room for them.
    """
    if which == "none":
        return
    count, needed = _missing(jobs, folder)
    free = shutil.disk_usage(folder).free
    if not count:
        return
    most = "" if which == "all" else "at most "
    estimate = (
        f"bags of {most}{count} runs take about {needed / _GB:.2f} GB; "
        f"{free / _GB:.2f} GB are free in {folder}"
    )
    if which == "all" and needed + _LEFT_BYTES > free:
        raise HostError(
            f"{estimate}; give --bags failed or none, or a folder on another disk: the same "
            "command with another --bags goes on with these starts"
        )
    say(estimate)


def _missing(jobs: Sequence[Job], folder: Path) -> tuple[int, float]:
    """Return how many runs have no bag, and the bytes that their bags will take."""
    count, needed = 0, 0.0
    read: dict[str, dict[str, Any]] = {}
    for job in jobs:
        if job.driver.driver == CAREFUL:
            continue
        numbers = range(job.first_row, job.first_row + job.count)
        missing = sum(not (bag_folder(folder, n) / RESULT_FILE).is_file() for n in numbers)
        if job.start not in read:
            read[job.start] = json.loads(job.start)
        count += missing
        needed += missing * _bag_bytes(read[job.start], sees=job.driver.is_model)
    return count, needed


def _bag_bytes(start: Mapping[str, Any], *, sees: bool) -> float:
    """Return the size of one run's folder, bytes.

    Args:
        start: as it was sealed.
        sees: the driver gets frames.
    """
    rate = _OBJECT_BYTES_PER_S * (1 + len(start["run"]["targets"]))
    camera = start["camera"]
    if sees and camera is not None:
        pixels = camera["width_px"] * camera["height_px"]
        rate += pixels * camera["rate_hz"] * _BYTES_PER_PIXEL
    return float(_RUN_BYTES + rate * start["end_s"])
