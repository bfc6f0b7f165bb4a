"""Work on a source checkout: ``ssp test``, ``ssp check``, ``ssp docs``, ``ssp build-core``."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import click

from ssp_core import console
from ssp_core.compiled import FOLDER, OFF, state_of_core
from ssp_core.errors import HostError, InputError
from ssp_core.files.folders import make_folder, remove_folder
from ssp_core.options import WholeNumber
from ssp_eval.import_graph import distances, keep_tests, read_graph

PACKAGES = (
    "ssp_msgs/ssp_core",
    "ssp_scenario_manager/ssp_scenario_manager",
    "ssp_ot_controller/ssp_ot_controller",
    "ssp_monitor/ssp_monitor",
    "ssp_vla_bridge/ssp_vla_bridge",
    "ssp_eval/ssp_eval",
)

# Leaves out the tests that run whole sessions, browsers or clusters.
QUICK = ("-m", "not system and not programs")
# In the order of tests/support/order.py.
WHOLE_FILES = ("--dist", "loadfile", "--no-loadscope-reorder")
# Where the language model of --real-model lies, and the variable that tells its tests so.
MODEL_FOLDER = ".venv/real-model"
MODEL_VARIABLE = "SSP_REAL_MODEL"
PYTEST = [sys.executable, "-m", "pytest"]
# Of those that a change reaches: if all were read first, the nearest would start a minute late.
FILES_AT_ONCE = 20
MKDOCS = [sys.executable, "-m", "mkdocs"]
DOCS_TOOLS = [sys.executable, "bootstrap/bootstrap.py", "--docs-tools"]
TOOLS = [sys.executable, "bootstrap/bootstrap.py", "--test-tools"]
COMPILE = [sys.executable, "bootstrap/compile_core.py"]


def _checks(
    arguments: tuple[str, ...], quick: bool, real_model: bool
) -> list[tuple[str, list[str]]]:
    tools = ("tools", TOOLS)
    pytest = [*PYTEST, "--durations=50", "--durations-min=0.5"]
    if real_model:
        folder = "tests/real_model"
        return [
            tools,
            ("model", [sys.executable, f"{folder}/install.py", MODEL_FOLDER]),
            ("tests with a real model", [*pytest, "-m", "real_model", folder, *arguments]),
        ]
    checks = [
        tools,
        ("format", ["ruff", "format", "--check", "."]),
        ("lint", ["ruff", "check", "."]),
        ("types", ["mypy", *PACKAGES]),
    ]
    test_command = [*pytest, *(QUICK if quick else ())]
    if arguments:
        return [*checks, ("tests", [*test_command, *arguments])]
    # Tests of nodes wait for processes more than they work: two workers more than there are
    # processors. A worker takes whole files, since what a file's tests share is made once then.
    at_once = str((os.cpu_count() or 1) + 2)
    return [
        *checks,
        ("tools of the site", DOCS_TOOLS),
        ("site", [*MKDOCS, "build", "--strict", "--site-dir", "log/site"]),
        ("tests", [*test_command, *WHOLE_FILES, "-n", at_once]),
    ]


def _root(work: str) -> Path:
    """Return the folder of the checkout, which the launcher names."""
    root = os.environ.get("SSP_ROOT")
    if root is None or not (Path(root) / "pyproject.toml").is_file():
        raise HostError(f"{work} the source checkout: start it with ./ssp")
    return Path(root)


def _run(command: Sequence[str], root: Path, environment: Mapping[str, str]) -> int:
    """Run a command to its end; an interrupt ends the compilation first, which tidies up."""
    if command != COMPILE:
        return subprocess.run(command, cwd=root, env=environment, check=False).returncode
    # A group of its own: Ctrl-C reaches this process alone, and the compilers by it.
    with subprocess.Popen(command, cwd=root, env=environment, process_group=0) as process:
        try:
            return process.wait()
        except KeyboardInterrupt:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()
            raise


def _run_all(
    root: Path, checks: Sequence[tuple[str, list[str]]], nothing: Collection[int] = ()
) -> int:
    """Run all commands, whatever the earlier ones ended with; 1 when any failed, else 0.

    Args:
        root: folder of the checkout.
        checks: name and command of each.
        nothing: further statuses that are no failure: pytest ends with 5 where nothing is chosen.
    """
    environment = dict(os.environ)
    environment[MODEL_VARIABLE] = str(root / MODEL_FOLDER)
    environment["NO_MKDOCS_2_WARNING"] = "1"
    # Tests replace functions of modules, which compiled ones call directly.
    environment[OFF] = "1"
    failed = []
    for name, command in checks:
        console.note(f"== {name}")
        started = time.monotonic()
        status = _run(command, root, environment)
        seconds = time.monotonic() - started
        good = status == 0 or status in nothing
        console.note(f"== {name} {'ok' if good else 'FAILED'} after {seconds:.0f} s")
        if not good:
            failed.append(name)
    if failed:
        console.report_error(f"failed: {', '.join(failed)}")
    return 1 if failed else 0


def _git(root: Path, *arguments: str) -> list[str]:
    """Run git, and split what it prints at its NUL bytes."""
    command = ["git", *arguments]
    try:
        process = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise HostError("git, which says what changed, isn't installed") from error
    if process.returncode != 0:
        raise HostError(f"{' '.join(command)}: {process.stderr.strip()}")
    return [file for file in process.stdout.split("\0") if file]


def changed_files(root: Path, since: str | None) -> list[str]:
    """List the files that differ from a commit, new ones among them, deleted ones not.

    Args:
        root: folder of the checkout.
        since: the commit. Without one the last commit counts, and where nothing differs from
            that, the one before it.
    """
    if since is not None and since.startswith("-"):
        raise InputError(f"--since {since} is no commit", remedy="give a branch, a tag or a hash")
    for commit in [since] if since else ["HEAD", "HEAD~1"]:
        files = _git(root, "diff", "--name-only", "-z", commit, "--")
        files += _git(root, "ls-files", "--others", "--exclude-standard", "-z")
        if files:
            console.note(f"differing from {commit}: {len(files)} files")
            return sorted(file for file in set(files) if (root / file).is_file())
    console.note("nothing differs")
    return []


def _test_changes(root: Path, since: str | None, within_s: int, arguments: Sequence[str]) -> int:
    """Run the tests that a change reaches, a few files at a time, the nearest first."""
    end = time.monotonic() + within_s
    changed = changed_files(root, since)
    files = _git(root, "ls-files", "--cached", "--others", "--exclude-standard", "-z")
    waiting = keep_tests(distances(read_graph(root, files), changed))
    console.note(f"{len(waiting)} of {len(keep_tests(files))} test files are reached")
    status = 0
    while waiting and (left_s := end - time.monotonic()) > 0:
        batch, waiting = waiting[:FILES_AT_ONCE], waiting[FILES_AT_ONCE:]
        command = [*PYTEST, "-q", *QUICK, "--within", f"{left_s:.0f}"]
        command += [*arguments, *batch]
        status |= _run_all(root, [(f"tests of {len(batch)} files", command)], nothing=(5,))
    if waiting:
        console.note(f"{len(waiting)} files further away weren't started: ./ssp test runs all")
    return status


@click.command()
@click.option("--since", metavar="COMMIT", help="Compare with this commit instead of the last one.")
@click.option("--fix", is_flag=True, help="Format, and apply the linter's fixes.")
def check(since: str | None, fix: bool) -> int:
    """Check format, lint and types of what changed; under a minute.

    Compares with the last commit, or, when nothing differs from that, with the one before.
    """
    root = _root("the checks need")
    python = [file for file in changed_files(root, since) if file.endswith(".py")]
    checks = []
    if python:
        checks = [
            ("tools", TOOLS),
            ("format", ["ruff", "format", *([] if fix else ["--check"]), *python]),
            ("lint", ["ruff", "check", "--force-exclude", *(["--fix"] if fix else []), *python]),
            # It keeps what it knows of files that didn't change.
            ("types", ["mypy", *PACKAGES]),
        ]
    return _run_all(root, checks)


@click.command(context_settings={"ignore_unknown_options": True})
@click.option("--quick", is_flag=True, help="Leave out the tests that run whole sessions.")
@click.option(
    "--real-model",
    is_flag=True,
    help="Instead, download a small language model (130 MB) and run the tests that ask it: about "
    "15 minutes, both processors, half a GB of memory.",
)
@click.option(
    "--changed",
    is_flag=True,
    help="Only the tests that the import graph reaches from what changed, the nearest first, "
    "without whole sessions, and no further ones after --within.",
)
@click.option("--since", metavar="COMMIT", help="With --changed: compare with this commit.")
@click.option(
    "--within",
    "within_s",
    metavar="SECONDS",
    type=WholeNumber(1, 3600),
    default=50,
    show_default=True,
    help="With --changed: start no test after this time; the others are counted.",
)
@click.argument("pytest_arguments", nargs=-1, type=click.UNPROCESSED)
def test(
    quick: bool,
    real_model: bool,
    changed: bool,
    since: str | None,
    within_s: int,
    pytest_arguments: tuple[str, ...],
) -> int:
    """Run format, lint, types and all tests; further arguments go to pytest.

    All of them run even when one fails; exit status 1 when any did.
    """
    root = _root("the tests need")
    if not changed:
        return _run_all(root, _checks(pytest_arguments, quick, real_model))
    return _test_changes(root, since, within_s, pytest_arguments)


@click.command("build-core")
@click.option("--remove", is_flag=True, help="Remove the compiled modules instead.")
def build_core(remove: bool) -> int:
    """Compile the modules in which a session spends its time to machine code (mypyc).

    Optional: the same sources and the same bytes, in less processor time. If a source of their
    packages changes, all are interpreted until the core is compiled again; `ssp doctor` says so. It
    takes a minute or two and needs a C compiler.
    """
    root = _root("the core is compiled from")
    if remove:
        remove_folder(FOLDER)
        status = 0
    else:
        status = _run_all(root, [("tools", TOOLS)]) or _run_all(root, [("core", COMPILE)])
    console.note(f"compiled core: {state_of_core()}")
    return status


@click.command()
@click.option("--out", default="out/docs", show_default=True, help="Folder for the site.")
@click.option("--serve", is_flag=True, help="Show it on http://127.0.0.1:8000 while you edit it.")
def docs(out: str, serve: bool) -> int:
    """Build the site of the documentation; exit status 1 for a link that is broken.

    A link, an anchor or the name of a function that leads nowhere is an error. The first call
    installs MkDocs (15 MB). Its search needs a server: --serve, or any other.
    """
    root = _root("the site is made from")
    folder = root if serve else _site_folder(out)
    if status := _run_all(root, [("tools of the site", DOCS_TOOLS)]):
        return status
    if serve:
        return _run_all(root, [("site", [*MKDOCS, "serve"])])
    status = _run_all(root, [("site", [*MKDOCS, "build", "--strict", "--site-dir", str(folder)])])
    if status == 0:
        console.out.print(str(Path(out) / "index.html"), markup=False)
    return status


def _site_folder(out: str) -> Path:
    """Return the folder for a site, which MkDocs empties first: it is empty or holds a site.

    Raises:
        InputError: it is a file, or holds what is no site.
    """
    folder = make_folder(out).resolve()
    if any(folder.iterdir()) and not (folder / "search" / "search_index.json").is_file():
        raise InputError(
            "holds something else than a site, which would be deleted",
            file=out,
            remedy="name a new folder with --out",
        )
    return folder
