"""Runs the steps of a plan: what doesn't depend on each other side by side, and all ends in order.

At most two steps run at once, and at most one of them is a session. A session in lockstep gives
the same recording however busy the host is, so a clip may well be drawn beside it.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_core.console import on_stop_signals
from ssp_core.errors import PeerError
from ssp_core.processes import die_with_parent
from ssp_eval.demo.plan import Step

END_TIMEOUT_S = 30.0
AT_ONCE = 2
_POLL_S = 0.02
_TAIL = 15


@dataclass(frozen=True, slots=True)
class _Running:
    """A step's process and its log file."""

    step: Step
    process: subprocess.Popen[bytes]
    log: Path


class _Interrupted(Exception):
    """Somebody wants it to end; the steps that run are to end in order first."""


def _raise_interrupted(_: signal.Signals) -> None:
    raise _Interrupted


def follow(
    steps: Sequence[Step],
    logs: Path,
    on_start: Callable[[Step, int], None],
    on_end: Callable[[Step], None],
) -> None:
    """Runs all steps.

    Each step is a process group of its own, so that Ctrl-C reaches it once and through here: it is
    told, and given the time to abort its session and to close its bag.

    Args:
        steps: each needs only ones before it.
        logs: folder that gets command and output of each step.
        on_start: told each step and its number, from 1, when it starts.
        on_end: told each step that is done.

    Raises:
        PeerError: a step failed or was interrupted; the message ends with the last lines of its
            output.
    """
    waiting, running, done = list(steps), list[_Running](), set[str]()
    with on_stop_signals(_raise_interrupted):
        try:
            while waiting or running:
                while (step := _next(waiting, running, done)) is not None:
                    waiting.remove(step)
                    on_start(step, len(steps) - len(waiting))
                    running.append(_start(step, logs))
                ended = [one for one in running if one.process.poll() is not None]
                for one in ended:
                    running.remove(one)
                    _check(one)
                    done.add(one.step.name)
                    on_end(one.step)
                if not ended:
                    time.sleep(_POLL_S)
        except _Interrupted:
            titles = ", ".join(one.step.title for one in running)
            _end_all(running)
            raise PeerError(f"{titles}: interrupted") from None
        except BaseException:
            _end_all(running)
            raise


def _next(waiting: Sequence[Step], running: Sequence[_Running], done: set[str]) -> Step | None:
    """The first step that may start now; sessions first, since they take longest."""
    if len(running) >= AT_ONCE:
        return None
    ready = [step for step in waiting if done.issuperset(step.needs)]
    sessions = [step for step in ready if step.session]
    if sessions and not any(one.step.session for one in running):
        return sessions[0]
    return next((step for step in ready if not step.session), None)


def _start(step: Step, logs: Path) -> _Running:
    log = logs / f"{step.name.replace('/', '-')}.log"
    with log.open("wb") as stream:
        stream.write(f"$ {' '.join(step.command('python'))}\n".encode())
        stream.flush()
        process = subprocess.Popen(
            step.command(sys.executable),
            stdout=stream,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
    return _Running(step, process, log)


def _check(one: _Running) -> None:
    """Raises PeerError for a step that failed."""
    status = one.process.returncode
    if status != 0:
        tail = "\n".join(one.log.read_text(errors="replace").splitlines()[-_TAIL:])
        raise PeerError(f"{one.step.title}: failed with status {status}\n{tail}")


def _end_all(running: Sequence[_Running]) -> None:
    """Asks the steps to end and waits for them; one that doesn't is killed."""
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
