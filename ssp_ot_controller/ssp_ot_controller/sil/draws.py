"""Seeded random numbers: a stream per seed, object and purpose, drawn in blocks."""

from __future__ import annotations

import zlib
from collections.abc import Iterator

import numpy as np

_BLOCK = 256


def _generator(seed: int, name: str, purpose: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(f"{name}/{purpose}".encode())])


def uniforms(seed: int, name: str, purpose: str) -> Iterator[float]:
    """Numbers in [0, 1), the same for the same seed, name and purpose."""
    random = _generator(seed, name, purpose)
    while True:
        yield from random.random(_BLOCK).tolist()


def normals(seed: int, name: str, purpose: str) -> Iterator[float]:
    """Standard normal numbers, the same for the same seed, name and purpose."""
    random = _generator(seed, name, purpose)
    while True:
        yield from random.standard_normal(_BLOCK).tolist()
