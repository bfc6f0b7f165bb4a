"""Compiles the core of sessions with mypyc, from the sources as they are; `./ssp build-core`.

Writes `ssp-compiled` in the environment: the machine code, and a table of the sources that it was
made from (`ssp_core.compiled` reads it). The sources aren't touched: a changed one has all modules
interpreted until the core is compiled anew.

A module stands in the list because a session spends its time there. It must have no
`functools.cached_property`, which mypyc takes for a plain property, and no dataclass that is
pickled, copied by `copy`, or of which `__slots__` are read.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from mypyc.build import mypycify
from setuptools import Distribution

from ssp_core.compiled import OFF

ROOT = Path(__file__).resolve().parent.parent
MODULES = {
    "ssp_msgs/ssp_core": (
        "clock",
        "safety/consistency",
        "safety/contradiction",
        "safety/delays",
        "safety/fence",
        "safety/limits",
        "safety/samples",
        "safety/stopping",
        "safety/window",
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
    """Compile modules into a new folder, with their table; runs in the checkout's folder."""
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
        command.run()
        shutil.copytree(f"{work}/lib", folder)
    built = {file.relative_to(folder) for file in folder.rglob("*.so")}
    # A module's file is named after it and the interpreter: `limits.cpython-311-….so`.
    files = {".".join((*f.parent.parts, f.name.split(".", 1)[0])): str(f) for f in built}
    hashes = {
        source.split("/", 1)[1]: hashlib.sha256((ROOT / source).read_bytes()).hexdigest()
        for source in sources
    }
    table = {"python": sys.version, "files": files, "sources": hashes}
    (folder / "table.json").write_text(json.dumps(table, indent=1, sort_keys=True) + "\n", "utf-8")


# Prints the bytes of sessions: the hash of their states, and what result.json says.
_SESSIONS = """
import json, sys
from pathlib import Path
from ssp_core.compiled import use_compiled
if len(sys.argv) > 2:
    use_compiled(Path(sys.argv[2]))
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
    """
    environment = {key: value for key, value in os.environ.items() if key != OFF}
    command = [sys.executable, "-c", _SESSIONS, ",".join(events)]
    if folder is None:
        environment[OFF] = "1"
    else:
        command.append(str(folder))
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return done.stdout.splitlines()


def differing(folder: Path, events: Sequence[str] = EVENTS) -> list[str]:
    """List the events whose sessions have other bytes with a compiled core than without."""
    both = zip(events, sessions(events, folder), sessions(events), strict=True)
    return [event for event, compiled, interpreted in both if compiled != interpreted]


def main() -> int:
    os.chdir(ROOT)
    place = Path(sys.prefix) / "ssp-compiled"
    new = place.with_name("ssp-compiled.new")
    shutil.rmtree(new, ignore_errors=True)
    compile_to(new)
    if others := differing(new):
        shutil.rmtree(new)
        print(
            f"ssp build-core: sessions of {', '.join(others)} have other bytes compiled than "
            "interpreted; the compiled core isn't kept",
            file=sys.stderr,
        )
        return 1
    shutil.rmtree(place, ignore_errors=True)
    new.replace(place)
    print(f"ssp build-core: compiled {sum(map(len, MODULES.values()))} modules into {place}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
