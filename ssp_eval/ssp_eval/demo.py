"""``ssp demo``: both scenarios in three domains, through all verbs, from K* to the package."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
from rich.progress import Progress as ProgressBar

from ssp_core import __version__, console
from ssp_core.errors import InputError, PeerError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_core.host.forked import ForkedProcess, node_server
from ssp_core.host.locks import folder_of_locks
from ssp_core.host.node_server import Request
from ssp_core.host.terminal import on_stop_signals
from ssp_eval.demo_plan import (
    AT_ONCE,
    DEFAULT_SCENARIOS,
    SCENARIOS,
    Step,
    package_folder,
    plan_steps,
)
from ssp_eval.evaluate.store.results import load_cells

MARKER = ".ssp-demo.json"
SCHEMA = "ssp.demo/1"
LOGS = "logs/steps"
# All that a demonstration leaves in its folder.
MADE = frozenset(
    {
        MARKER,
        "audits",
        "cells",
        "clips",
        "frames",
        "index.html",
        "logs",
        "package",
        "report",
        "requests",
        "runs",
        "tasks",
    }
)
_MOST = 99
_WHOLE = 1.0 - 1e-9


@dataclass
class Progress:
    """The steps done in a folder of a demonstration, as its marker says.

    Args:
        plan: what its steps and their software are; another plan begins anew.
        steps: commands of the finished steps, by name.
        complete: every step is finished, and the next demonstration begins anew.
    """

    folder: Path
    plan: str
    steps: dict[str, str] = field(default_factory=dict)
    complete: bool = False
    wall_s: float = 0.0

    @classmethod
    def of(cls, folder: Path, plan: str) -> Progress:
        """Read the marker of a folder, or begin anew where it can't be continued."""
        value = _marker(folder / MARKER)
        steps = value.get("steps")
        if value.get("plan") != plan or value.get("complete") or not isinstance(steps, dict):
            return cls(folder, plan)
        return cls(folder, plan, {str(name): str(command) for name, command in steps.items()})

    def finish(self, step: Step) -> None:
        """Note a step as finished."""
        self.steps[step.name] = step.digest
        self.write()

    def finished_steps(self, steps: Sequence[Step]) -> set[str]:
        """Return the names of the steps that are finished, with all that they need."""
        names: set[str] = set()
        for step in steps:
            unchanged = self.steps.get(step.name) == step.digest
            if unchanged and names.issuperset((*step.needs, *step.after)):
                names.add(step.name)
        return names

    def write(self) -> None:
        """Leave the marker."""
        value = {"schema": SCHEMA, "plan": self.plan, "steps": self.steps}
        write_json(
            self.folder / MARKER,
            {**value, "complete": self.complete, "wall_s": round(self.wall_s, 1)},
        )


@contextmanager
def own_folder(out: Path, plan: str) -> Iterator[Progress]:
    """Yield the folder, or the next free number beside it while another demonstration works there.

    An earlier demonstration of the same plan that is incomplete is gone on with.

    Args:
        out: the folder that the user named.
        plan: see Progress.

    Raises:
        InputError: it holds something that no demonstration made.
    """
    for number in range(1, _MOST + 1):
        folder = out if number == 1 else out.with_name(f"{out.name}-{number}")
        handle = os.open(_lock_file(folder), os.O_CREAT | os.O_RDONLY, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            _check_own(folder)
            progress = Progress.of(folder, plan)
            if not progress.steps:
                _clear(folder)
            progress.write()
            yield progress
        finally:
            os.close(handle)
        return
    raise InputError(
        f"and {_MOST - 1} folders beside it are in use",
        file=out,
        remedy="name another folder, or wait until they have ended",
    )


def _lock_file(folder: Path) -> Path:
    """Return the path of a folder's lock, outside all folders of users."""
    locks = folder_of_locks("ssp-demos")
    return locks / sha256_bytes(str(folder.resolve()).encode()).removeprefix("sha256:")[:32]


def _check_own(folder: Path) -> None:
    """Make the folder, or check that it holds what an earlier demonstration left, and no more.

    Raises:
        InputError: it can't be made, or holds something that no demonstration made.
    """
    entries = {entry.name for entry in make_folder(folder).iterdir()}
    foreign = sorted(entries - MADE)
    if foreign or (entries and not _is_ours(folder / MARKER)):
        raise InputError(
            "holds something that no demonstration made",
            file=folder,
            value=", ".join(foreign) or None,
            remedy="name another folder with --out",
        )


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        _remove(path)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _is_ours(marker: Path) -> bool:
    return _marker(marker).get("schema") == SCHEMA


def _marker(file: Path) -> dict[str, Any]:
    """Read a marker; empty where it can't be read."""
    try:
        value = json.loads(file.read_text())
    except (OSError, ValueError):
        return {}
    return value if isinstance(value, dict) else {}


END_TIMEOUT_S = 30.0
_POLL_S = 0.02
_TAIL = 15


@dataclass(frozen=True, slots=True)
class _Running:
    """A step's process and its log file."""

    step: Step
    process: ForkedProcess
    log: Path


@dataclass(frozen=True, slots=True)
class Gap:
    """A step that failed or wasn't begun, and why."""

    step: Step
    why: str


def follow(
    steps: Sequence[Step],
    logs: Path,
    on_start: Callable[[Step, int], None],
    on_end: Callable[[Step], None],
    earlier_steps: Collection[str] = (),
) -> list[Gap]:
    """Run all steps; one that fails costs only those that need it.

    Each step is a process group of its own, so that Ctrl-C reaches it once and through here: it
    gets the signal, and the time to abort its session and to close its bag. All are forked from one
    process, which imports a step's modules before (node_server).

    Args:
        steps: each needs only ones before it.
        logs: folder that gets command and output of each step.
        on_start: takes each step that begins, and its number, from 1.
        on_end: takes each step that was done.
        earlier_steps: names of steps that were done before.

    Returns:
        What is missing; empty when all steps are done.

    Raises:
        PeerError: it was interrupted.
    """
    waiting = [step for step in steps if step.name not in earlier_steps]
    running, completed_steps, gaps = list[_Running](), set(earlier_steps), list[Gap]()
    signals: list[signal.Signals] = []
    # Looked at between two steps: raised in between, it would miss a step that just starts.
    with on_stop_signals(signals.append):
        try:
            while waiting or running:
                if signals:
                    titles = ", ".join(one.step.title for one in running) or "between two steps"
                    raise PeerError(f"{titles}: interrupted")
                failed = {gap.step.name for gap in gaps}
                for late in [one for one in waiting if not failed.isdisjoint(one.needs)]:
                    waiting.remove(late)
                    gaps.append(Gap(late, f"needs {', '.join(sorted(failed & {*late.needs}))}"))
                failed = {gap.step.name for gap in gaps}
                while (step := _next(waiting, running, completed_steps, failed)) is not None:
                    waiting.remove(step)
                    on_start(step, len(steps) - len(waiting))
                    running.append(_start(step, logs))
                ended = [one for one in running if one.process.poll() is not None]
                for one in ended:
                    running.remove(one)
                    if (gap := _gap(one)) is not None:
                        gaps.append(gap)
                    else:
                        completed_steps.add(one.step.name)
                        on_end(one.step)
                if not ended and running:
                    time.sleep(_POLL_S)
        except BaseException:
            _end_all(running)
            raise
    return gaps


def _next(
    waiting: Sequence[Step],
    running: Sequence[_Running],
    completed_steps: set[str],
    failed: set[str],
) -> Step | None:
    """Return the first step that may start now; sessions first, since they take longest."""
    if len(running) >= AT_ONCE:
        return None
    over = completed_steps | failed
    ready = [s for s in waiting if completed_steps.issuperset(s.needs) and over.issuperset(s.after)]
    sessions = [step for step in ready if step.session]
    if sessions and not any(one.step.session for one in running):
        return sessions[0]
    return next((step for step in ready if not step.session), None)


def _start(step: Step, logs: Path) -> _Running:
    for path in step.makes:
        _remove(path)
    log = logs / f"{step.name.replace('/', '-')}.log"
    with log.open("wb") as stream:
        command = step.command()
        stream.write(f"$ ssp {' '.join(command)}\n".encode())
        stream.flush()
        module, *imports = step.modules
        env = dict(os.environ)
        request = Request("ssp", module, command, env, os.getcwd(), imports)
        process = node_server(env).start(request, stream.fileno())
    return _Running(step, process, log)


def _gap(one: _Running) -> Gap | None:
    """Say why a step failed, with the last lines of its output; None where it didn't."""
    status = one.process.returncode
    if status == 0:
        return None
    tail = "\n".join(one.log.read_text(errors="replace").splitlines()[-_TAIL:])
    return Gap(one.step, f"failed with status {status}\n{tail}")


def _end_all(running: Sequence[_Running]) -> None:
    """Ask the steps to end and wait for them; one that doesn't is killed."""
    with on_stop_signals(lambda _: None):
        for one in running:
            one.process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + END_TIMEOUT_S
        for one in running:
            try:
                one.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                os.killpg(one.process.pid, signal.SIGKILL)
                one.process.wait()


@click.command()
@click.option(
    "--scenario",
    "scenarios",
    type=click.Choice(SCENARIOS),
    multiple=True,
    default=DEFAULT_SCENARIOS,
    show_default=True,
    help="Event to show; repeatable.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    help="Folder for everything; a complete demonstration there is replaced, an incomplete one "
    "goes on.",
)
@click.option("--json", "as_json", is_flag=True, help="Print a summary as JSON.")
def demo(scenarios: tuple[str, ...], out: Path, as_json: bool) -> int:
    """Show events in three domains: compile, run, audit, ask two bridges, score, report, pack.

    Each event comes from its K* file. The `physical` sessions are a software stand-in on another
    site with disturbances: no vehicle moves, and no figure of this demonstration says anything
    about one. A step that fails is named at the end, and the exit status is 1; the same command,
    given again, does what is missing.
    """
    started = time.monotonic()
    unique_scenarios = list(dict.fromkeys(scenarios))
    with own_folder(out, sha256_json([__version__, *unique_scenarios])) as progress:
        folder = progress.folder
        if folder != out:
            console.note(f"another demonstration works in {out}; this one goes to {folder}")
        console.note("the physical sessions are a software stand-in, not a vehicle")
        make_folder(folder / "clips")
        steps = plan_steps(folder, unique_scenarios)
        earlier_steps = progress.finished_steps(steps)
        if earlier_steps:
            console.note(f"{len(earlier_steps)} of {len(steps)} steps were finished before")

        with console.progress("demo", len(steps)) as bar:

            def on_end(step: Step) -> None:
                progress.finish(step)
                bar.advance(bar.task_ids[0])

            bar.advance(bar.task_ids[0], len(earlier_steps))
            gaps = follow(
                steps,
                make_folder(folder / LOGS),
                on_start=lambda step, number: _tell(bar, step, number, len(steps)),
                on_end=on_end,
                earlier_steps=earlier_steps,
            )
        progress.wall_s = time.monotonic() - started
        progress.complete = not gaps
        progress.write()
    below = imperfect_controls(folder) if all(gap.step.name != "evaluate" for gap in gaps) else []
    _conclude(progress, gaps, below, as_json)
    return 1 if gaps or below else 0


def imperfect_controls(folder: Path) -> list[str]:
    """Name the cells in which answers made of the labels themselves score below 1.

    Such a cell says that the harness loses what a model says, so no other score can be trusted.
    Semantics and actions are looked at; a trajectory may leave no response possible.

    Args:
        folder: of the demonstration.
    """
    return [
        f"{cell.id}: perfect answers have {metric} {value:.3f} instead of 1"
        for cell in load_cells(folder)
        if cell.facts.backend == "perfect" and not cell.facts.condition and cell.score is not None
        for metric in ("sem_acc_eff", "act_acc_eff", "cia_eff")
        if (value := getattr(cell.score, metric)) is not None and value < _WHOLE
    ]


def _conclude(progress: Progress, gaps: Sequence[Gap], below: Sequence[str], as_json: bool) -> None:
    """Say what was made, what is missing, and which control isn't what it should be."""
    for line in below:
        console.report_error(line)
    missing = {gap.step.name for gap in gaps}
    index, package = progress.folder / "index.html", package_folder(progress.folder)
    for gap in gaps:
        console.report_error(f"{gap.step.title}: {gap.why}")
    if as_json:
        summary = {
            "report": str(index) if "report" not in missing else None,
            "package": str(package) if "verify" not in missing else None,
            "wall_s": round(progress.wall_s, 1),
            "missing": {gap.step.name: gap.why for gap in gaps},
            "imperfect": list(below),
        }
        click.echo(json.dumps(summary))
        return
    lack = f" with {len(gaps)} of its steps missing" if gaps else ""
    if "report" not in missing:
        line = f"done in {progress.wall_s:.0f} s{lack}; open {index}"
        console.out.print(line, markup=False)
    if "verify" not in missing:
        console.out.print(f"evidence package, verified: {package}", markup=False)
    if gaps:
        console.out.print("give the same command again to do what is missing", markup=False)


def _tell(bar: ProgressBar, step: Step, number: int, total: int) -> None:
    bar.update(bar.task_ids[0], description=step.title)
    if not sys.stderr.isatty():
        console.note(f"[{number}/{total}] {step.title}")
