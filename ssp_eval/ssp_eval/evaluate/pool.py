"""Cells over a pool of processes, each with its own bridges in its own ROS domain.

A worker that dies costs the cell that it was at, with how it died as the reason; another one takes
its place. Whatever ends the campaign ends the workers, and they end their bridges.
"""

from __future__ import annotations

import multiprocessing
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from ssp_core.console import ignore_stop_signals
from ssp_core.errors import SspError
from ssp_core.processes import die_with_parent
from ssp_eval.evaluate.cell_file import CellResult
from ssp_eval.evaluate.job import Job, JobRunner, Settings

RECORD, DONE, ERROR, BUG = "record", "done", "error", "bug"
# Workers have bridges to end, and these are given ten seconds each.
_LEAVE_S = 30.0


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection[Any, Any]
    job: Job | None = None
    last_model: str = ""


@dataclass
class _Pool:
    settings: Settings
    waiting: list[Job]
    on_record: Callable[[], None]
    workers: list[_Worker] = field(default_factory=list)
    started: int = 0

    def start(self) -> _Worker:
        """A worker in a process of its own; a fork would take locks of this one's threads along."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        name = f"worker_{self.started}"
        self.started += 1
        process = context.Process(target=_work, args=(self.settings, name, theirs), name=name)
        process.start()
        theirs.close()
        worker = _Worker(process, ours)
        self.workers.append(worker)
        return worker

    def give(self, worker: _Worker) -> None:
        """The next cell, of the model whose bridge the worker has where there is one."""
        if not self.waiting:
            return
        same = (job for job in self.waiting if job.model.name == worker.last_model)
        job = next(same, self.waiting[0])
        self.waiting.remove(job)
        worker.job, worker.last_model = job, job.model.name
        with suppress(OSError):  # it died in between; its end says so
            worker.pipe.send(job)

    def end(self) -> None:
        """Ends all workers, those that don't go by force."""
        for worker in self.workers:
            worker.pipe.close()
            worker.process.terminate()
        for worker in self.workers:
            worker.process.join(_LEAVE_S)
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()


def run_pool(
    jobs: Sequence[Job],
    settings: Settings,
    workers: int,
    on_dead: Callable[[Job, str], CellResult],
    on_record: Callable[[], None] = lambda: None,
) -> list[CellResult]:
    """Evaluates cells in several processes.

    Args:
        jobs: the cells.
        settings: what they have in common.
        workers: how many processes; not more are started than there are cells.
        on_dead: writes a failed cell, given how its worker died.
        on_record: called once per label time.

    Returns:
        One result per job, in their order.

    Raises:
        InputError: of a cell, as in a campaign of one process; the others are ended.
        HostError: the same.
        RuntimeError: a bug in a worker, with its traceback.
    """
    pool = _Pool(settings, list(jobs), on_record)
    found: dict[int, CellResult] = {}
    try:
        for _ in range(min(workers, len(jobs))):
            pool.give(pool.start())
        while len(found) < len(jobs):
            ready = wait([worker.pipe for worker in pool.workers if worker.job is not None])
            for worker in [worker for worker in pool.workers if worker.pipe in ready]:
                _hear(pool, worker, found, on_dead)
    finally:
        pool.end()
    return [found[job.number] for job in jobs]


def _hear(
    pool: _Pool,
    worker: _Worker,
    found: dict[int, CellResult],
    on_dead: Callable[[Job, str], CellResult],
) -> None:
    """What a worker said, or that it died."""
    job = worker.job
    if job is None:
        return
    try:
        kind, value = worker.pipe.recv()
    except (EOFError, OSError):
        worker.process.join(_LEAVE_S)
        how = _how(worker.process.exitcode)
        worker.process.kill()
        pool.workers.remove(worker)
        worker.pipe.close()
        found[job.number] = on_dead(job, f"the worker died: {how}")
        if pool.waiting:
            pool.give(pool.start())
        return
    if kind == RECORD:
        pool.on_record()
    elif kind == DONE:
        found[job.number] = value
        worker.job = None
        pool.give(worker)
    elif kind == ERROR:
        raise value
    else:
        raise RuntimeError(f"a worker failed:\n{value}")


def _how(code: int | None) -> str:
    if code is None:
        return "it closed its pipe and did not end"
    return f"killed by {signal.Signals(-code).name}" if code < 0 else f"exited with status {code}"


def _work(settings: Settings, name: str, pipe: Connection[Any, Any]) -> None:
    """The worker: takes jobs until its pipe is closed."""
    die_with_parent()
    ignore_stop_signals()
    signal.signal(signal.SIGTERM, _leave)
    try:
        runner = JobRunner(settings, name)
    except SspError as error:
        pipe.recv()
        pipe.send((ERROR, error))
        return
    with runner:
        while True:
            try:
                job = pipe.recv()
            except (EOFError, OSError):
                signal.signal(signal.SIGTERM, signal.SIG_IGN)
                return
            try:
                pipe.send((DONE, runner.run(job, lambda: pipe.send((RECORD, None)))))
            except SspError as error:
                pipe.send((ERROR, error))
            except Exception:  # it is raised again where somebody sees it
                pipe.send((BUG, traceback.format_exc()))


def _leave(*_: object) -> None:
    """Ends the worker in order, once: a second signal would cut short how it ends its bridges."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(0)
