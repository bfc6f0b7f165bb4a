"""Cells over a Ray cluster: the same work as a pool of processes, where one machine is too small.

All machines must see the bags and the campaign folder under the same paths.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Sequence
from typing import Any

from ssp_core.errors import HostError
from ssp_eval.evaluate.cell_file import CellResult
from ssp_eval.evaluate.job import Job, JobRunner, Settings

ADDRESS = "RAY_ADDRESS"


class _Actor:
    """What runs on the cluster: a JobRunner with a way to end it."""

    def __init__(self, settings: Settings, name: str) -> None:
        self._settings, self._name = settings, name
        self._runner: JobRunner | None = None

    def run(self, job: Job) -> tuple[CellResult, int]:
        """The cell, and how many label times it had."""
        if self._runner is None:
            # Here, not at the start: what it raises then is this call's error.
            self._runner = JobRunner(self._settings, self._name)
        count = 0

        def on_record() -> None:
            nonlocal count
            count += 1

        return self._runner.run(job, on_record), count

    def close(self) -> None:
        """Ends the bridges."""
        if self._runner is not None:
            self._runner.close()


def import_ray() -> Any:
    """The module.

    Raises:
        HostError: it isn't installed; with the remedy.
    """
    try:
        return importlib.import_module("ray")
    except ImportError as error:
        raise HostError(
            f"Ray can't be imported ({error}); install the extra with "
            "`python -m pip install 'ssp[ray]'`, or use --engine processes"
        ) from error


def run_ray(
    jobs: Sequence[Job],
    settings: Settings,
    workers: int,
    on_dead: Callable[[Job, str], CellResult],
    on_record: Callable[[], None] = lambda: None,
) -> list[CellResult]:
    """As pool.run_pool, on the cluster that RAY_ADDRESS names, or on one that is started here.

    Args:
        jobs: the cells.
        settings: what they have in common.
        workers: how many actors, one processor each.
        on_dead: writes a failed cell, given how its worker died.
        on_record: called once per label time, when its cell is done.

    Raises:
        HostError: Ray isn't installed.
        InputError: of a cell, as in a campaign of one process.
    """
    ray = import_ray()
    own = not ray.is_initialized()
    if own:
        size = {} if os.environ.get(ADDRESS) else {"num_cpus": workers}
        ray.init(include_dashboard=False, log_to_driver=False, configure_logging=False, **size)
    try:
        return _run(ray, jobs, settings, workers, on_dead, on_record)
    finally:
        if own:
            ray.shutdown()


def _run(
    ray: Any,
    jobs: Sequence[Job],
    settings: Settings,
    workers: int,
    on_dead: Callable[[Job, str], CellResult],
    on_record: Callable[[], None],
) -> list[CellResult]:
    actor_class = ray.remote(num_cpus=1)(_Actor)
    waiting, found = list(jobs), {}
    actors: list[Any] = []
    at_work: dict[Any, tuple[Any, Job]] = {}

    def start() -> Any:
        actors.append(actor_class.remote(settings, f"worker_{len(actors)}"))
        return actors[-1]

    def give(actor: Any) -> None:
        if waiting:
            job = waiting.pop(0)
            at_work[actor.run.remote(job)] = actor, job

    try:
        for _ in range(min(workers, len(jobs))):
            give(start())
        while at_work:
            (ready,), _ = ray.wait(list(at_work), num_returns=1)
            actor, job = at_work.pop(ready)
            try:
                found[job.number], records = ray.get(ready)
            except ray.exceptions.RayActorError as error:
                found[job.number] = on_dead(job, f"the worker died: {_line(error)}")
                give(start())
                continue
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            for _ in range(records):
                on_record()
            give(actor)
    finally:
        _end(ray, actors)
    return [found[job.number] for job in jobs]


def _end(ray: Any, actors: Sequence[Any]) -> None:
    """Lets the actors end their bridges; those that are dead or hang are removed."""
    closing = [actor.close.remote() for actor in actors]
    ray.wait(closing, num_returns=len(closing), timeout=30.0)
    for actor in actors:
        ray.kill(actor)


def _line(error: Exception) -> str:
    return next(iter(str(error).strip().splitlines()), type(error).__name__)
