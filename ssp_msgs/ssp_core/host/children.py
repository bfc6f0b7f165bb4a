"""Starts of processes by others of ours: arguments, names, and for how long a child lives."""

from __future__ import annotations

import ctypes
import signal

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


def call_process(name: str) -> None:
    """Give this process the name (its first 15 bytes) that ``ps -e`` and ``top`` show."""
    _LIBC.prctl(_PR_SET_NAME, name.encode())
