"""The one way in which this package compiles kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numpy.typing import NDArray

Array = NDArray[Any]


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles with numba on the first call and keeps the machine code on disk.

    The interpreter lock is released while the kernel runs, so that a node's executor stays
    responsive; one thread, so that the order of operations and with it every pixel is fixed.
    """
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """As compiled, for small helpers of inner loops: callers take them in whole."""
    return numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function)
