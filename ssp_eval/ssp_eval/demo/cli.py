"""``ssp demo``: the whole way from scenario to report in one command."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import click
from rich.progress import Progress

from ssp_core import console
from ssp_core.errors import InputError, PeerError
from ssp_core.files import make_folder, write_json
from ssp_core.hashing import sha256_bytes
from ssp_core.processes import die_with_parent
from ssp_eval.demo import plan

MARKER = ".ssp-demo.json"
SCHEMA = "ssp.demo/1"
# All that a demonstration leaves in its folder.
MADE = frozenset(
    {MARKER, "cells", "clips", "frames", "logs", "runs", "demo.log", "index.html", "requests"}
)
END_TIMEOUT_S = 30.0
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_TAIL = 15


@contextmanager
def _own_folder(out: Path) -> Iterator[Path]:
    """The folder, or the next free number beside it while another demonstration works there.

    Raises:
        InputError: it holds something that no demonstration made.
    """
    for number in range(1, 100):
        folder = out if number == 1 else out.with_name(f"{out.name}-{number}")
        handle = os.open(_lock_file(folder), os.O_CREAT | os.O_RDONLY, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            _clear(folder)
            write_json(folder / MARKER, {"schema": SCHEMA})
            yield folder
        finally:
            os.close(handle)
        return
    raise InputError("and 98 folders beside it are in use", file=out)


def _lock_file(folder: Path) -> Path:
    """A lock that lies beside nobody's files."""
    locks = Path(tempfile.gettempdir()) / "ssp-demos"
    if not locks.is_dir():
        locks.mkdir(exist_ok=True)
        locks.chmod(0o1777)  # for all users of the host
    return locks / sha256_bytes(str(folder.resolve()).encode()).removeprefix("sha256:")[:32]


def _clear(folder: Path) -> None:
    """Makes the folder, or empties it of what an earlier demonstration left, and of nothing else.

    Raises:
        InputError: it can't be made, or holds something that no demonstration made.
    """
    found = {entry.name for entry in make_folder(folder).iterdir()}
    foreign = sorted(found - MADE)
    if foreign or (found and not _is_ours(folder / MARKER)):
        raise InputError(
            "holds something that no demonstration made",
            file=folder,
            value=", ".join(foreign) or None,
            remedy="name another folder with --out",
        )
    for name in found:
        path = folder / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()


def _is_ours(marker: Path) -> bool:
    try:
        value = json.loads(marker.read_text())
    except (OSError, ValueError):
        return False
    return isinstance(value, dict) and value.get("schema") == SCHEMA


class _Interrupted(Exception):
    """SIGINT or SIGTERM came; the step that runs is to end in order first."""


def _raise_interrupted(number: int, frame: FrameType | None) -> None:
    raise _Interrupted


def _run(step: plan.Step, log: Path) -> None:
    """Runs one step with its output in a log file.

    The step is a process group of its own, so that Ctrl-C reaches it once and through here: it is
    told, and given the time to abort its session and to close its bag.

    Raises:
        PeerError: it failed or was interrupted; the message ends with the last lines of its output.
    """
    with log.open("ab") as stream:
        stream.write(f"\n$ {' '.join(step.command('python'))}\n".encode())
        stream.flush()
        process = subprocess.Popen(
            step.command(sys.executable),
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
        before = {n: signal.signal(n, _raise_interrupted) for n in _SIGNALS}
        try:
            status = process.wait()
        except _Interrupted:
            for number in _SIGNALS:
                signal.signal(number, signal.SIG_IGN)
            _end(process)
            raise PeerError(f"{step.title}: interrupted") from None
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
    if status != 0:
        tail = "\n".join(log.read_text(errors="replace").splitlines()[-_TAIL:])
        raise PeerError(f"{step.title}: failed with status {status}\n{tail}")


def _end(process: subprocess.Popen[bytes]) -> None:
    """Asks a step to end and waits for it; a step that doesn't is killed."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(END_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


class _Follower:
    """Runs steps one after the other and shows where it is."""

    def __init__(self, bar: Progress, total: int, log: Path) -> None:
        self._bar, self._total, self._log = bar, total, log
        self._task = bar.task_ids[0]
        self._number = 0

    def run(self, steps: Sequence[plan.Step]) -> None:
        for step in steps:
            self._number += 1
            self._bar.update(self._task, description=step.title)
            if not sys.stderr.isatty():
                console.note(f"[{self._number}/{self._total}] {step.title}")
            _run(step, self._log)
            self._bar.advance(self._task)


@click.command()
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/demo"),
    show_default=True,
    help="Folder for everything; an earlier demonstration there is replaced.",
)
@click.option("--json", "as_json", is_flag=True, help="Print a summary as JSON.")
def demo(out: Path, as_json: bool) -> int:
    """Run both scenarios in three domains, ask two bridges, score, and write a report.

    The `physical` sessions are a software stand-in on another site with disturbances: no vehicle
    moves, and no figure of this demonstration says anything about one.
    """
    from ssp_scenario_manager.scenario import load_scenario

    started = time.monotonic()
    versions = {name: load_scenario(name)[1] for name in plan.SCENARIOS}
    with _own_folder(out) as folder:
        if folder != out:
            console.note(f"another demonstration works in {out}; this one goes to {folder}")
        console.note("the physical sessions are a software stand-in, not a vehicle")
        (folder / "clips").mkdir()
        before, after = plan.clip_steps(folder), plan.scoring_steps(folder)
        recorded = plan.recording_steps(folder, versions, dict.fromkeys(versions, ()))
        total = len(before) + len(recorded) + len(after)
        with console.progress("demo", total) as bar:
            follow = _Follower(bar, total, folder / "demo.log")
            follow.run(before)
            declared = {
                name: plan.declared_options(plan.clip_path(folder, name)) for name in versions
            }
            follow.run(plan.recording_steps(folder, versions, declared))
            follow.run(after)
        seconds = time.monotonic() - started
        index = folder / "index.html"
        write_json(folder / MARKER, {"schema": SCHEMA, "wall_s": round(seconds, 1)})
    if as_json:
        click.echo(json.dumps({"report": str(index), "wall_s": round(seconds, 1)}))
    else:
        console.out.print(f"done in {seconds:.0f} s; open {index}", markup=False)
    return 0
