"""Cells over a Ray cluster: the same work as a pool of processes, where one machine is too small.

All machines must see the bags and the campaign folder under the same paths.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from ssp_core import console
from ssp_eval.evaluate.cell_file import CellResult
from ssp_eval.evaluate.job import Job, JobRunner, Settings
from ssp_eval.evaluate.ray_cluster import first_line, import_ray, joined

# How long a cluster may have no room for a worker before somebody is told.
_NOTE_S = 30.0
_LEAVE_S = 30.0


class _Actor:
    """What runs on the cluster: a JobRunner with a way to end it."""

    def __init__(self, settings: Settings, name: str) -> None:
        self._settings, self._name = settings, name
        self._runner: JobRunner | None = None

    def hello(self) -> None:
        """Answers as soon as the cluster has room for the actor."""

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
        workers: how many actors, one processor each; a cluster with fewer has fewer at a time.
        on_dead: writes a failed cell, given how its worker died.
        on_record: called once per label time, when its cell is done.

    Raises:
        HostError: Ray isn't installed, there is no cluster, or it fails.
        InputError: of a cell, as in a campaign of one process.
    """
    ray = import_ray()
    with joined(ray, workers):
        return _run(ray, jobs, settings, workers, on_dead, on_record)


def _run(
    ray: Any,
    jobs: Sequence[Job],
    settings: Settings,
    workers: int,
    on_dead: Callable[[Job, str], CellResult],
    on_record: Callable[[], None],
) -> list[CellResult]:
    actor_class = ray.remote(num_cpus=1)(_Actor)
    waiting = list(jobs)
    found: dict[int, CellResult] = {}
    actors: list[Any] = []
    there: list[Any] = []
    at_work: dict[Any, tuple[Any, Job | None]] = {}

    def start() -> None:
        # A cell is given to it once it is there: the cluster may never have room for it.
        actor = actor_class.remote(settings, f"worker_{len(actors)}")
        actors.append(actor)
        at_work[actor.hello.remote()] = actor, None

    try:
        for _ in range(min(workers, len(jobs))):
            start()
        while len(found) < len(jobs):
            ready, _ = ray.wait(list(at_work), num_returns=1, timeout=_NOTE_S)
            if not ready:
                if not there:
                    console.note("the Ray cluster has no free processor for a worker yet")
                continue
            actor, job = at_work.pop(ready[0])
            try:
                answer = ray.get(ready[0])
            except ray.exceptions.RayActorError as error:
                if actor in there:
                    there.remove(actor)
                lost = waiting.pop(0) if job is None and waiting else job
                if lost is not None:
                    found[lost.number] = on_dead(lost, f"the worker died: {first_line(error)}")
                if waiting:
                    start()
                continue
            except ray.exceptions.RayTaskError as error:
                # As in a campaign of one process; what can't be sent here is the cluster's trouble.
                raise (error.cause or error) from error
            if job is None:
                there.append(actor)
            else:
                found[job.number], records = answer
                for _ in range(records):
                    on_record()
            if waiting:
                following = waiting.pop(0)
                at_work[actor.run.remote(following)] = actor, following
    finally:
        _end(ray, there, actors)
    return [found[job.number] for job in jobs]


def _end(ray: Any, there: Sequence[Any], actors: Sequence[Any]) -> None:
    """Lets the actors that are there end their bridges; then all are removed."""
    # A cluster that is gone has nothing to end, and must not hide why it is gone.
    with suppress(ray.exceptions.RayError, ConnectionError):
        closing = [actor.close.remote() for actor in there]
        if closing:
            ray.wait(closing, num_returns=len(closing), timeout=_LEAVE_S)
        for actor in actors:
            ray.kill(actor)
