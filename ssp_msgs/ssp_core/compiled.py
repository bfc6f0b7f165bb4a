"""The compiled core: modules of a session as machine code, where this environment has them.

``./ssp build-core`` compiles some modules, from the same sources, into a folder of the environment.
They are imported from there as long as each of their sources is what was compiled; otherwise all of
them are interpreted. ``SSP_INTERPRETED=1`` has them interpreted in any case.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

FOLDER = Path(sys.prefix) / "ssp-compiled"
TABLE = "table.json"
OFF = "SSP_INTERPRETED"


@dataclass(frozen=True, slots=True)
class CompiledCore:
    """The compiled modules of one environment.

    Args:
        python: version of the interpreter that they are for.
        files: file of each module, by its full name.
        sources: SHA-256 of each source, by its path from the folder of a package's folder.
    """

    python: str
    files: dict[str, Path]
    sources: dict[str, str]

    @staticmethod
    def read(folder: Path) -> CompiledCore | None:
        """Read the table of a folder; None where there is none, or it can't be read."""
        try:
            table: Any = json.loads((folder / TABLE).read_text("utf-8"))
            files = {name: folder / file for name, file in table["files"].items()}
            return CompiledCore(str(table["python"]), files, dict(table["sources"]))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def stale(self, path: Sequence[str]) -> str:
        """Say why the modules may not be taken; empty where they may.

        Args:
            path: the folders in which packages are looked for, as ``sys.path``.
        """
        if self.python != sys.version:
            return "it was compiled for another Python"
        for name, sha256 in self.sources.items():
            source = next((p for p in (Path(one, name) for one in path) if p.is_file()), None)
            if source is None or hashlib.sha256(source.read_bytes()).hexdigest() != sha256:
                return f"{name} isn't the source that was compiled"
        return ""


class CompiledFinder(MetaPathFinder):
    """Finds the modules of a compiled core; looks at their sources once, at the first of them."""

    def __init__(self, core: CompiledCore) -> None:
        self._core = core
        self._fresh: bool | None = None

    def find_spec(
        self, fullname: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a compiled module; None: it is imported as any other."""
        file = self._core.files.get(fullname)
        if file is None:
            return None
        if self._fresh is None:
            self._fresh = not self._core.stale(sys.path)
        return spec_from_file_location(fullname, file) if self._fresh else None


def use_compiled(folder: Path = FOLDER) -> None:
    """Import compiled modules from a folder from now on, if it holds some."""
    if os.environ.get(OFF) or not (folder / TABLE).is_file():
        return
    core = CompiledCore.read(folder)
    if core is not None:
        sys.meta_path.insert(0, CompiledFinder(core))


def state_of_core(folder: Path = FOLDER) -> str:
    """Say in words whether sessions run compiled."""
    if os.environ.get(OFF):
        return f"not used ({OFF} is set)"
    if not (folder / TABLE).is_file():
        return "none: sessions are interpreted"
    core = CompiledCore.read(folder)
    if core is None:
        return "can't be read: sessions are interpreted"
    stale = core.stale(sys.path)
    return f"out of date, sessions are interpreted: {stale}" if stale else "sessions run compiled"
