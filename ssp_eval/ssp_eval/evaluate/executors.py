"""Cells as jobs for other processes: a pool of them here, or a Ray cluster."""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from ssp_core import console
from ssp_core.closing import Closing
from ssp_core.errors import HostError, InputError, SspError
from ssp_core.host.children import die_with_parent, worker_context
from ssp_core.host.ray_cluster import first_line, import_ray, joined
from ssp_core.host.terminal import ignore_stop_signals
from ssp_eval.data.labels import labels_version
from ssp_eval.evaluate.bridges import TopicClients
from ssp_eval.evaluate.campaign import labelled_clip
from ssp_eval.evaluate.cell import evaluate_again
from ssp_eval.evaluate.clients.model_client import ClientsWithAnswerers, ModelClients
from ssp_eval.evaluate.clients.models import ModelSpec
from ssp_eval.evaluate.clients.topic_client import CONNECT_S
from ssp_eval.evaluate.conditions.twin_clips import with_twins
from ssp_eval.evaluate.conversation import CellOptions
from ssp_eval.evaluate.store.admission import NO_AUDIT, Admission
from ssp_eval.evaluate.store.cell_file import CellResult, LabelledClip
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.recordings.clip import Clip
from ssp_eval.twins.files import SET_FILE, twins_folder


@dataclass(frozen=True)
class Settings:
    """The settings that all cells of a campaign share.

    Args:
        make_extractor: each worker makes its own, since a client of a service can't be sent.
        options: of the cells; a worker replaces their extractor by its own.
        timeout_s: for one answer, where the model has no time of its own.
        start_timeout_s: until a bridge is on its topics.
        direct: models answer in the worker itself, without ROS; None: over topics.
        extractor_sha256: of the extractor that all workers must have; empty: any.
    """

    out: Path
    make_extractor: Callable[[], Extractor] = Extractor
    options: CellOptions = field(default_factory=CellOptions)
    timeout_s: float = 60.0
    start_timeout_s: float = CONNECT_S
    direct: Callable[[], ModelClients] | None = None
    extractor_sha256: str = ""

    def to_send(self) -> Settings:
        """Return settings for another process, which must use the same extractor."""
        digest = self.options.extractor.sha256
        rules = replace(self.options, extractor=Extractor())
        return replace(self, options=rules, extractor_sha256=digest)


@dataclass(frozen=True)
class Job:
    """One cell, or those of a model whose conditions take turns (design.series_of).

    Args:
        bag_sha256, labels_sha256: of the recording, and of what its labels say (labels_version).
        twins_sha256: of the twins that the models' conditions are about, by condition.
    """

    number: int
    bag: Path
    labels: Path
    models: tuple[ModelSpec, ...]
    bag_sha256: str
    labels_sha256: str
    admission: Admission = NO_AUDIT
    twins_sha256: Mapping[str, str] = field(default_factory=dict)


class JobRunner(Closing):
    """Does jobs one after the other; bridges are kept until the block ends.

    Raises:
        HostError: the worker has another version of the software.
    """

    def __init__(self, settings: Settings, name: str) -> None:
        self._settings = settings
        extractor = settings.make_extractor()
        if settings.extractor_sha256 not in ("", extractor.sha256):
            raise HostError(
                f"{name} extracts by other rules than the campaign ({extractor.sha256}, not "
                f"{settings.extractor_sha256}); install the same version everywhere"
            )
        self._stack = ExitStack()
        if settings.direct is not None:
            self._clients: ModelClients = settings.direct()
        else:
            logs = settings.out / "logs" / name
            topics = TopicClients(logs, settings.timeout_s, False, settings.start_timeout_s)
            self._clients = ClientsWithAnswerers(self._stack.enter_context(topics))
        self._options = replace(settings.options, extractor=extractor)

    def run(self, job: Job, on_record: Callable[[], None] = lambda: None) -> list[CellResult]:
        """Evaluate the cells of a job as a campaign of one process does.

        Raises:
            InputError: the recording or its labels aren't those that the campaign began with.
        """
        with ExitStack() as stack:
            clip = stack.enter_context(Clip(job.bag))
            labelled = labelled_clip(clip, job.labels, job.admission)
            if job.twins_sha256:
                labelled = with_twins(stack, labelled, job.twins_sha256)
            _check_same(job, labelled)
            return evaluate_again(
                labelled, job.models, self._clients, self._settings.out, self._options, on_record
            )

    def close(self) -> None:
        """End the bridges."""
        self._stack.close()


def _check_same(job: Job, labelled: LabelledClip) -> None:
    """Check that a file is the same as at the beginning, on another machine too."""
    bag_sha256 = labelled.clip.provenance.bag_sha256
    twins = {condition: twin.sha256 for condition, twin in labelled.twins.items()}
    for file, before, now in (
        (job.bag, job.bag_sha256, bag_sha256),
        *(
            (twins_folder(job.bag) / SET_FILE, digest, twins.get(condition, ""))
            for condition, digest in job.twins_sha256.items()
        ),
        (job.labels, job.labels_sha256, labels_version(labelled.labels)),
    ):
        if before != now:
            raise InputError(
                f"isn't what the campaign began with ({before}) but {now}",
                file=file,
                remedy="leave it unchanged while a campaign runs, the same on all machines",
            )


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
        """Return a worker in its own process."""
        context = worker_context()
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
        """Give a worker the next job, if possible of the model whose bridge it has."""
        if not self.waiting:
            return
        same = (job for job in self.waiting if job.models[0].name == worker.last_model)
        job = next(same, self.waiting[0])
        self.waiting.remove(job)
        worker.job, worker.last_model = job, job.models[0].name
        with suppress(OSError):  # it died in between; its end says so
            worker.pipe.send(job)

    def end(self) -> None:
        """End all workers, by force where they don't end by themselves."""
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
    on_dead: Callable[[Job, str], list[CellResult]],
    on_record: Callable[[], None] = lambda: None,
) -> list[CellResult]:
    """Evaluate cells in several processes.

    Args:
        jobs: each the cells of one recording and model.
        settings: sent to each worker.
        workers: how many processes; not more are started than there are cells.
        on_dead: makes the results of a job whose worker died, from its reason.
        on_record: called after each label time of a cell.

    Returns:
        The results of the jobs, in their order.

    Raises:
        InputError: of a cell, as in a campaign of one process; the others are ended.
        HostError: the same.
        RuntimeError: a bug in a worker, with its traceback.
    """
    pool = _Pool(settings, list(jobs), on_record)
    results: dict[int, list[CellResult]] = {}
    try:
        for _ in range(min(workers, len(jobs))):
            pool.give(pool.start())
        while len(results) < len(jobs):
            ready = wait([worker.pipe for worker in pool.workers if worker.job is not None])
            for worker in [worker for worker in pool.workers if worker.pipe in ready]:
                _hear(pool, worker, results, on_dead)
    finally:
        pool.end()
    return [result for job in jobs for result in results[job.number]]


def _hear(
    pool: _Pool,
    worker: _Worker,
    results: dict[int, list[CellResult]],
    on_dead: Callable[[Job, str], list[CellResult]],
) -> None:
    """Take a worker's message, or notice its death."""
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
        results[job.number] = on_dead(job, f"the worker died: {how}")
        if pool.waiting:
            pool.give(pool.start())
        return
    if kind == RECORD:
        pool.on_record()
    elif kind == DONE:
        results[job.number] = value
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
    """Take jobs until the pipe is closed; the body of a worker process."""
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
    """End the worker in order, once: a second signal would cut short how it ends its bridges."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(0)


# How long a cluster may have no room for a worker before somebody is told.
_NOTE_S = 30.0


class _Actor:
    """The actor on the cluster: a JobRunner with a way to end it."""

    def __init__(self, settings: Settings, name: str) -> None:
        self._settings, self._name = settings, name
        self._runner: JobRunner | None = None

    def hello(self) -> None:
        """Answer as soon as the cluster has room for the actor."""

    def run(self, job: Job) -> tuple[list[CellResult], int]:
        """Return the cells, and how many label times they had."""
        if self._runner is None:
            # Here, not at the start: what it raises then is this call's error.
            self._runner = JobRunner(self._settings, self._name)
        count = 0

        def on_record() -> None:
            nonlocal count
            count += 1

        return self._runner.run(job, on_record), count

    def close(self) -> None:
        """End the bridges."""
        if self._runner is not None:
            self._runner.close()


def run_ray(
    jobs: Sequence[Job],
    settings: Settings,
    workers: int,
    on_dead: Callable[[Job, str], list[CellResult]],
    on_record: Callable[[], None] = lambda: None,
) -> list[CellResult]:
    """Run jobs as run_pool does, on the cluster that RAY_ADDRESS names, or on one started here.

    Args:
        jobs: each the cells of one recording and model.
        settings: sent to each actor.
        workers: how many actors, one processor each; a cluster with fewer has fewer at a time.
        on_dead: makes the results of a job whose actor died, from its reason.
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
    on_dead: Callable[[Job, str], list[CellResult]],
    on_record: Callable[[], None],
) -> list[CellResult]:
    actor_class = ray.remote(num_cpus=1)(_Actor)
    waiting = list(jobs)
    results: dict[int, list[CellResult]] = {}
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
        while len(results) < len(jobs):
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
                    results[lost.number] = on_dead(lost, f"the worker died: {first_line(error)}")
                if waiting:
                    start()
                continue
            except ray.exceptions.RayTaskError as error:
                # As in a campaign of one process; what can't be sent here is the cluster's trouble.
                raise (error.cause or error) from error
            if job is None:
                there.append(actor)
            else:
                results[job.number], records = answer
                for _ in range(records):
                    on_record()
            if waiting:
                following = waiting.pop(0)
                at_work[actor.run.remote(following)] = actor, following
    finally:
        _end(ray, there, actors)
    return [result for job in jobs for result in results[job.number]]


def _end(ray: Any, there: Sequence[Any], actors: Sequence[Any]) -> None:
    """Let the actors that are there end their bridges; then all are removed."""
    # A cluster that is gone has nothing to end, and must not hide why it is gone.
    with suppress(ray.exceptions.RayError, ConnectionError):
        closing = [actor.close.remote() for actor in there]
        if closing:
            ray.wait(closing, num_returns=len(closing), timeout=_LEAVE_S)
        for actor in actors:
            ray.kill(actor)
