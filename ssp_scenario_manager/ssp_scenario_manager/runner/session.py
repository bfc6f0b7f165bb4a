"""One session from start to end: processes up, run, processes down, bag checked."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, TracebackType

import ssp_core
from ssp_core import names
from ssp_core.bag import recover
from ssp_core.domains import free_domain
from ssp_core.errors import SspError
from ssp_core.files import write_json, write_text
from ssp_core.processes import NodeProcess, ProcessGroup, session_environment
from ssp_core.run_spec import RunSpec
from ssp_core.vocab import Verdict
from ssp_scenario_manager.runner.node import RunClient
from ssp_scenario_manager.runner.outcome import Outcome

VERDICT_FILE = "verdict.json"
START_TIMEOUT_S = 30.0
# After a process died, the session itself should end within this time; then it is ended.
END_TIMEOUT_S = 20.0
PROFILE = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"

_NODES = {
    names.MONITOR: "ssp_monitor.node",
    names.SIL_WORLD: "ssp_ot_controller.sil.node",
    names.OBJECT_TARGET: "ssp_ot_controller.target.node",
    names.FRONT_CAMERA: "ssp_ot_controller.camera.node",
    names.SCENARIO_MANAGER: "ssp_scenario_manager.node",
}


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run left behind."""

    outcome: Outcome
    bag: Path
    wall_s: float
    session_s: float
    running_wall_s: float


class _Interrupt:
    """Counts SIGINT and SIGTERM instead of dying of them."""

    def __init__(self) -> None:
        self.count = 0
        self._before: dict[signal.Signals, object] = {}

    def __enter__(self) -> _Interrupt:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]  # what signal() gave us

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.count += 1


def run_session(
    spec: RunSpec,
    folder: Path,
    say: Callable[[str], None],
) -> RunResult:
    """Runs one session in processes of its own and leaves run.yaml, bag, logs and result.json.

    Args:
        spec: the run.
        folder: new or empty; receives everything.
        say: takes one line for people per thing that happens.

    Whatever happens, the folder then says how the run ended: result.json, and verdict.json in the
    bag, which an evaluation reads beside what the bag itself says.
    """
    started = time.monotonic()
    run_file = folder / "run.yaml"
    write_text(run_file, spec.model_dump_json(by_alias=True, indent=1) + "\n")
    bag = folder / "bag"
    with (
        _Interrupt() as interrupt,
        free_domain() as domain_id,
        ProcessGroup(session_environment(domain_id, PROFILE), folder / "logs") as group,
    ):
        for name, module in _NODES.items():
            if name == names.FRONT_CAMERA and spec.camera is None:
                continue
            parameters: dict[str, object] = {}
            if name != names.SCENARIO_MANAGER:
                parameters["run_file"] = run_file
            if name == names.MONITOR:
                parameters["bag_dir"] = bag
            group.start_node(name, module, parameters)
        outcome, session_s, running_wall_s = _follow(group, run_file, say, interrupt)
        outcome = _shut_down(group, outcome)
    outcome = _check_bag(group, bag, outcome, say)
    if bag.is_dir():
        write_json(
            bag / VERDICT_FILE,
            {
                "schema": "ssp.verdict/1",
                "verdict": outcome.verdict.name.lower(),
                "reasons": list(outcome.reasons),
            },
        )
    result = RunResult(outcome, bag, time.monotonic() - started, session_s, running_wall_s)
    write_json(
        folder / "result.json",
        {
            "schema": "ssp.result/1",
            "run_id": spec.run_id,
            "scenario": spec.scenario,
            "site": spec.site,
            "verdict": outcome.verdict.name.lower(),
            "reasons": list(outcome.reasons),
            "bag": bag.name,
            "session_s": round(session_s, 3),
            "wall_s": round(result.wall_s, 3),
            "running_wall_s": round(running_wall_s, 3),
        },
    )
    return result


def _follow(
    group: ProcessGroup, run_file: Path, say: Callable[[str], None], interrupt: _Interrupt
) -> tuple[Outcome, float, float]:
    """Waits for the manager, has the run done, and watches processes and signals meanwhile."""
    client = RunClient(group.env, say)
    try:
        deadline = time.monotonic() + START_TIMEOUT_S
        while not client.ready():
            client.spin(0.05)
            ended = group.ended()
            if ended:
                reason = f"did not come up: {_obituary(ended[0])}"
                return Outcome(Verdict.INVALID_HARNESS, (reason,)), 0.0, 0.0
            if interrupt.count:
                return Outcome(Verdict.ABORTED, ("interrupted before the start",)), 0.0, 0.0
            if time.monotonic() > deadline:
                reason = (
                    f"the scenario manager did not answer within {START_TIMEOUT_S:g} s; "
                    "`ssp doctor` tests whether processes can talk on this host"
                )
                return Outcome(Verdict.INVALID_HARNESS, (reason,)), 0.0, 0.0
        client.begin(str(run_file))
        outcome = _wait(group, client, say, interrupt)
        return outcome, client.elapsed_s, client.running_wall_s
    finally:
        client.close()


def _wait(
    group: ProcessGroup, client: RunClient, say: Callable[[str], None], interrupt: _Interrupt
) -> Outcome:
    told: set[str] = set()
    cancelled = 0
    deadline: float | None = None
    while client.outcome is None:
        client.spin(0.05)
        for node in group.ended():
            if node.name not in told:
                told.add(node.name)
                say(f"{node.name} {node.describe_exit()}")
                deadline = time.monotonic() + END_TIMEOUT_S
        if names.SCENARIO_MANAGER in told:
            # Nobody is left to give a result; the objects stop by themselves.
            _let_objects_stop(client)
            break
        if interrupt.count > cancelled:
            cancelled = interrupt.count
            if cancelled > 1:
                return Outcome(Verdict.ABORTED, ("interrupted twice, ended at once",))
            say("interrupted: aborting the session")
            client.cancel()
            deadline = time.monotonic() + END_TIMEOUT_S
        if deadline is not None and time.monotonic() > deadline:
            break
    outcome = client.outcome or Outcome(Verdict.INVALID_HARNESS, ())
    if cancelled:
        outcome = Outcome(outcome.verdict, ("interrupted from the terminal", *outcome.reasons))
    dead = [group.processes[name] for name in sorted(told)]
    for node in dead:
        outcome = outcome.with_reason(Verdict.INVALID_HARNESS, _obituary(node))
    if not outcome.reasons and not outcome.ok:
        outcome = Outcome(outcome.verdict, ("the session gave no result in time",))
    return outcome


def _let_objects_stop(client: RunClient) -> None:
    """Gives the objects, which hear no manager any more, the time to come to a standstill."""
    until = time.monotonic() + 5.0
    while time.monotonic() < until:
        client.spin(0.1)


def _obituary(node: NodeProcess) -> str:
    tail = node.log_tail(6)
    return f"{node.name} {node.describe_exit()}" + (f"; its last lines:\n{tail}" if tail else "")


def _shut_down(group: ProcessGroup, outcome: Outcome) -> Outcome:
    """Ends all but the recorder first, so that their last words are recorded."""
    monitor = group.processes.pop(names.MONITOR)
    killed = group.stop()
    group.processes[names.MONITOR] = monitor
    killed += group.stop(timeout_s=20.0)
    if monitor.returncode not in (0, None) and names.MONITOR not in killed:
        outcome = outcome.with_reason(Verdict.INVALID_HARNESS, _obituary(monitor))
    for name in killed:
        outcome = outcome.with_reason(
            Verdict.INVALID_HARNESS, f"{name} did not stop and was killed"
        )
    return outcome


def _check_bag(
    group: ProcessGroup, bag: Path, outcome: Outcome, say: Callable[[str], None]
) -> Outcome:
    """A recorder that was killed left an unfinished file; it is closed here."""
    if (bag / "metadata.yaml").is_file():
        return outcome
    if not bag.is_dir():
        return outcome.with_reason(Verdict.INVALID_HARNESS, "the recorder left no bag")
    unfinished = bag.with_name(bag.name + ".unfinished")
    bag.rename(unfinished)
    try:
        report = recover(unfinished, bag)
    except SspError as error:
        return outcome.with_reason(
            Verdict.INVALID_HARNESS, f"the recorder left a bag that can't be recovered: {error}"
        )
    kept = sum(report.messages.values())
    say(f"bag recovered: {kept} messages")
    return outcome.with_reason(
        Verdict.INVALID_HARNESS,
        f"the recorder did not close its bag; {kept} messages were recovered",
    )
