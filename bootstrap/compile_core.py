"""Compiles the core of sessions with mypyc, from the sources as they are; `./ssp build-core`.

Writes `ssp-compiled` in the environment: the machine code, and a table of the sources that it was
made from (`ssp_core.compiled` reads it). The sources aren't touched: a change of any in the
packages of the listed modules has all modules interpreted until the core is compiled anew.

A module stands in the list because a session spends its time there. It must have no
`functools.cached_property`, which mypyc takes for a plain property, and no dataclass that is
pickled, copied by `copy`, or of which `__slots__` are read.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from types import FrameType

from mypyc.build import mypycify
from setuptools import Distribution
from setuptools.errors import BaseError, CCompilerError

from ssp_core.compiled import (
    FOLDER,
    OFF,
    RECIPE,
    TABLE,
    CompiledCore,
    hash_of,
    sources_of,
)
from ssp_core.errors import HostError, SspError
from ssp_core.files.folders import remove_folder

ROOT = Path(__file__).resolve().parent.parent
MODULES = {
    "ssp_msgs/ssp_core": (
        "clock",
        "geometry",
        "motion/encounter",
        "motion/state",
        "safety/consistency",
        "safety/contradiction",
        "safety/delays",
        "safety/fence",
        "safety/limits",
        "safety/samples",
        "safety/stopping",
        "safety/window",
        "world/car_following",
        "world/obstacles",
    ),
    "ssp_ot_controller/ssp_ot_controller": (
        "bodies/dynamics",
        "control/stopping",
        "control/tracker",
        "in_process",
        "objects/driving",
        "objects/local_safety",
        "objects/messages",
        "objects/own_states",
        "objects/pool",
        "objects/target",
        "sil/disturbance",
        "sil/plant",
        "sil/vut_driver",
        "sil/world",
    ),
    "ssp_scenario_manager/ssp_scenario_manager": (
        "run/in_process_session",
        "session/event_course",
        "session/limits",
        "session/local_stops",
        "session/open_triggers",
        "session/progress",
        "session/session",
        "session/state_history",
        "session/supervision",
    ),
}


def compile_to(folder: Path, modules: Mapping[str, Sequence[str]] = MODULES) -> None:
    """Compile modules into a folder, with their table; runs in the checkout's folder.

    Raises:
        HostError: the C compiler isn't there, or fails.
    """
    # Before the compiler reads them: of one that is saved meanwhile, the table has the old hash.
    hashes = {
        name: sha256 for package in modules for name, sha256 in sources_of(ROOT / package).items()
    }
    recipe = hash_of(RECIPE)
    sources = [f"{package}/{name}.py" for package, names in modules.items() for name in names]
    with tempfile.TemporaryDirectory(prefix="ssp-core-") as work:
        extensions = mypycify(
            ["--config-file", "pyproject.toml", *sources], opt_level="2", target_dir=work
        )
        for extension in extensions:
            # Where a processor multiplies and adds in one, it rounds once instead of twice.
            extension.extra_compile_args.append("-ffp-contract=off")
        builder = Distribution({"name": "ssp-core", "ext_modules": extensions})
        command = builder.get_command_obj("build_ext")
        command.build_lib, command.build_temp = f"{work}/lib", f"{work}/temp"
        command.ensure_finalized()
        try:
            command.run()
        except (BaseError, CCompilerError) as error:
            raise HostError(
                f"the C compiler failed: {error}; it needs gcc or clang, and the header files of "
                "this Python (Python.h; Debian and Ubuntu: apt install build-essential python3-dev)"
            ) from error
        shutil.copytree(f"{work}/lib", folder, dirs_exist_ok=True)
    built = {file.relative_to(folder) for file in folder.rglob("*.so")}
    # A module's file is named after it and the interpreter: `limits.cpython-311-….so`.
    files = {".".join((*f.parent.parts, f.name.split(".", 1)[0])): str(f) for f in built}
    table = {
        "python": sys.version,
        "mypy": version("mypy"),
        "recipe": recipe,
        "files": files,
        "sources": hashes,
    }
    (folder / TABLE).write_text(json.dumps(table, indent=1, sort_keys=True) + "\n", "utf-8")


# Prints the bytes of sessions: the hash of their states, and what result.json says.
_SESSIONS = """
import json, sys
from pathlib import Path
from ssp_core.compiled import use_core_of
for folder in sys.argv[2:]:
    use_core_of(Path(folder))
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.run.in_process import result_json, run_in_process
for event in sys.argv[1].split(","):
    run = compile_task(Request(event=event, target="sumo", site="boulevard")).task.run
    run = run.model_copy(update={"camera": None, "traffic": []})
    result, record = run_in_process(run)
    print(event, record.sha256, json.dumps(result_json(run, result), sort_keys=True))
"""
EVENTS = ("cut_in", "vru_crossing", "lead_braking", "slow_lead")


def sessions(events: Sequence[str], folder: Path | None = None) -> list[str]:
    """Run sessions in a process of their own; return a line for the bytes of each.

    Args:
        events: of the sessions.
        folder: the compiled core that they use; None: they are interpreted.

    Raises:
        HostError: the process failed.
    """
    chosen = [] if folder is None else [str(folder)]
    command = [sys.executable, "-c", _SESSIONS, ",".join(events), *chosen]
    # The environment's own core isn't used in either case.
    environment = {**os.environ, OFF: "1"}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode != 0:
        how = "interpreted" if folder is None else "compiled"
        raise HostError(f"the {how} sessions ended with status {done.returncode}, see above")
    return done.stdout.splitlines()


def differing(folder: Path, events: Sequence[str] = EVENTS) -> list[str]:
    """List the events whose sessions have other bytes with a compiled core than without."""
    both = zip(events, sessions(events, folder), sessions(events), strict=True)
    return [event for event, compiled, interpreted in both if compiled != interpreted]


@contextmanager
def _no_stop() -> Iterator[None]:
    """Hold back the wish to end this process until the block is done."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTERM,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _stop(number: int, _: FrameType | None) -> None:
    """End the work once, in order; the folder that is being made is removed."""
    signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


@contextmanager
def _alone(place: Path) -> Iterator[None]:
    """Hold the lock of a place.

    Raises:
        HostError: another process has it.
    """
    file = place.with_name(f"{place.name}.lock")
    with file.open("w") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise HostError("another one compiles just now; wait until it has ended") from error
        yield


def _refuse_stale(folder: Path) -> None:
    core = CompiledCore.read(folder)
    if why := "it has no table" if core is None else core.stale(sys.path):
        raise HostError(f"the compiled core isn't kept: {why}; start it again")


def build(place: Path) -> None:
    """Compile the core into a place, unless its sessions have other bytes than interpreted ones.

    What was there before stays until the new one is proven.

    Raises:
        HostError: it can't be compiled, differs, or a source changed meanwhile.
    """
    with _alone(place):
        new = Path(tempfile.mkdtemp(prefix=f"{place.name}.", dir=place.parent))
        try:
            compile_to(new)
            _refuse_stale(new)  # its sessions would be interpreted, and so be the same
            if others := differing(new):
                raise HostError(
                    f"sessions of {', '.join(others)} have other bytes compiled than interpreted; "
                    "the compiled core isn't kept"
                )
            _refuse_stale(new)
            new.chmod(0o755)
            with _no_stop():
                remove_folder(place)
                new.replace(place)
        finally:
            shutil.rmtree(new, ignore_errors=True)


def main() -> int:
    os.chdir(ROOT)
    # `ssp build-core` sends it, whatever ended that.
    signal.signal(signal.SIGTERM, _stop)
    try:
        build(FOLDER)
    except KeyboardInterrupt:
        return 130
    except (SspError, OSError) as error:
        print(f"ssp build-core: {error}", file=sys.stderr)
        return 1
    print(f"ssp build-core: compiled {sum(map(len, MODULES.values()))} modules into {FOLDER}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
