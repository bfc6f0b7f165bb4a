"""Content hashes: the one form in which versions and links are written, ``sha256:<hex>``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

# Of a file that is hashed.
BLOCK_BYTES = 1 << 16


def sha256_bytes(data: bytes) -> str:
    """Return the hash ``sha256:<hex>`` of the bytes."""
    return "sha256:" + hashlib.sha256(data).hexdigest()


def canonical_json(value: Any) -> bytes:
    """Return the same bytes for the same value: sorted keys, no spaces, UTF-8, no NaN.

    Raises:
        ValueError: the value holds a NaN or an infinity.
    """
    return json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    ).encode()


def sha256_json(value: Any) -> str:
    """Hash of the canonical JSON of a value, whatever the order of its keys."""
    return sha256_bytes(canonical_json(value))


def sha256_file(path: str | Path, on_block: Callable[[], None] = lambda: None) -> str:
    """Return the hash of a file's bytes, read in blocks.

    Args:
        path: of the file.
        on_block: called for each block; what it raises ends the reading.
    """
    digest = hashlib.sha256()
    with open(path, "rb") as stream:
        while block := stream.read(BLOCK_BYTES):
            on_block()
            digest.update(block)
    return "sha256:" + digest.hexdigest()


def sha256_sources(folder: Path) -> str:
    """Hash of the names and contents of the Python files below a folder."""
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder)} {len(content)}\n".encode() + content)
    return "sha256:" + digest.hexdigest()
