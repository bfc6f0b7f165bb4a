"""Runs that several tests compile, or drive without plans, are simulated once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ssp_core.files.writing import write_text
from ssp_core.run_file.driven import COMMANDED
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run import feasibility
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process

# Fields of a run that its session doesn't depend on.
_NAMES = {
    *("run_id", "scenario", "event_version", "task_version", "compiler"),
    *("site", "site_version", "session_token"),
}
# The compiler's simulation renders nothing.
_SEEN = {"camera", "look"}
# A record takes some megabytes.
_KEPT = 12
_RUN: dict[str, tuple[InProcessResult, Record]] = {}
WhyNot = Callable[[RunSpec], list[str]]


def remembered(why_not: WhyNot, folder: Path) -> WhyNot:
    """Return the check of the compiler, which the same run always passes for the same reasons.

    A test that puts something in the place of the simulation gets the check itself.

    Args:
        why_not: says why a run's event wouldn't happen, from two simulations of half a second.
        folder: is there, and shared by all workers.
    """
    simulation = feasibility.run_in_process

    def ask(run: RunSpec) -> list[str]:
        if feasibility.run_in_process is not simulation:
            return why_not(run)
        told = run.model_dump_json(exclude=_NAMES | _SEEN)
        key = hashlib.sha256(told.encode()).hexdigest()
        file = folder / f"{key}.json"
        if not file.exists():
            write_text(file, json.dumps(why_not(run)))
        reasons: list[str] = json.loads(file.read_text())
        return reasons

    return ask


def run_once(run: RunSpec, **given: Any) -> tuple[InProcessResult, Record]:
    """Run a session in this process, once for all tests of it, which only read what it gives.

    Those that plans lead, those with answers or a recording, and CARLA's are run each time.
    """
    plans = run.driven is not None and run.driven.driver not in COMMANDED
    if plans or any(given.values()) or run.plant != "bodies":
        return run_in_process(run, **given)
    key = run.model_dump_json(exclude=_NAMES)
    if key not in _RUN:
        _RUN[key] = run_in_process(run)
        if len(_RUN) > _KEPT:
            del _RUN[next(iter(_RUN))]
    return _RUN[key]
