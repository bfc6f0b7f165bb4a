"""One session from start to end over DDS: processes up, run, processes down, bag checked."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import ssp_core
from ssp_core import names
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.seals.declaration import Declaration, load_declaration, seal_declaration
from ssp_core.bag.seals.verdict import leave_verdict
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.compiled import core_in_use
from ssp_core.errors import HostError, InputError, SspError
from ssp_core.files.writing import write_json, write_text
from ssp_core.host.domains import folder_of_domains, free_domain
from ssp_core.host.environment import live_environment, session_environment
from ssp_core.host.processes import ProcessGroup
from ssp_core.host.shared_memory import check_shared_memory
from ssp_core.host.terminal import LineWriter, on_stop_signals, on_suspension, pasteable
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participation import declaring
from ssp_core.run_file.session_token import draw_token
from ssp_core.run_file.verdict import RESULT_FILE, EndWord, read_verdict
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.run import faults
from ssp_scenario_manager.run.over_dds.companions import (
    RECORDED,
    Companion,
    beside,
    given_token,
    page_companion,
)
from ssp_scenario_manager.run.over_dds.follow import Interrupt, SessionOutcome, follow, obituary
from ssp_scenario_manager.run.over_dds.live import LiveSetup, describe
from ssp_scenario_manager.run.report import measured
from ssp_scenario_manager.run.result import happened_by, misses, participation_by, result_keys
from ssp_scenario_manager.session.run_script import RunOutcome

# What the recorder left of a bag that it did not close.
UNFINISHED = "bag.unfinished"
PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"
HOSTS_PROFILE = PROFILE.with_name("fastdds_hosts.xml")

NODE_MODULES = {
    names.MONITOR: "ssp_monitor.ros.monitor_node",
    names.SIL_WORLD: "ssp_ot_controller.ros.sil_world",
    names.OBJECT_TARGET: "ssp_ot_controller.ros.object_target",
    names.VUT_DRIVER: "ssp_ot_controller.ros.vut_driver",
    names.FRONT_CAMERA: "ssp_ot_controller.ros.front_camera",
    names.VUT_ADAPTER: "ssp_ot_controller.ros.vut_adapter",
    names.SCENARIO_MANAGER: "ssp_scenario_manager.ros.manager_node",
}


@dataclass(frozen=True, slots=True)
class RunResult:
    """The outcome of a run.

    Args:
        bag: folder of the recording, unfinished where it could be neither closed nor recovered.
        result_fields: what stands in result.json, if that could be written.
        unwritten: why files of the run are missing, for people, and what to do.
    """

    outcome: RunOutcome
    bag: Path
    result_fields: dict[str, Any]
    unwritten: tuple[str, ...]
    wall_s: float
    session_s: float
    running_wall_s: float


# What else result.json says of a run and its bag, and why its verdict can't stand; empty: it can.
Further = Callable[[RunSpec, Path], tuple[dict[str, Any], str]]


def _nothing_further(_: RunSpec, __: Path) -> tuple[dict[str, Any], str]:
    return {}, ""


def run_session(
    spec: RunSpec,
    folder: Path,
    say: Callable[[str], None],
    live: LiveSetup | None = None,
    page_port: int | None = None,
    video: str | None = None,
    shadows: Sequence[Companion] = (),
    servers: Mapping[str, ServerOfRun] = MappingProxyType({}),
    further: Further = _nothing_further,
    answers: Path | None = None,
) -> RunResult:
    """Run one session in processes of its own and leave run.yaml, bag, log and result.json.

    A simulated one is alone in a ROS domain on loopback; a live one takes domain, discovery and DDS
    profile from the environment.

    Args:
        spec: the run.
        folder: new or empty; receives everything.
        say: tells the user a sentence.
        live: what runs on this host of a live session; None for a simulated one.
        page_port: of the operators' page beside it, 0: any; None: no page.
        video: codec that the recorder encodes the camera's frames with; None: frames as they come.
        shadows: models that follow it in shadow mode; their answers are recorded.
        servers: CARLA servers that nodes of the session ask, by node.
        further: returns what else ``result.json`` says of the run and its bag, and why its verdict
            can't stand.
        answers: that the driver, a model, gave in this run before, and repeats; None: it is asked.

    Whatever happens, the folder then says how the run ended: result.json, and verdict.json in the
    bag, which an evaluation reads beside what the bag itself says. On a full disk the result alone
    says it, and what is missing. A run with injected faults also
    leaves faults.json, what was injected and heard when, and witness.json, the truth as the runner
    heard it.

    Raises:
        InputError: a fault of the run strikes nothing that this session has, or a body is of no
            object.
        HostError: nodes can't talk here, or no domain can be held.
    """
    started = time.monotonic()
    check_shared_memory()  # before anything is written
    if live is None:
        folder_of_domains()
    if page_port is not None:
        given_token(os.environ)  # a wrong one is said before anything is started
    run_file, bag = folder / "run.yaml", folder / "bag"
    if live is not None:
        live.check(spec)
    word = None
    if live is not None and live.declared is not None:
        word = load_declaration(live.declared, spec)
    nodes = _simulated(spec, run_file, bag) if live is None else live.parameters(run_file, bag)
    if answers is not None:
        nodes[names.VUT_DRIVER]["answers"] = answers
    if video is not None:
        nodes[names.MONITOR]["video"] = video
    if shadows:
        nodes[names.MONITOR]["include"] = RECORDED
    for name, server in servers.items():
        nodes[name].update(server.parameters)
    faults.check(spec, nodes)
    spec = faults.with_conditions_never_met(spec)
    spec = spec.model_copy(
        update={
            "session_token": draw_token(spec.mode),
            "declaring": () if live is None else declaring(spec),
        }
    )
    write_text(run_file, spec.model_dump_json(by_alias=True, indent=1) + "\n")
    interrupt = Interrupt()
    with (
        on_stop_signals(interrupt.on_signal),
        on_suspension(interrupt.on_suspension),
        tempfile.TemporaryDirectory(prefix="ssp-run-") as scratch,
        _process_group(folder / "logs", live is not None) as group,
    ):
        # A node that is killed can't clean up after itself.
        group.env["TMPDIR"] = scratch
        if live is not None:
            for line in describe(live, spec, run_file, group.env):
                say(line)
        elif spec.driver.external:
            topic = names.absolute(names.VUT_COMMAND)
            domain_id = group.env["ROS_DOMAIN_ID"]
            say(f"the VUT waits for its driver on {topic}, ROS_DOMAIN_ID={domain_id}, this host")
        remappings = live.remappings if live is not None else ()
        for name, parameters in nodes.items():
            group.start_node(name, NODE_MODULES[name], parameters, remappings)
        page = []
        if page_port is not None:
            page.append(page_companion(group.env, run_file, page_port))
        bodies = live.bodies if live is not None else {}
        with beside(group, page, say, remappings) as tell_end:
            with beside(group, shadows, say, remappings):
                lines = LineWriter(say)
                group.after_end.callback(lines.close)
                followed = follow(spec, group, run_file, bag, lines, interrupt, live, lines.mark)
                # Before its processes end, so that their silence is known to be the end.
                tell_end(_end_word(followed.outcome, folder, final=False))
                outcome = _shut_down(group, followed.outcome)
            result = _conclude(
                spec, folder, followed, outcome, started, bodies, word, lines, further
            )
            tell_end(_end_word(result.outcome, folder, final=True))
            return result


def _seal_word(word: Declaration, bag: Path) -> None:
    seal_declaration(word, bag)


def _end_word(outcome: RunOutcome, folder: Path, *, final: bool) -> EndWord:
    return EndWord(outcome.verdict, outcome.reasons, final, str(folder))


def _conclude(
    spec: RunSpec,
    folder: Path,
    followed: SessionOutcome,
    outcome: RunOutcome,
    started: float,
    bodies: dict[str, str],
    word: Declaration | None,
    say: Callable[[str], None],
    further: Further,
) -> RunResult:
    """Check the bag, give the verdict, and write a run's files, as far as the disk lets."""
    bag, unwritten, sealed = folder / "bag", list[str](), list[str]()

    def write(make: Callable[[], None]) -> None:
        try:
            make()
        except HostError as error:
            unwritten.append(str(error))

    if spec.faults:
        write(lambda: write_json(folder / faults.FAULTS_FILE, followed.faults))
        write(lambda: write_json(folder / faults.WITNESS_FILE, followed.witness))
    recording = bag
    try:
        outcome = _check_bag(bag, outcome, say)
    except HostError as error:
        outcome = outcome.with_reason(Verdict.INVALID_HARNESS, f"the bag isn't closed: {error}")
        recording = bag.with_name(UNFINISHED)
    happened = happened_by(bag, spec)
    try:
        more, why = further(spec, recording)
    except SspError as error:
        more, why = {}, str(error)
    if why and outcome.ok:
        outcome = outcome.with_reason(Verdict.INVALID_HARNESS, why)
    if bag.is_dir():
        outcome = outcome.with_word_of_recorder(read_verdict(bag))
        if happened is not None and happened.is_measured:
            # What K* says of passing and time gap decides nothing of a driven run.
            outcome = outcome.with_misses([] if spec.driven else misses(spec, happened))
        elif outcome.ok:
            why = (
                "the bag can't be read"
                if happened is None
                else "the bag lacks a participant's states"
            )
            outcome = outcome.with_reason(Verdict.INVALID_HARNESS, f"{why}: the event is unknown")
        write(lambda: sealed.append(leave_verdict(bag, outcome.verdict, outcome.reasons, "runner")))
        if word is not None and recording == bag:
            write(partial(_seal_word, word, bag))
    wall_s = time.monotonic() - started
    result_fields = {
        **result_keys(spec, happened, participation_by(bag, spec)),
        "in_process": False,
        "bodies": bodies,
        "verdict": outcome.verdict.name.lower(),
        "reasons": list(outcome.reasons),
        "bag": recording.name,
        "seal": next(iter(sealed), "") or None,
        "session_s": round(followed.session_s, 3),
        "wall_s": round(wall_s, 3),
        "running_wall_s": round(followed.running_wall_s, 3),
        "measured": measured(bag, spec, say),
        "compiled_core": core_in_use(),
        **more,
    }
    write(lambda: write_json(folder / RESULT_FILE, result_fields))
    if recording != bag:
        unwritten.append(
            f"the recording lies in {recording}; make room, then close it with "
            + pasteable("bag", "recover", recording, "--out", bag)
        )
    elif unwritten and bag.is_dir():
        unwritten.append(f"the recording in {bag} is whole")
    return RunResult(
        outcome,
        recording,
        result_fields,
        tuple(unwritten),
        wall_s,
        followed.session_s,
        followed.running_wall_s,
    )


def _simulated(spec: RunSpec, run_file: Path, bag: Path) -> dict[str, dict[str, object]]:
    """Return the nodes of a simulated session by name, each with its parameters."""
    parameters_by_node: dict[str, dict[str, object]] = {
        names.MONITOR: {"run_file": run_file, "bag_dir": bag},
        names.SIL_WORLD: {"run_file": run_file},
        names.OBJECT_TARGET: {"run_file": run_file},
    }
    if spec.driven is not None and spec.has_driver_node:
        parameters_by_node[names.VUT_DRIVER] = {"run_file": run_file}
    if spec.camera is not None:
        parameters_by_node[names.FRONT_CAMERA] = {"run_file": run_file}
    parameters_by_node[names.SCENARIO_MANAGER] = {"run_file": run_file}
    return parameters_by_node


@contextmanager
def _process_group(logs: Path, live: bool) -> Iterator[ProcessGroup]:
    if live:
        with ProcessGroup(live_environment(HOSTS_PROFILE), logs, owns_domain=False) as group:
            yield group
        return
    with (
        free_domain() as domain_id,
        ProcessGroup(session_environment(domain_id, PROFILE), logs) as group,
    ):
        yield group


def _shut_down(group: ProcessGroup, outcome: RunOutcome) -> RunOutcome:
    """End all but the recorder first, so that their last words are recorded."""
    monitor = group.processes.pop(names.MONITOR)
    killed = group.stop()
    group.processes[names.MONITOR] = monitor
    killed += group.stop(timeout_s=20.0)
    if monitor.returncode not in (0, None) and names.MONITOR not in killed:
        outcome = outcome.with_reason(Verdict.INVALID_HARNESS, obituary(monitor))
    for name in killed:
        outcome = outcome.with_reason(
            Verdict.INVALID_HARNESS, f"{name} did not stop and was killed"
        )
    return outcome


def _check_bag(bag: Path, outcome: RunOutcome, say: Callable[[str], None]) -> RunOutcome:
    """Close the file that a recorder left unfinished when it was killed.

    Raises:
        HostError: the disk doesn't take the closed one; the other lies beside it.
    """
    if (bag / "metadata.yaml").is_file():
        return outcome
    if not bag.is_dir():
        return outcome.with_reason(Verdict.INVALID_HARNESS, "the recorder left no bag")
    unfinished = bag.with_name(UNFINISHED)
    bag.rename(unfinished)
    try:
        report = recover(unfinished, bag)
    except InputError as error:
        return outcome.with_reason(
            Verdict.INVALID_HARNESS, f"the recorder left a bag that can't be recovered: {error}"
        )
    message_count = sum(report.messages.values())
    say(f"bag recovered: {message_count} messages")
    return outcome.with_reason(
        Verdict.INVALID_HARNESS,
        f"the recorder did not close its bag; {message_count} messages were recovered",
    )
