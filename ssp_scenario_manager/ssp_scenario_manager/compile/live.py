"""A compiled run as it is for real objects: without what a simulated world would add to it."""

from __future__ import annotations

from ssp_core.errors import InputError
from ssp_core.run_file.model import LinkDisturbance, RunSpec


def as_live(run: RunSpec) -> RunSpec:
    """The run in mode live: no disturbances of links and sensors, no simulated traffic.

    What a stand-in site brings of them is for simulation; none of it is a change on site.

    Raises:
        InputError: the site is no proving ground.
    """
    if run.domain != "physical":
        raise InputError(
            "is no proving ground",
            field="site",
            value=run.site,
            remedy="a live session needs a site with domain: physical",
        )
    return run.model_copy(
        update={
            "mode": "live",
            "disturbance": LinkDisturbance(),
            "disturbances": {},
            "traffic": [],
        }
    )


def check_live(run: RunSpec) -> None:
    """Raises InputError where a live run was given faults or disturbances of objects."""
    problem = run.live_problem
    if problem is not None:
        raise InputError(
            problem, field="faults, disturbances", remedy="leave them out, or run in lockstep"
        )
