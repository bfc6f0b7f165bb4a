"""``ssp demo``: the whole way from scenario to report in one command."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
from rich.progress import Progress

from ssp_core import console
from ssp_core.errors import InputError, PeerError
from ssp_core.files import write_json
from ssp_eval.demo import plan

MARKER = "demo.json"
_TAIL = 15


@contextmanager
def _own_folder(out: Path) -> Iterator[Path]:
    """The folder, or the next free number beside it while another demonstration works there.

    Raises:
        InputError: it holds something that no demonstration made.
    """
    for number in range(1, 100):
        folder = out if number == 1 else out.with_name(f"{out.name}-{number}")
        folder.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder.with_name(f".{folder.name}.lock"), os.O_CREAT | os.O_RDWR, 0o644)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            continue
        try:
            if folder.exists() and any(folder.iterdir()) and not (folder / MARKER).is_file():
                raise InputError(
                    "is not empty and not from a demonstration",
                    file=folder,
                    remedy="name another folder with --out",
                )
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            write_json(folder / MARKER, {"schema": "ssp.demo/1"})
            yield folder
        finally:
            os.close(handle)
        return
    raise InputError("and 98 folders beside it are in use", file=out)


def _run(step: plan.Step, log: Path) -> None:
    """Runs one step with its output in a log file.

    Raises:
        PeerError: it failed; the message ends with the last lines of its output.
    """
    with log.open("ab") as stream:
        stream.write(f"\n$ {' '.join(step.command('python'))}\n".encode())
        stream.flush()
        done = subprocess.run(
            step.command(sys.executable),
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    if done.returncode != 0:
        tail = "\n".join(log.read_text(errors="replace").splitlines()[-_TAIL:])
        raise PeerError(f"{step.title}: failed with status {done.returncode}\n{tail}")


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
        write_json(folder / MARKER, {"schema": "ssp.demo/1", "wall_s": round(seconds, 1)})
    if as_json:
        click.echo(json.dumps({"report": str(index), "wall_s": round(seconds, 1)}))
    else:
        console.out.print(f"done in {seconds:.0f} s; open {index}", markup=False)
    return 0
