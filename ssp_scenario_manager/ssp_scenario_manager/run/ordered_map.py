"""A function over many things, side by side in processes here or on a Ray cluster, in order."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from typing import Any, Literal

from ssp_core import console
from ssp_core.errors import HostError
from ssp_core.host.ray_cluster import import_ray, joined
from ssp_core.host.terminal import ignore_stop_signals

Engine = Literal["processes", "ray"]
ENGINES: tuple[Engine, ...] = ("processes", "ray")
# Workers that the cluster has no room for in this time are done without, once there is one.
_NOTE_S = 30.0


def cluster(engine: Engine, workers: int) -> AbstractContextManager[None]:
    """Hold the cluster of an engine for a block, so that maps within it share it.

    Raises:
        HostError: there is none.
    """
    return joined(import_ray(), workers) if engine == "ray" else nullcontext()


@contextmanager
def ordered_map(
    workers: int, engine: Engine = "processes", software: Callable[[], object] = lambda: None
) -> Iterator[Callable[..., Iterator[Any]]]:
    """Yield a map that keeps the order.

    Args:
        workers: that work at a time; one process works here.
        engine: where they are.
        software: what all machines of a cluster must have the same of; a function of a module.

    Raises:
        HostError: a worker was killed, the cluster fails, or a machine has another software.
    """
    if engine == "ray":
        ray = import_ray()
        with joined(ray, workers):
            yield partial(_map_on, ray, workers, software)
        return
    if workers <= 1:
        yield map
        return
    # A fresh interpreter each: libsumo holds one simulation per process and doesn't like forks.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, ignore_stop_signals) as pool:
        try:
            yield pool.map
        except BrokenProcessPool as error:
            raise HostError(
                "a process of the sweep was killed; the same command goes on where it was"
            ) from error
        finally:
            pool.shutdown(cancel_futures=True)


class _Worker:
    """The actor on the cluster."""

    def do(self, function: Callable[..., Any], *one: Any) -> Any:
        return function(*one)


def _ready_answers(ray: Any, requests: Sequence[Any]) -> list[Any]:
    """Return the answers of the actors that the cluster has had room for, of at least one."""
    there, _ = ray.wait(requests, num_returns=len(requests), timeout=_NOTE_S)
    while not there:
        console.note("the Ray cluster has no free processor for a worker yet")
        there, _ = ray.wait(requests, num_returns=1, timeout=_NOTE_S)
    answers: list[Any] = there
    return answers


def _map_on(
    ray: Any,
    workers: int,
    software: Callable[[], object],
    function: Callable[..., Any],
    things: Iterable[Any],
) -> Iterator[Any]:
    """Map on a cluster; its actors end with the map."""
    from ray.util import ActorPool

    # More than it has processors for would never be there.
    count = max(1, min(workers, int(ray.cluster_resources().get("CPU", 1))))
    actors = [ray.remote(num_cpus=1)(_Worker).remote() for _ in range(count)]
    try:
        ours = software()
        actors_by_request = {actor.do.remote(software): actor for actor in actors}
        there = _ready_answers(ray, list(actors_by_request))
        for theirs in ray.get(there):
            if theirs != ours:
                raise HostError(
                    "a machine of the Ray cluster has another version of this software; install "
                    "the same one on all"
                )
        pool = ActorPool([actors_by_request[one] for one in there])
        yield from pool.map(lambda actor, one: actor.do.remote(function, one), list(things))
    except ray.exceptions.RayTaskError as error:
        # As in one process; what can't be sent here is the cluster's trouble.
        raise (error.cause or error) from error
    finally:
        for actor in actors:
            ray.kill(actor)
