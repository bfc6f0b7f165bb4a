"""The sil_world as a process: who drives the VUT, injected faults, the wall clock, refusals."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names, ros
from ssp_core.host.environment import session_environment
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_msgs import msg
from ssp_ot_controller.sil.pacing import OVERRUN_S
from ssp_ot_controller.sil.patience import HANG_LIMIT_S
from tests.support.processes.children import end
from tests.support.processes.patience import patient
from tests.support.processes.waiting import DEADLINE_S
from tests.support.runs import APPROACH

pytestmark = pytest.mark.ros


class Peers:
    """Everybody whom a world meets, played by the test: manager, objects, the VUT's driver."""

    def __init__(self, others: Any) -> None:
        self.node, self.spin_until = others.node, others.spin_until
        self.ticks: list[Any] = []
        self.vut: list[Any] = []
        self.safety: list[Any] = []
        self.faults: list[Any] = []
        self.drives = False
        pub, sub = self.node.create_publisher, self.node.create_subscription
        self.done = pub(msg.StepDone, names.STEP_DONE, ros.STATE)
        self.commands = pub(msg.ActuatorCommands, names.ACTUATOR_COMMANDS, ros.COMMAND)
        self.driver = pub(msg.ActuatorCommand, names.VUT_COMMAND, ros.COMMAND)
        self.beats = pub(msg.Heartbeat, names.HEARTBEAT, ros.STATE)
        self.session = pub(msg.SessionState, names.SESSION_STATE, ros.LATCHED)
        sub(msg.WorldTick, names.WORLD_TICK, self._on_tick, ros.STATE)
        sub(msg.ObjectState, names.state_topic("vut"), self.vut.append, ros.STATE)
        sub(msg.SafetyEvent, names.SAFETY_EVENT, self.safety.append, ros.LATCHED)
        sub(msg.FaultEvent, names.FAULT_EVENT, self.faults.append, ros.LATCHED)

    def _on_tick(self, tick: Any) -> None:
        self.ticks.append(tick)
        if self.drives:
            self.drive(tick.step)
        one = msg.ActuatorCommand(object_id="ot1", step=tick.step, acceleration=-1.0)
        self.commands.publish(
            msg.ActuatorCommands(participant="object_target", step=tick.step, commands=[one])
        )
        for participant in ("object_target", "monitor"):
            self.done.publish(msg.StepDone(participant=participant, step=tick.step))
        if tick.running:
            self.answer(tick.step)

    def drive(self, step: int) -> None:
        self.driver.publish(msg.ActuatorCommand(object_id="vut", step=step, acceleration=1.5))

    def answer(self, step: int) -> None:
        running = int(SessionPhase.RUNNING)
        self.done.publish(
            msg.StepDone(participant="scenario_manager", step=step, session_state=running)
        )

    def start_realtime(self) -> None:
        beat = msg.Heartbeat(sender="scenario_manager", session_state=int(SessionPhase.RUNNING))
        self.node.create_timer(0.05, lambda: self.beats.publish(beat))
        ends = (self.beats, self.session)
        self.spin_until(lambda: all(p.get_subscription_count() for p in ends), "discovery")
        # A world that hears no heartbeats stops at once, and the other end may see us later.
        held = len(self.ticks)
        self.spin_until(lambda: len(self.ticks) > held + 5, "holding")
        self.session.publish(msg.SessionState(state=int(SessionPhase.RUNNING)))

    @property
    def step(self) -> int:
        return int(self.ticks[-1].step) if self.ticks else -1

    def codes(self) -> list[tuple[int, str]]:
        return [(event.code, event.object_id) for event in self.safety]


Start = Callable[..., tuple[subprocess.Popen[str], Peers]]


@pytest.fixture
def start(
    domain: int, others: Any, tmp_path: Path, run_mapping: Callable[..., dict[str, Any]]
) -> Iterator[Start]:
    """Starts a world, which is gone after the test, and meets it."""
    worlds: list[subprocess.Popen[str]] = []

    def make(**changes: Any) -> tuple[subprocess.Popen[str], Peers]:
        run_file = tmp_path / "run.yaml"
        run = run_mapping(**APPROACH, **changes)
        run_file.write_text(json.dumps(patient(run)))
        worlds.append(world_process(domain, run_file))
        peers = Peers(others)
        peers.spin_until(lambda: peers.ticks, "the first tick")
        return worlds[-1], peers

    yield make
    for world in worlds:
        end(world)


def world_process(domain_id: int, run_file: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [
            sys.executable,
            "-m",
            "ssp_ot_controller.ros.sil_world",
            "--ros-args",
            "-p",
            f"run_file:={run_file}",
        ],
        env=session_environment(domain_id),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_an_external_driver_is_waited_for_obeyed_and_missed(start: Start) -> None:
    fault = {"kind": "actuator_stuck", "target": "vut", "at_s": 0.1, "duration_s": 0.1, "value": 1}
    _, peers = start(driver={"cruise_mps": 10.0, "external": True}, faults=[fault])
    # Without its driver the VUT says nothing, so that no session can begin.
    peers.spin_until(lambda: len(peers.ticks) >= 5, "holding")
    assert not peers.vut
    peers.drives = True
    peers.spin_until(lambda: peers.vut, "the VUT's state")
    peers.answer(0)
    peers.spin_until(lambda: peers.step >= 50, "fifty steps")
    # One step is the driver's delay of one period; in the second half of a second it is at full.
    assert peers.ticks[-1].objects[-1].acceleration == pytest.approx(1.5, abs=0.1)
    assert peers.codes() == []
    # Its silence stops the world, until it is dropped and the VUT is braked to a standstill.
    peers.drives = False
    peers.spin_until(lambda: peers.safety, "its loss")
    assert peers.codes() == [(SafetyCode.PARTICIPANT_LOST, names.VUT_DRIVER)]
    peers.spin_until(
        lambda: peers.ticks[-1].objects[-1].speed == 0.0 and peers.step > 60, "standstill"
    )
    assert peers.codes() == [(SafetyCode.PARTICIPANT_LOST, names.VUT_DRIVER)]
    seen = [(f.source, f.fault, f.target, f.active, f.value, f.unit) for f in peers.faults]
    assert seen == [
        ("sil_world", "0 actuator_stuck", "vut", active, 1.0, "m/s^2") for active in (True, False)
    ]
    stamps = [f.header.stamp.nanosec for f in peers.faults]
    assert stamps == [100_000_000, 200_000_000]


def test_a_world_that_falls_behind_the_wall_clock_says_so(start: Start) -> None:
    world, peers = start(mode="realtime")
    peers.start_realtime()
    peers.spin_until(lambda: peers.step >= 3, "the first steps")
    os.kill(world.pid, signal.SIGSTOP)
    # What is tested is a stall of a certain length.
    time.sleep(3.0 * OVERRUN_S)
    os.kill(world.pid, signal.SIGCONT)
    peers.spin_until(lambda: peers.safety, "an event")
    (event,) = peers.safety
    assert (event.code, event.object_id) == (SafetyCode.OVERRUN, "sil_world")
    assert event.measured > event.limit == OVERRUN_S


def test_a_live_session_is_none_of_a_simulated_worlds(
    domain: int, tmp_path: Path, run_mapping: Callable[..., dict[str, Any]]
) -> None:
    (tmp_path / "run.yaml").write_text(json.dumps(run_mapping(mode="live")))
    world = world_process(domain, tmp_path / "run.yaml")
    _, error = world.communicate(timeout=DEADLINE_S)
    assert world.returncode == 1
    assert "mode: a live session has no simulated world" in error
    assert "Traceback" not in error


def test_a_driver_that_waits_for_its_model_is_not_lost_and_one_that_is_silent_is(
    start: Start,
) -> None:
    """The world holds at the frame's step for longer than it waits for a node, and says so."""
    driven = {"driver": "mine", "first_request_s": 0.0, "hand_over_s": 0.1, "end_s": 60.0}
    _, peers = start(driven=driven)
    peers.drives = True
    peers.spin_until(lambda: peers.vut, "the VUT's state")
    peers.answer(0)
    peers.spin_until(lambda: peers.step >= 20, "twenty steps")
    peers.drives = False
    nothing = math.nan
    held = msg.ActuatorCommand(object_id="vut", acceleration=nothing, heading=nothing)

    def wait() -> None:
        held.step = peers.step
        peers.driver.publish(held)

    waits = peers.node.create_timer(0.2, wait)
    began, at = len(peers.ticks), []

    def holds_for(seconds: int) -> bool:
        at[:] = [tick.step for tick in peers.ticks[began:]]
        return bool(at) and at.count(at[-1]) > seconds

    # The first is the step itself; then it is said once a second.
    peers.spin_until(lambda: holds_for(round(HANG_LIMIT_S) + 2), "a hold beyond the limit")
    assert len(set(at)) <= 2
    assert all(tick.running for tick in peers.ticks[began:])
    assert peers.codes() == []
    peers.drives = True
    peers.drive(peers.step)
    here = peers.step
    peers.spin_until(lambda: peers.step >= here + 10, "ten more steps")
    assert peers.codes() == []
    # Without a word it is lost, whatever it said before.
    waits.cancel()
    peers.drives = False
    peers.spin_until(lambda: peers.safety, "its loss")
    assert peers.codes() == [(SafetyCode.PARTICIPANT_LOST, names.VUT_DRIVER)]
