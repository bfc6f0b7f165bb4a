"""The compiled core: modules of a session as machine code, where this environment has them.

``./ssp build-core`` compiles some modules, from the same sources, into a folder of the environment.
They are imported from there as long as nothing changed of which they were made: each source of the
packages that they belong to, since one that isn't compiled has types that compiled ones rely on,
the script, the compiler and Python. Otherwise all of them are interpreted. ``SSP_INTERPRETED=1``
has them interpreted in any case. No variable names another folder: code comes from here alone.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

FOLDER = Path(sys.prefix) / "ssp-compiled"
TABLE = "table.json"
OFF = "SSP_INTERPRETED"
# The script by which the core is compiled.
RECIPE = Path(__file__).parents[2] / "bootstrap" / "compile_core.py"


def _python_files(folder: str) -> Iterator[str]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir():
                yield from _python_files(entry.path)
            elif entry.name.endswith(".py") and entry.is_file():
                yield entry.path


def hash_of(file: str | Path) -> str:
    """Return the SHA-256 of a file."""
    with open(file, "rb", buffering=0) as opened:
        return hashlib.sha256(opened.readall()).hexdigest()


def sources_of(package: Path) -> dict[str, str]:
    """Return the SHA-256 of each Python source of a package, by its path from the folder beside.

    Raises:
        OSError: one can't be read.
    """
    start = len(str(package)) - len(package.name)
    return {file[start:]: hash_of(file) for file in _python_files(str(package))}


@dataclass(frozen=True, slots=True)
class CompiledCore:
    """The compiled modules of one environment.

    Args:
        python: version of the interpreter that they are for.
        mypy: version of the compiler.
        recipe: SHA-256 of the script that compiled them.
        files: file of each module, by its full name.
        sources: SHA-256 of each source of their packages, by its path from the folder that a
            package lies in.
        sha256: of the table, which holds all of these.
    """

    python: str
    mypy: str
    recipe: str
    files: dict[str, Path]
    sources: dict[str, str]
    sha256: str

    @staticmethod
    def read(folder: Path) -> CompiledCore | None:
        """Read the table of a folder; None where there is none, or it can't be read."""
        try:
            content = (folder / TABLE).read_bytes()
            table: Any = json.loads(content)
            files = {name: folder / file for name, file in table["files"].items()}
            python, mypy, recipe = (str(table[key]) for key in ("python", "mypy", "recipe"))
            sha256 = hashlib.sha256(content).hexdigest()
            return CompiledCore(python, mypy, recipe, files, dict(table["sources"]), sha256)
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return None

    def stale(self, path: Sequence[str]) -> str:
        """Say why the modules may not be taken; empty where they may.

        Args:
            path: the folders in which packages are looked for, as ``sys.path``.
        """
        if self.python != sys.version:
            return "it was compiled for another Python"
        for file in self.files.values():
            if not file.is_file():
                return f"{file} is missing"
        # Reading a package's metadata takes longer than all else here.
        if not any(Path(one, f"mypy-{self.mypy}.dist-info").is_dir() for one in path):
            return f"mypy {self.mypy}, which compiled it, isn't installed"
        try:
            if hash_of(RECIPE) != self.recipe:
                return f"{RECIPE.name} isn't the script that compiled it"
            now = self._sources_now(path)
        except OSError as error:
            return f"{error.filename} can't be read: {error.strerror}"
        for name in sorted(now.keys() | self.sources.keys()):
            if now.get(name) != self.sources.get(name):
                return f"{name} isn't what it was when the core was compiled"
        return ""

    def _sources_now(self, path: Sequence[str]) -> dict[str, str]:
        sources: dict[str, str] = {}
        for package in {name.split("/", 1)[0] for name in self.sources}:
            folders = (Path(one, package) for one in path)
            folder = next((one for one in folders if (one / "__init__.py").is_file()), None)
            sources |= {} if folder is None else sources_of(folder)
        return sources


class CompiledFinder:
    """Finds the modules of a compiled core; looks at their sources once, at the first of them."""

    def __init__(self, core: CompiledCore) -> None:
        self._core = core
        self._fresh: bool | None = None

    def find_spec(
        self, fullname: str, _path: Sequence[str] | None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the spec of a compiled module; None: it is imported as any other."""
        file = self._core.files.get(fullname)
        if file is None or not file.is_file():
            return None
        return spec_from_file_location(fullname, file) if self.is_fresh else None

    @property
    def is_fresh(self) -> bool:
        """Tell whether the modules are taken from the core."""
        if self._fresh is None:
            self._fresh = not self._core.stale(sys.path)
        return self._fresh

    @property
    def sha256(self) -> str:
        """The hash of the core's table."""
        return self._core.sha256


def use_compiled() -> None:
    """Import compiled modules from now on, if this environment has some."""
    if not os.environ.get(OFF):
        use_core_of(FOLDER)


def use_core_of(folder: Path) -> None:
    """Import the compiled modules of a folder from now on, if it has some."""
    if not (folder / TABLE).is_file():
        return
    core = CompiledCore.read(folder)
    if core is not None:
        sys.meta_path.insert(0, CompiledFinder(core))


def core_in_use() -> str | None:
    """Return the hash of the compiled core that this process uses; None: it is interpreted."""
    finders = (one for one in sys.meta_path if isinstance(one, CompiledFinder))
    return next((one.sha256 for one in finders if one.is_fresh), None)


def state_of_core() -> str:
    """Say in words whether sessions run compiled."""
    if os.environ.get(OFF):
        return f"not used ({OFF} is set)"
    if not (FOLDER / TABLE).is_file():
        return "none: sessions are interpreted"
    core = CompiledCore.read(FOLDER)
    if core is None:
        return "can't be read: sessions are interpreted"
    stale = core.stale(sys.path)
    return f"out of date, sessions are interpreted: {stale}" if stale else "sessions run compiled"
