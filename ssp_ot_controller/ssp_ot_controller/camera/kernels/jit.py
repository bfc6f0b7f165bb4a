"""The one way in which this package compiles kernels, and where it keeps the machine code.

numba's cache looks only at the file of the function that it compiled, not at the files of the
functions that went into it. Here the cache lies in a folder named after the contents of all
sources of the camera, so that no change is ever answered with old machine code.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numpy.typing import NDArray

from ssp_core.hashing import sha256_sources

Array = NDArray[Any]

_CAMERA = Path(__file__).parent.parent
_PREFIX = "kernels-"
_SETTINGS: Any = numba.config  # its attributes are made at run time


def digest(folder: Path) -> str:
    """Return a short hash of the names and contents of the Python files below a folder."""
    return sha256_sources(folder).removeprefix("sha256:")[:16]


def cache_folder(sources: Path, places: list[Path]) -> Path | None:
    """Return the folder for the machine code of these sources, in the first writable place.

    Folders of earlier sources in the same place are removed. None: no place can be written, and
    kernels are compiled anew in each process.
    """
    name = _PREFIX + digest(sources)
    for place in places:
        try:
            (place / name).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if not os.access(place / name, os.W_OK):
            continue
        for old in place.glob(_PREFIX + "*"):
            if old.name != name:
                shutil.rmtree(old, ignore_errors=True)
        return place / name
    return None


def _places() -> list[Path]:
    if _SETTINGS.CACHE_DIR:  # NUMBA_CACHE_DIR
        return [Path(_SETTINGS.CACHE_DIR)]
    home = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return [_CAMERA / "__pycache__", home / "ssp"]


_CACHE = cache_folder(_CAMERA, _places())


# Without numba's memory management ("nrt"): it counts references to arrays in the innermost loops,
# with atomic instructions, which took half of a frame's time. Kernels allocate nothing.
_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}


def _jit(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    before = _SETTINGS.CACHE_DIR
    try:
        _SETTINGS.CACHE_DIR = str(_CACHE or before)
        njit: Any = numba.njit
        make = njit(cache=_CACHE is not None, **_OPTIONS, **options)
        kernel: Callable[..., Any] = make(function)
        return kernel
    finally:
        _SETTINGS.CACHE_DIR = before


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile with numba on the first call and keep the machine code on disk.

    The interpreter lock is released while the kernel runs, so that a node's executor stays
    responsive; one thread, so that the order of operations and with it every pixel is fixed.
    A kernel can't make arrays: what it needs beside its input is handed to it.
    """
    return _jit(function)


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a small helper of inner loops so that callers inline it."""
    return _jit(function, forceinline=True)
