"""The runner's faults: whom they may strike, when they begin, and what they do to a process."""

from __future__ import annotations

import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.host.processes import NodeProcess, ProcessGroup
from ssp_core.run_file.model import Fault, RunSpec
from ssp_ot_controller.sil.patience import HANG_LIMIT_S
from ssp_scenario_manager.run.faults import (
    WORLD_WAITS_S,
    FaultInjector,
    check,
    of_runner,
    strikes_armed,
    with_conditions_never_met,
)
from ssp_scenario_manager.triggers.fireability import cannot_fire

NODES = ("monitor", "sil_world", "object_target", "scenario_manager")


class Hands:
    """Notes what it is asked for."""

    def __init__(self) -> None:
        self.done: list[tuple[Any, ...]] = []

    def abort(self, reason: str) -> None:
        self.done.append(("abort", reason))

    def send_strange_reference(self, object_id: str, kind: str) -> None:
        self.done.append((kind, object_id))

    def tell_fault(self, fault: str, target: str, active: bool, value: float) -> None:
        self.done.append((fault, target, active))


@pytest.fixture
def child(tmp_path: Path) -> Iterator[NodeProcess]:
    """A process that stands for a node."""
    process = subprocess.Popen(
        [sys.executable, "-c", "import time; print(flush=True); time.sleep(600)"],
        stdout=subprocess.PIPE,
    )
    if process.stdout is not None:
        process.stdout.readline()  # it runs
    yield NodeProcess("monitor", process, tmp_path / "log")
    process.kill()
    process.communicate()


def injector(
    run: RunSpec, child: NodeProcess | None, bag: Path, *faults: Fault
) -> tuple[FaultInjector, Hands, list[str]]:
    group = ProcessGroup({"ROS_DOMAIN_ID": "0"}, bag)
    if child is not None:
        group.processes = dict.fromkeys(NODES, child)
    hands, said = Hands(), list[str]()
    spec = run.model_copy(update={"faults": list(faults)})
    return FaultInjector(spec, group, bag, hands, said.append), hands, said


def state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]


def await_state(pid: int, wanted: str) -> None:
    for _ in range(100_000):
        if state_of(pid) in wanted:
            return
    pytest.fail(f"the process is {state_of(pid)}, not {wanted}")


def test_only_its_own_kinds_are_injected_here(run: RunSpec) -> None:
    faults = [Fault(kind="link_cut", target="ot1"), Fault(kind="operator_abort", at_s=3.0)]
    assert of_runner(run.model_copy(update={"faults": faults})) == [(1, faults[1])]


@pytest.mark.parametrize(
    ("fault", "field", "remedy"),
    [
        (Fault(kind="kill", target="camera"), "faults[0].target", "scenario_manager"),
        (Fault(kind="disk_full", target="sil_world"), "faults[0].target", "monitor"),
        (Fault(kind="reference_stale", target="vut"), "faults[0].target", "ot1"),
        (Fault(kind="operator_abort", target="ot1"), "faults[0].target", "leave it out"),
        (Fault(kind="kill", target="monitor", duration_s=1.0), "faults[0].duration_s", "leave"),
    ],
)
def test_a_fault_that_strikes_nothing_is_refused(
    fault: Fault, field: str, remedy: str, run: RunSpec
) -> None:
    with pytest.raises(InputError) as refused:
        check(run.model_copy(update={"faults": [fault]}), NODES)
    assert refused.value.field == field
    assert remedy in (refused.value.remedy or "")


def test_strange_references_need_the_simulated_world(run: RunSpec) -> None:
    fault = Fault(kind="reference_stale", target="ot1", at_s=1.0)
    spec = run.model_copy(update={"faults": [fault], "mode": "live"})
    with pytest.raises(InputError, match="simulated world"):
        check(spec, NODES)


def test_a_fault_begins_at_its_session_time_and_not_before(run: RunSpec, tmp_path: Path) -> None:
    made, hands, said = injector(run, None, tmp_path, Fault(kind="operator_abort", at_s=2.0))
    made.poll(0.0, 10.0)
    made.poll(1.98, 11.0)
    assert hands.done == []
    made.poll(2.0, 12.0)
    made.poll(2.02, 13.0)
    assert hands.done == [("0 operator_abort", "", True), ("abort", "fault 0 of the run file")]
    (one,) = made.injected
    assert (one.session_s, one.wall_s, one.active) == (2.0, 12.0, True)
    assert said == ["FAULT operator_abort begins (2.00 s)"]


def test_a_fault_at_the_very_start_waits_until_time_goes(run: RunSpec, tmp_path: Path) -> None:
    made, hands, _ = injector(run, None, tmp_path, Fault(kind="operator_abort", at_s=0.0))
    made.poll(0.0, 1.0)
    assert hands.done == []
    made.poll(0.02, 2.0)
    assert len(hands.done) == 2


def test_without_a_time_a_fault_strikes_the_armed_session(run: RunSpec, tmp_path: Path) -> None:
    fault = Fault(kind="reference_stale", target="ot1")
    assert strikes_armed(run.model_copy(update={"faults": [fault]}))
    assert not strikes_armed(run)
    made, hands, _ = injector(run, None, tmp_path, fault)
    made.poll(5.0, 1.0)
    assert hands.done == []
    made.strike_armed(2.0)
    made.strike_armed(3.0)
    assert hands.done[1:] == [("reference_stale", "ot1")]


def test_a_killed_node_is_dead(run: RunSpec, child: NodeProcess, tmp_path: Path) -> None:
    made, _, _ = injector(run, child, tmp_path, Fault(kind="kill", target="monitor", at_s=1.0))
    made.poll(1.0, 5.0)
    assert child.process.wait(600) == -signal.SIGKILL


def test_a_paused_node_stands_still_until_its_time_is_over(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    fault = Fault(kind="pause", target="sil_world", at_s=1.0, duration_s=3.0)
    made, _, _ = injector(run, child, tmp_path, fault)
    pid = child.process.pid
    made.poll(1.0, 5.0)
    await_state(pid, "T")
    made.poll(1.0, 7.9)
    assert state_of(pid) == "T"
    made.poll(1.0, 8.0)  # on the wall's clock: the world's own stands
    await_state(pid, "SR")
    assert [one.active for one in made.injected] == [True, False]
    assert not made.release(1.0, 9.0)


def test_a_world_that_was_ahead_is_dated_by_where_its_clock_came_to_stand(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    lockstep = run.model_copy(update={"mode": "lockstep"})
    fault = Fault(kind="pause", target="sil_world", at_s=1.0, duration_s=3.0)
    made, _, _ = injector(lockstep, child, tmp_path, fault)
    made.poll(1.0, 5.0)
    assert made.injected == []
    made.poll(1.6, 5.05)
    assert made.injected == []
    made.poll(1.6, 5.30)
    assert made.injected == []
    made.poll(1.6, 5.5)
    (begun,) = made.injected
    assert (begun.session_s, begun.wall_s) == (1.6, 5.0)
    assert made.release(1.6, 6.0)
    assert [one.active for one in made.injected] == [True, False]


def test_a_wait_of_the_runner_itself_is_no_standing_clock(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    lockstep = run.model_copy(update={"mode": "lockstep"})
    fault = Fault(kind="pause", target="sil_world", at_s=1.0, duration_s=3.0)
    made, _, _ = injector(lockstep, child, tmp_path, fault)
    made.poll(1.0, 5.0)
    made.poll(1.0, 5.5)  # half a second late, with what had been heard before
    assert made.injected == []
    for session_s, wall_s in ((1.6, 5.52), (1.6, 5.7), (1.6, 5.85)):
        made.poll(session_s, wall_s)
    (begun,) = made.injected
    assert (begun.session_s, begun.wall_s) == (1.6, 5.0)
    made.release(1.6, 6.0)


def test_a_time_that_comes_late_dates_the_pause_anew(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    """The last states of a world on a busy machine may come after its clock seemed to stand."""
    lockstep = run.model_copy(update={"mode": "lockstep"})
    fault = Fault(kind="pause", target="sil_world", at_s=1.0, duration_s=3.0)
    made, _, _ = injector(lockstep, child, tmp_path, fault)
    for step in range(20):
        made.poll(1.2, 5.0 + 0.1 * step)
    (begun,) = made.injected
    assert begun.session_s == 1.2
    made.poll(1.62, 8.1)
    assert [(one.active, one.session_s) for one in made.injected] == [(True, 1.62), (False, 1.62)]


def test_a_time_that_comes_while_the_world_still_waits_for_a_participant_dates_its_pause_anew(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    """A busy runner may hear for longer than a second of steps that were made before the pause."""
    assert WORLD_WAITS_S == HANG_LIMIT_S
    lockstep = run.model_copy(update={"mode": "lockstep"})
    fault = Fault(kind="pause", target="scenario_manager", at_s=1.0, duration_s=12.0)
    made, _, _ = injector(lockstep, child, tmp_path, fault)
    for step in range(15):
        made.poll(1.0 + 0.1 * step, 5.0 + 0.1 * step)
    assert [one.session_s for one in made.injected] == [2.4]
    made.poll(2.96, 7.9)
    # The world may go on without it from now on.
    made.poll(3.4, 8.1)
    made.poll(4.0, 17.1)
    assert [(one.active, one.session_s) for one in made.injected] == [(True, 2.96), (False, 4.0)]


def test_a_world_that_went_on_without_a_participant_dates_its_pause_as_before(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    lockstep = run.model_copy(update={"mode": "lockstep"})
    fault = Fault(kind="pause", target="scenario_manager", at_s=1.0, duration_s=3.0)
    made, _, _ = injector(lockstep, child, tmp_path, fault)
    for step in range(20):
        made.poll(1.2, 5.0 + 0.1 * step)
    made.poll(3.6, 8.1)
    assert [(one.active, one.session_s) for one in made.injected] == [(True, 1.2), (False, 3.6)]


def test_what_still_stands_at_the_end_goes_on(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    fault = Fault(kind="pause", target="sil_world", at_s=1.0)
    made, _, _ = injector(run, child, tmp_path, fault)
    made.poll(1.0, 5.0)
    await_state(child.process.pid, "T")
    assert made.release(1.0, 9.0)
    await_state(child.process.pid, "SR")


def test_a_full_disk_keeps_the_recorder_from_writing_on(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    (tmp_path / "bag_0.mcap").write_bytes(b"x" * 1234)
    made, _, _ = injector(run, child, tmp_path, Fault(kind="disk_full", target="monitor", at_s=1.0))
    made.poll(1.0, 5.0)
    assert resource.prlimit(child.process.pid, resource.RLIMIT_FSIZE)[0] == 1234


def test_a_process_that_is_gone_already_is_no_error(
    run: RunSpec, child: NodeProcess, tmp_path: Path
) -> None:
    child.process.kill()
    child.process.wait()
    faults = [
        Fault(kind="kill", target="monitor", at_s=1.0),
        Fault(kind="disk_full", target="monitor", at_s=1.0),
    ]
    made, _, _ = injector(run, child, tmp_path, *faults)
    made.poll(1.0, 5.0)
    assert len(made.injected) == 2


def test_a_trigger_that_is_never_met_waits_for_most_of_the_run(run: RunSpec) -> None:
    assert with_conditions_never_met(run) is run
    spec = run.model_copy(update={"faults": [Fault(kind="trigger_never")]})
    changed = with_conditions_never_met(spec)
    assert changed.triggers[0].held_for_s == pytest.approx(0.7 * run.end.at_latest_s)
    assert changed.triggers[0].condition == run.triggers[0].condition
    # It isn't refused at load: from the run file alone it might fire.
    assert not cannot_fire(changed)
