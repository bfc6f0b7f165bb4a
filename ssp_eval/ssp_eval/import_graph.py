"""The import graph of a source checkout: which tests a change can reach.

The graph is read from the sources, nothing is imported. An edge is an import, at the top of a file
or inside a function; a verb of the command line or a module that is named in a string, which is
how commands load and nodes start; the name of a file of data; and the ``conftest.py`` files above a
test. It may hold more edges than needed, and misses what a program puts together at run time.
"""

from __future__ import annotations

import ast
import tomllib
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from ssp_core.cli import VERBS


def read_graph(root: Path, files: Collection[str]) -> dict[str, set[str]]:
    """Read which files of a checkout each Python file depends on.

    Args:
        root: folder of the checkout.
        files: its files, relative to ``root`` with ``/``, Python and others.

    Returns:
        For each Python file the files that it depends on, itself left out. A file that can't be
        parsed depends on nothing.
    """
    sources = [file for file in files if file.endswith(".py")]
    modules = _modules(root, sources)
    verbs = {verb: place.partition(":")[0] for verb, (place, _) in VERBS.items()}
    data = _data(files)
    all_files = set(files)
    graph: dict[str, set[str]] = {}
    for file in sources:
        dependencies = {f for f in _conftests(file) if f in all_files}
        try:
            nodes = list(ast.walk(ast.parse((root / file).read_text())))
        except (SyntaxError, ValueError, OSError):
            nodes = []
        for name in _imports(nodes, _package(file, modules)):
            dependencies |= _files_of(name, modules)
        # A package names the modules of its public API, and loads one when somebody asks for it.
        for text in () if file.endswith("/__init__.py") else _strings(nodes):
            dependencies |= _files_of(text.partition(":")[0], modules)
            dependencies |= data.get(text.rpartition("/")[2], set())
        for text in _first_words(nodes):
            dependencies |= _files_of(verbs.get(text, ""), modules)
        graph[file] = dependencies - {file}
    return graph


def distances(graph: Mapping[str, Collection[str]], changed: Collection[str]) -> dict[str, int]:
    """Count, for each file that changed files reach, the fewest edges between them.

    Returns:
        The changed files themselves with 0, and whatever depends on them, nearest first; files of
        one distance in the order of their names.
    """
    users: dict[str, set[str]] = {}
    for file, others in graph.items():
        for other in others:
            users.setdefault(other, set()).add(file)
    edge_counts = dict.fromkeys(sorted(changed), 0)
    waiting = deque(edge_counts)
    while waiting:
        file = waiting.popleft()
        for user in sorted(users.get(file, ())):
            if user not in edge_counts:
                edge_counts[user] = edge_counts[file] + 1
                waiting.append(user)
    return edge_counts


def keep_tests(files: Collection[str]) -> list[str]:
    """Keep the test modules, in the given order."""
    return [f for f in files if f.rpartition("/")[2].startswith("test_") and f.endswith(".py")]


def _roots(root: Path) -> list[str]:
    """Return folders that modules are imported from, the longest first."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["tool"]
    roots = {*project["pytest"]["ini_options"]["pythonpath"], *project["mypy"]["mypy_path"]}
    return sorted((r for r in roots if r != "."), key=len, reverse=True)


def _modules(root: Path, sources: Collection[str]) -> dict[str, str]:
    """Map each name that a source file can be imported by to the file."""
    roots = _roots(root)
    modules: dict[str, str] = {}
    for file in sources:
        for folder in (*roots, ""):
            start = f"{folder}/" if folder else ""
            if file.startswith(start):
                name = file.removeprefix(start).removesuffix(".py").removesuffix("/__init__")
                modules.setdefault(name.replace("/", "."), file)
    return modules


def _package(file: str, modules: Mapping[str, str]) -> str:
    """Name the package that relative imports of a file start from."""
    name = next((name for name, of in modules.items() if of == file), "")
    return name if file.endswith("/__init__.py") else name.rpartition(".")[0]


def _imports(nodes: Sequence[ast.AST], package: str) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            start = node.module or ""
            if node.level:
                parts = package.split(".")
                start = ".".join([*parts[: len(parts) - node.level + 1], *filter(None, [start])])
            yield start
            yield from (f"{start}.{alias.name}" for alias in node.names)


def _strings(nodes: Sequence[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def _first_words(nodes: Sequence[ast.AST]) -> Iterator[str]:
    """Yield the strings that a list or tuple begins with, as the arguments of a command do."""
    for node in nodes:
        if isinstance(node, ast.List | ast.Tuple) and node.elts:
            first = node.elts[0]
            if isinstance(first, ast.Constant) and isinstance(first.value, str):
                yield first.value


def _files_of(name: str, modules: Mapping[str, str]) -> set[str]:
    """Find a module's file and those of the packages around it, which run first."""
    if name not in modules:
        return set()
    parts = name.split(".")
    names = (".".join(parts[: n + 1]) for n in range(len(parts)))
    return {modules[n] for n in names if n in modules}


def _data(files: Collection[str]) -> dict[str, set[str]]:
    """Map the names by which sources speak of a file of data to it.

    They are its name, that of its folder, and for YAML, which holds events and sites, also the name
    without the ending.
    """
    files_by_name: dict[str, set[str]] = {}
    for file in files:
        path = Path(file)
        if path.suffix != ".py":
            names = {path.name, path.parent.name}
            if path.suffix == ".yaml":
                names.add(path.name.partition(".")[0])
            for name in names - {""}:
                files_by_name.setdefault(name, set()).add(file)
    return files_by_name


def _conftests(file: str) -> Iterator[str]:
    for folder in Path(file).parents:
        yield str(folder / "conftest.py")
