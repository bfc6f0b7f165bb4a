"""Each compiled run is simulated once in a run of the tests, whichever tests compile it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

from ssp_core.files import write_text
from ssp_core.run_file.model import RunSpec
from ssp_scenario_manager.run import feasibility

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
