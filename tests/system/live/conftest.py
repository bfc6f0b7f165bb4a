"""A live session and the processes that play its hardware, for the system tests."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import ssp_core
from ssp_core.files.writing import write_text
from ssp_core.host.domains import free_domain
from ssp_core.run_file.values import SiteDatum
from ssp_scenario_manager.compile.changes import differences
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.targets.folder import write_task_files
from ssp_scenario_manager.compile.task import RUN_FILE
from ssp_scenario_manager.event_spec.log import LOG_FILE, Record, append_record
from ssp_scenario_manager.maps.site import find_shipped
from tests.support.processes.patience import SILENCE_S, WAITS
from tests.system.live.hosts import MANAGERS, Network, on

DEADLINE_S = 300.0
SERVER_PORT = 11811
ODOMETRY = "/ins/odometry"
GNSS = ("--navsat", "/ins/fix", "--heading", "/ins/imu", "--velocity", "/ins/velocity")
# Where the stand-in lies for those that have a receiver of places.
DATUM = SiteDatum(latitude_deg=57.7775, longitude_deg=12.7805, altitude_m=201.3, yaw_rad=0.4)
LEAD_S = 0.25
# Longer than a row of the log of played bodies.
TAIL_BYTES = 4096
SITE = "north_track"
# The prompt of a live run.
ASKS = 'type "start" to connect'


@dataclass(frozen=True)
class Row:
    """A true state of a played body, on the system clock."""

    time_ns: int
    x_m: float
    y_m: float
    speed_mps: float


def _row(fields: Mapping[str, str]) -> Row:
    where = (float(fields[name]) for name in ("x_m", "y_m", "speed_mps"))
    return Row(int(fields["time_ns"]), *where)


class Stage:
    """Starts processes of one or several hosts and ends them all.

    Args:
        folder: of the test.
        env: of all processes.
    """

    def __init__(self, folder: Path, env: dict[str, str]) -> None:
        self.folder = folder
        # The DDS profile is the one that a live session takes by itself, unless it is given.
        mine = {k: v for k, v in os.environ.items() if k != "FASTRTPS_DEFAULT_PROFILES_FILE"}
        self.env = {**mine, **env, "PYTHONUNBUFFERED": "1"}
        self._started: list[subprocess.Popen[Any]] = []
        self._begun: subprocess.Popen[Any] | None = None
        self._answered = 0

    @property
    def log(self) -> Path:
        """Return the log of the played bodies."""
        return self.folder / "bodies.csv"

    def rows(self) -> list[Row]:
        """The log of the played bodies; a row that is being written is left out."""
        if not self.log.is_file():
            return []
        text = self.log.read_text()
        whole = text[: text.rfind("\n") + 1]
        return [_row(fields) for fields in csv.DictReader(whole.splitlines())]

    def last_row(self) -> Row | None:
        """Return the last whole row of the log, without reading what is before it."""
        if not self.log.is_file():
            return None
        with self.log.open("rb") as stream:
            names = stream.readline().decode().rstrip("\r\n").split(",")
            begins = stream.tell()
            stream.seek(max(begins, stream.seek(0, os.SEEK_END) - TAIL_BYTES))
            whole, newline, _ = stream.read().rpartition(b"\n")
        if not newline:
            return None
        last = whole.rpartition(b"\n")[2].decode().rstrip("\r").split(",")
        return _row(dict(zip(names, last, strict=True)))

    def wait_for(self, condition: Callable[[], bool], what: str) -> None:
        """Waits until a condition holds; waiting in vain fails the test."""
        end = time.monotonic() + DEADLINE_S
        while not condition():
            if time.monotonic() > end:
                pytest.fail(f"waited {DEADLINE_S:g} s in vain for {what}\n{self._all_said()}")
            self._answer_prompts()
            time.sleep(0.05)

    def wait_for_motion(self, run: subprocess.Popen[Any], speed_mps: float) -> None:
        """Waits until the object drives faster than that."""

        def drives() -> bool:
            assert run.poll() is None, self.said("ssp_run")
            last = self.last_row()
            return last is not None and last.speed_mps > speed_mps

        self.wait_for(drives, f"an object faster than {speed_mps:g} m/s")

    def start(
        self, name: str, command: Sequence[str], host: Sequence[str] = (), **kwargs: Any
    ) -> subprocess.Popen[Any]:
        """One process; its output goes to NAME.txt."""
        with (self.folder / f"{name}.txt").open("a") as out:
            process = subprocess.Popen(
                [*host, *command],
                env=self.env,
                stdout=out,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                **kwargs,
            )
        self._started.append(process)
        return process

    def said(self, name: str) -> str:
        file = self.folder / f"{name}.txt"
        return file.read_text() if file.is_file() else ""

    def _all_said(self) -> str:
        """Return the end of what each process said."""
        files = sorted(self.folder.glob("*.txt"))
        return "\n".join(f"--- {file.stem}\n{file.read_text()[-3000:]}" for file in files)

    def run_live(
        self,
        task: Path,
        *arguments: str,
        host: Sequence[str] = (),
        receiver: Sequence[str] = ("--odometry", ODOMETRY),
    ) -> subprocess.Popen[Any]:
        """``ssp run --mode live --wait``, up to where it waits."""
        command = ["run", str(task), "--mode", "live", "--out", str(self.folder / "run"), "--wait"]
        return self.start_run([*command, *receiver, *arguments], host)

    def start_run(
        self, arguments: Sequence[str], host: Sequence[str] = ()
    ) -> subprocess.Popen[Any]:
        """``ssp`` with these arguments, up to where a loaded session waits."""
        process = self.call(arguments, host)
        self.said_after(process, ASKS)
        return process

    def call(
        self, arguments: Sequence[str], host: Sequence[str] = (), stdin: int = subprocess.PIPE
    ) -> subprocess.Popen[Any]:
        """``ssp`` with these arguments; its output is that of ``ssp_run``."""
        command = [sys.executable, "-m", "ssp_core.cli", *arguments]
        return self.start("ssp_run", command, host, stdin=stdin)

    def said_after(self, run: subprocess.Popen[Any], words: str) -> str:
        """Return the output of `ssp run` once these words are in it."""
        self.wait_for(lambda: words in self.said("ssp_run") or run.poll() is not None, f"{words!r}")
        assert run.poll() is None, self.said("ssp_run")
        return self.said("ssp_run")

    def play(
        self, name: str, *arguments: str, host: Sequence[str] = (), what: Path | None = None
    ) -> subprocess.Popen[Any]:
        """Played hardware of a folder, or of the run's own file, once it plays."""
        command = [sys.executable, "-m", "ssp_ot_controller.rehearsal"]
        played = what or self.folder / "run" / "run.yaml"
        process = self.start(name, [*command, str(played), *arguments], host)
        self.wait_for(
            lambda: "playing" in self.said(name) or process.poll() is not None, f"{name} to play"
        )
        assert process.poll() is None, self.said(name)
        return process

    def doctor(
        self, *, host: Sequence[str] = (), receiver: Sequence[str] = ("--odometry", ODOMETRY)
    ) -> dict[str, Any]:
        """Return the findings of ``ssp doctor --session`` by name, and whether it is content."""
        command = [sys.executable, "-m", "ssp_core.cli", "doctor", "--json", "--seconds", "1.5"]
        command += ["--session", str(self.folder / "run" / "run.yaml"), *receiver]
        done = subprocess.run(
            [*host, *command], env=self.env, capture_output=True, text=True, timeout=DEADLINE_S
        )
        told = json.loads(done.stdout)
        assert done.returncode == (0 if told["ok"] else 1)
        return {f["name"]: f for f in told["findings"]}

    def ask_doctor(self, *, host: Sequence[str] = ()) -> None:
        """Fails unless the doctor becomes content.

        A busy machine may keep a process waiting just while it listens; asked again, it isn't.
        """
        bad: list[dict[str, str]] = []
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            told = self.doctor(host=host)
            bad = [finding for finding in told.values() if finding["status"] == "fail"]
            if not bad:
                assert told["arming"]["text"] == "nothing keeps this session from arming"
                return
        pytest.fail(f"the doctor found {bad}")

    def begin(self, process: subprocess.Popen[Any]) -> None:
        """Types the word that starts; again, where a busy machine took longer than it holds."""
        self._begun = process
        self._answer_prompts()

    def _answer_prompts(self) -> None:
        run = self._begun
        if run is None or run.stdin is None or run.poll() is not None:
            return
        if self.said("ssp_run").count(ASKS) > self._answered:
            self._answered = self.said("ssp_run").count(ASKS)
            run.stdin.write(b"start\n")
            run.stdin.flush()

    def finish(self, process: subprocess.Popen[Any]) -> dict[str, Any]:
        """Waits for the end of a run; its result, with the exit status as ``status``."""
        self.wait_for(lambda: process.poll() is not None, "the end of the run")
        status = process.wait()
        result: dict[str, Any] = json.loads((self.folder / "run" / "result.json").read_text())
        # No vehicle takes part in any session of these tests.
        assert result["stand_in"] in (True, None), result["participants"]
        return {**result, "status": status}

    def close(self) -> None:
        """Ends whatever still runs."""
        alive = [process for process in self._started if process.poll() is None]
        for process in alive:
            process.terminate()
        for process in alive:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        for process in self._started:
            if process.stdin is not None:
                process.stdin.close()


@pytest.fixture
def make_stage(tmp_path: Path) -> Iterator[Callable[[dict[str, str]], Stage]]:
    """Makes the stage of a test, of which no process outlives it."""
    stages: list[Stage] = []

    def make(env: dict[str, str]) -> Stage:
        stages.append(Stage(tmp_path, env))
        return stages[-1]

    yield make
    for stage in stages:
        stage.close()


@pytest.fixture
def stage(make_stage: Callable[[dict[str, str]], Any]) -> Iterator[Any]:
    """One host: all processes on loopback, in a domain of their own."""
    with free_domain() as domain:
        made = make_stage(
            {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        )
        yield made
        made.close()


@pytest.fixture
def network() -> Iterator[Network]:
    made = Network(f"ssp{os.getpid() % 100000}")
    try:
        made.make()
    except FileNotFoundError:
        pytest.skip("two hosts: this machine has no `ip` (iproute2)")
    except subprocess.CalledProcessError as error:
        made.remove()
        pytest.skip(f"two hosts: no network namespaces may be made here: {error.stderr.strip()}")
    yield made
    made.remove()


@pytest.fixture
def two_hosts(network: Network, make_stage: Callable[[dict[str, str]], Any]) -> Iterator[Any]:
    """Two hosts with a discovery server on the manager's."""
    profile = Path(ssp_core.__file__).parent / "config" / "fastdds_hosts.xml"
    made = make_stage(
        {
            "ROS_DOMAIN_ID": "7",
            "ROS_DISCOVERY_SERVER": f"{MANAGERS}:{SERVER_PORT}",
            "ROS_SUPER_CLIENT": "TRUE",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        }
    )
    server = ["fast-discovery-server", "-i", "0", "-l", MANAGERS, "-p", str(SERVER_PORT)]
    made.start("discovery_server", server, on(network.a))
    yield made
    made.close()


@pytest.fixture
def task(tmp_path: Path) -> Callable[..., Path]:
    """Compiles a scenario for the track that stands in for a proving ground.

    With ``datum`` it is known where that lies.
    """

    def compiled(scenario: str, *, datum: bool = False) -> Path:
        return _compile(scenario, tmp_path / "task", _with_datum(tmp_path) if datum else SITE)

    return compiled


def _with_datum(folder: Path) -> str:
    site = folder / f"{SITE}.site.yaml"
    text = find_shipped(SITE, "site").read_text()
    datum = "{latitude_deg: 57.7, longitude_deg: 12.9, altitude_m: 190.0, yaw_rad: 0.3}"
    site.write_text(f"{text}datum: {datum}\n")
    return str(site)


def _compile(scenario: str, folder: Path, site: str) -> Path:
    """Compile with limits for a busy machine where only punctuality is judged."""
    compiled = compile_task(Request(event=scenario, target="track", site=site, seed=1))
    write_task_files(compiled, folder)
    run = compiled.task.run
    # Silence of two seconds is nothing to stop for here. A blind stop needs that much more room,
    # also for an object that turns a little more than its reference: four times the site's fence.
    lax = {**dict.fromkeys(WAITS, SILENCE_S), "clock_offset_s": 0.5, "error_longitudinal_m": 8.0}
    limits = run.limits.model_copy(update=lax)
    middle = [sum(axis) / len(run.geofence) for axis in zip(*run.geofence, strict=True)]
    fence = [(4.0 * x - 3.0 * middle[0], 4.0 * y - 3.0 * middle[1]) for x, y in run.geofence]
    assert run.camera is not None
    # Small pictures, which a busy machine draws in time too.
    camera = run.camera.model_copy(update={"width_px": 240, "height_px": 135})
    # A reference may be under way for longer than it would be on a machine of its own.
    triggers = [t.model_copy(update={"lead_time_s": LEAD_S}) for t in run.triggers]
    update = {"limits": limits, "geofence": fence, "camera": camera, "triggers": triggers}
    changed = run.model_copy(update=update)
    for difference in differences(run, changed):
        record = Record(
            kind="site_change",
            when="2025-03-01T09:30:00Z",
            who="A. Tester",
            subject=run.scenario,
            field=difference.field,
            old=difference.compiled,
            new=difference.executed,
            reason="the machine may be busy",
        )
        append_record(folder / LOG_FILE, record)
    text = changed.model_dump_json(by_alias=True, indent=1)
    write_text(folder / RUN_FILE, text + "\n")
    return folder
