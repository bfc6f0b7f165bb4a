"""Sound recordings that tests only read, each made once for all workers of a run of the tests."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ssp_core.cli import main
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_text
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.compile.changes import value_at, with_value
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import Record, append_record
from ssp_scenario_manager.maps.site import LIBRARY
from tests.support.events.places import site_of
from tests.support.processes.patience import SILENCE_S

# Of sessions whose pictures aren't looked at.
SMALL = {"camera.width_px": 240, "camera.height_px": 136}
# The smallest that the shipped K* take.
LEAST_PX = 640, 360
SAID_FILE = "said.json"
SESSION_S = 540.0
HERE = Path(__file__).parent
Changes = Mapping[str, Any]


def ssp(*arguments: object) -> int:
    """A command in this process; its exit status."""
    return main([str(argument) for argument in arguments])


def succeed(*arguments: object) -> None:
    assert ssp(*arguments) == 0, arguments


def change_on_site(
    task: Path, changes: Changes, *, logged: bool = True, reason: str = "to be refused"
) -> None:
    """Change fields of a task's run.

    Args:
        task: folder of the task.
        changes: by field of the run.
        logged: the changes stand in the log, with who made them and why.
        reason: of the changes.
    """
    run = load_run(task / "run.yaml")
    for field, new in changes.items():
        old = value_at(run, field)
        run = with_value(run, field, new)
        record = Record(
            kind="site_change",
            when="2025-03-01T09:30:00Z",
            who="A. Tester",
            subject=run.scenario,
            field=field,
            old=old,
            new=value_at(run, field),
            reason=reason,
        )
        if logged:
            append_record(task / "log.jsonl", record)
    write_text(task / "run.yaml", run.model_dump_json(by_alias=True, indent=1) + "\n")


def site_with_pictures(folder: Path, name: str, size_px: tuple[int, int] = LEAST_PX) -> Path:
    """A shipped site in a folder, with pictures of this size."""
    site = folder / f"{name}.site.yaml"
    size = "width_px: {}, height_px: {}".format
    text = (LIBRARY / "sites" / site.name).read_text()
    assert size(960, 540) in text
    write_text(site, text.replace(size(960, 540), size(*size_px)))
    return site


def changed_run(
    folder: Path,
    bound: Path,
    changes: Changes,
    *,
    logged: bool = True,
    program: str | None = None,
    size_px: tuple[int, int] = LEAST_PX,
) -> None:
    """A run of the simulation in ``folder/run``, compiled in ``folder/task`` and then changed.

    Args:
        folder: is there.
        bound: K*.
        changes: by field of the run.
        logged: the changes stand in the log, with who made them and why.
        program: that runs the command line, and the session's processes; None: in one process.
        size_px: width and height of the pictures, no smaller than K* takes them.
    """
    task, site = folder / "task", site_with_pictures(folder, "boulevard", size_px)
    succeed("compile", bound, "--target", "sumo", "--site", site, "--out", task)
    change_on_site(task, changes, logged=logged)
    given = [task, "--seed", 11, "--out", folder / "run"]
    if program is None:
        # Over DDS it would be the same bag (test_in_process).
        ssp("run", *given, "--in-process", "--record")
    else:
        path = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        command = [sys.executable, "-c", program, "run", *map(str, given)]
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=SESSION_S,
            check=False,
            env={**os.environ, "PYTHONPATH": path},
        )
        assert done.returncode in (0, 1), done.stdout + done.stderr
    assert (folder / "run" / "result.json").is_file()


class Recordings:
    """K* with their clips, and a recording of each domain.

    Args:
        folder: that all workers share.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.folder = folder

    def k_star(self, event: str) -> Path:
        """A K* that is bound to its clip, which lies beside it."""
        file = self.folder / f"{event}.event.yaml"
        with self._once(event) as missing:
            if missing:
                succeed("spec", "clip", event, "--out", self.folder)
        return file

    def clip(self, event: str) -> Path:
        return self.k_star(event).with_name(f"{event}.mp4")

    def version(self, event: str) -> str:
        return load_event(str(self.k_star(event)))[1]

    def get(self, event: str, domain: str) -> Path:
        """A run's folder, with small pictures; over DDS it would be the same (test_in_process)."""
        bound = self.k_star(event)
        target = self.folder / f"{event}-{domain}"
        with self._once(target.name) as missing:
            if missing and domain == "synthetic":
                self._import(event, target)
            elif missing:
                sites = make_folder(self.folder / f"{target.name}-site")
                site = site_with_pictures(sites, site_of(event, domain))
                run = ("run", bound, "--site", site, "--seed", 11, "--out", target)
                succeed(*run, "--in-process", "--record")
        return target

    def task(self, event: str) -> Path:
        """A shipped event, compiled for the simulation, with small pictures.

        Before a session begins, heartbeats are judged by the wall's clock, in lockstep too.
        """
        target = self.folder / f"{event}-task"
        with self._once(target.name) as missing:
            if missing:
                site = site_of(event)
                succeed("compile", event, "--target", "sumo", "--site", site, "--out", target)
                wide = {**SMALL, "limits.heartbeat_s": SILENCE_S}
                change_on_site(target, wide, reason="the machine may be busy")
        return target

    def session(self, event: str, domain: str) -> Path:
        """The run of ``get`` in processes; its folder, with what it said with ``--json``."""
        one_process = self.get(event, domain)
        # The name of its folder becomes a run's id.
        target = self.folder / "sessions" / one_process.name
        with self._once(f"{target.name}-session") as missing:
            if missing:
                run = ("run", one_process, "--json")
                command = [sys.executable, "-m", "ssp_core.cli", *map(str, run)]
                done = subprocess.run(
                    [*command, "--out", str(target)],
                    capture_output=True,
                    text=True,
                    timeout=SESSION_S,
                    check=False,
                )
                assert done.returncode == 0, done.stdout + done.stderr
                write_text(target / SAID_FILE, done.stdout)
        return target

    @property
    def changed(self) -> Path:
        """A run of cut_in whose driver was changed on site, with a record."""
        folder = self.folder / "changed"
        with self._once(folder.name) as missing:
            if missing:
                folder.mkdir()
                changed_run(folder, self.k_star("cut_in"), {"driver.headway_s": 1.6})
        return folder / "run"

    def _import(self, event: str, target: Path) -> None:
        """The K*'s own source clip."""
        truth = json.loads((self.folder / f"{event}.truth.json").read_text())
        succeed(
            "import-video",
            self.clip(event),
            "--scenario",
            event,
            "--event-version",
            self.version(event),
            "--generator",
            "ssp-clip/1",
            "--ego-speed",
            f"{truth['ego_speed_mps'][0]['speed_mps']:.2f}",
            "--out",
            target / "bag",
        )

    @contextmanager
    def _once(self, name: str) -> Iterator[bool]:
        """Tell whether something is still to be made; the second caller waits for the first."""
        done = self.folder / f".{name}.made"
        with (self.folder / f".{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            try:
                yield not done.exists()
            except BaseException:
                shutil.rmtree(self.folder / name, ignore_errors=True)  # for those who come later
                raise
            done.touch()
