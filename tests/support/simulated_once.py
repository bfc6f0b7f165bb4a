"""Each compiled run is simulated once in a run of the tests, whichever tests compile it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ssp_core.files import write_text
from ssp_core.run_file.driven import COMMANDED
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run import feasibility
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process

# A record takes some megabytes.
_KEPT = 8
_DRIVEN: dict[str, tuple[InProcessResult, Record]] = {}
_COMMANDED: dict[str, tuple[InProcessResult, Record]] = {}
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
        key = hashlib.sha256(run.model_dump_json().encode()).hexdigest()
        file = folder / f"{key}.json"
        if not file.exists():
            write_text(file, json.dumps(why_not(run)))
        reasons: list[str] = json.loads(file.read_text())
        return reasons

    return ask


def driven_once(run: RunSpec) -> tuple[InProcessResult, Record]:
    """Return the session of a run as an export foresees it, driven once by a process's tests.

    Tests only read it.
    """
    return _once(_DRIVEN, run, feasibility.driven)


def commanded_once(run: RunSpec, **given: Any) -> tuple[InProcessResult, Record]:
    """Run a session; those that a driver without plans leads are run once by a process's tests.

    They are the twins of starts, and what is driven to draw them. Tests only read them.
    """
    if run.driven is None or run.driven.driver not in COMMANDED or any(given.values()):
        return run_in_process(run, **given)
    return _once(_COMMANDED, run, run_in_process)


def _once(
    kept: dict[str, tuple[InProcessResult, Record]],
    run: RunSpec,
    drive: Callable[[RunSpec], tuple[InProcessResult, Record]],
) -> tuple[InProcessResult, Record]:
    key = run.model_dump_json()
    if key not in kept:
        kept[key] = drive(run)
        if len(kept) > _KEPT:
            del kept[next(iter(kept))]
    return kept[key]
