"""Starts of processes by others of ours: arguments, names, and for how long a child lives."""

from __future__ import annotations

import ctypes
import os
import signal
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.context import ForkContext, SpawnContext

# Between Python and the name of a module of ours. Without -P the working folder comes before all
# packages, and what lies there under the name of one would run.
AS_MODULE = ("-P", "-m")

_PR_SET_PDEATHSIG, _PR_SET_NAME = 1, 15
# Loaded here: between fork and exec as little as possible may happen.
_LIBC = ctypes.CDLL(None)


def die_with_parent() -> None:
    """Let a child receive SIGTERM when its parent dies, however that happens.

    For its preexec_fn.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def outlive_parent() -> None:
    """Let this process go on after the parent that it was to die with."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, 0)


def worker_context() -> ForkContext | SpawnContext:
    """Choose how workers are started: forked with all imports, where this process has one thread.

    A fork would take along the locks of further threads; beside these, workers are fresh
    interpreters, which import for a second each.
    """
    from multiprocessing import get_context  # no node needs it

    is_alone = len(os.listdir("/proc/self/task")) == 1
    return get_context("fork") if is_alone else get_context("spawn")


def call_process(name: str) -> None:
    """Give this process the name (its first 15 bytes) that ``ps -e`` and ``top`` show."""
    _LIBC.prctl(_PR_SET_NAME, name.encode())
