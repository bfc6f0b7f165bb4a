"""The world steps, holds and gives participants up, by a clock that the test sets."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from ssp_core import names
from ssp_core.cdr.steps import BodyCommand, StepDone
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.sil.pacing import DRIVER_FRESH_S, HOLD_TOLD_S, OVERRUN_S, Pacing
from ssp_ot_controller.sil.patience import BUSY_LIMIT_S, HANG_LIMIT_S
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S
from ssp_ot_controller.sil.world import World
from tests.support.runs import APPROACH, small_run

EXTERNAL = {"driver": {"cruise_mps": 10.0, "external": True}}
DRIVEN = {"driven": {"driver": "mine", "first_request_s": 0.0, "hand_over_s": 0.1, "end_s": 60.0}}
LOOK_S = 0.1


class Empty:
    """A scene without traffic."""

    def step(self, _poses: list[ObjectState]) -> list[ObjectState]:
        return []

    def traffic(self) -> list[ObjectState]:
        return []


class Paced:
    """A world's pacing, with a steady clock and a processor to spare."""

    def __init__(self, **changes: Any) -> None:
        self.run = RunSpec.model_validate(small_run(**APPROACH, **changes))
        self.world = World(self.run, Empty())
        self.now_s = 0.0
        self.pacing = Pacing(self.run, 0)
        self.pacing.look(0, 0.0)

    @property
    def now_ns(self) -> int:
        return seconds_to_ns(self.now_s)

    @property
    def lost(self) -> list[tuple[str, float]]:
        """Those that are dropped now, each with its limit, s."""
        dropped = self.pacing.drop_the_lost(self.step, self.world.now_ns, self.now_ns)
        return [(limit.object_id, limit.limit) for limit in dropped]

    @property
    def step(self) -> int:
        return self.world.step_index

    def done(self, who: str, session: SessionPhase = SessionPhase.UNKNOWN, beat: int = 0) -> None:
        self.pacing.on_done(StepDone(who, self.step, beat, session), self.now_ns)

    def objects(self) -> None:
        """Objects and recorder answer the present step."""
        self.done(names.OBJECT_TARGET)
        self.done(names.MONITOR)
        self.pacing.on_command(BodyCommand("ot1", self.step, 0.0, 0.0, 0.0, False))

    def drive(self, finite: bool = True) -> bool:
        command = BodyCommand(names.VUT_ID, self.step, 1.0, 0.0, 0.0, False)
        return self.pacing.on_driver(command, finite, self.now_ns)

    def start(self) -> None:
        self.objects()
        self.done(names.SCENARIO_MANAGER, SessionPhase.RUNNING, 7)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / LOOK_S)):
            self.now_s += LOOK_S
            self.pacing.look(self.now_ns, self.now_s)

    def advance(
        self, commands: Mapping[str, tuple[int, Command]], manager_lost: bool = False
    ) -> list[tuple[SafetyCode, str, float]]:
        """Make a step; return the limits that it shows passed."""
        self.world.advance(commands, drive_vut=not manager_lost)
        seen = self.pacing.on_step(self.world, manager_lost, self.now_ns)
        return [(limit.code, limit.object_id, limit.limit) for limit in seen]


def test_a_step_needs_the_managers_word_and_every_answer_to_it() -> None:
    paced = Paced()
    assert not paced.pacing.may_start(0)
    paced.objects()
    assert paced.pacing.may_start(0)
    assert not paced.pacing.may_step(0)
    paced.done(names.SCENARIO_MANAGER, SessionPhase.ARMED, 6)
    assert (paced.pacing.session, paced.pacing.running) == (SessionPhase.ARMED, False)
    assert not paced.pacing.may_step(0)
    paced.done(names.SCENARIO_MANAGER, SessionPhase.RUNNING, 7)
    assert (paced.pacing.running, paced.pacing.heartbeat) == (True, 7)
    assert paced.pacing.may_step(0)
    paced.advance({})
    assert not paced.pacing.may_step(1)


def test_in_real_time_answers_move_nothing_and_heartbeats_keep_the_manager() -> None:
    paced = Paced(mode="realtime")
    paced.pacing.take_session(SessionPhase.RUNNING, 0)
    paced.objects()
    paced.done(names.SCENARIO_MANAGER, SessionPhase.FINISHED, 9)
    assert (paced.pacing.session, paced.pacing.heartbeat) == (SessionPhase.RUNNING, 0)
    assert not paced.pacing.may_step(0)
    limit_ns = seconds_to_ns(paced.run.limits.heartbeat_s)
    assert not paced.pacing.manager_lost(limit_ns)
    assert paced.pacing.manager_lost(limit_ns + 1)
    paced.pacing.on_heartbeat(limit_ns)
    assert not paced.pacing.manager_lost(2 * limit_ns)
    paced.wait(2.0 * BUSY_LIMIT_S)
    assert paced.lost == []


def test_the_world_falls_behind_the_wall_clock_once() -> None:
    paced = Paced(mode="realtime")
    start_ns = seconds_to_ns(5.0)
    paced.pacing.take_session(SessionPhase.RUNNING, start_ns)
    # A second word of the same doesn't begin it anew.
    paced.pacing.take_session(SessionPhase.RUNNING, 2 * start_ns)
    world_ns, limit_ns = seconds_to_ns(3.0), seconds_to_ns(OVERRUN_S)
    assert paced.pacing.overrun(world_ns, start_ns + world_ns + limit_ns) is None
    late = paced.pacing.overrun(world_ns, start_ns + world_ns + 2 * limit_ns)
    assert late is not None
    assert (late.code, late.object_id, late.source) == (
        SafetyCode.OVERRUN,
        names.SIL_WORLD,
        names.SIL_WORLD,
    )
    assert (late.measured, late.limit, late.stamp_ns) == (0.2, OVERRUN_S, world_ns)
    assert paced.pacing.overrun(world_ns, start_ns + world_ns + 3 * limit_ns) is None


@pytest.mark.parametrize("phase", [SessionPhase.FINISHED, SessionPhase.ABORTED, SessionPhase.IDLE])
def test_a_session_that_is_over_steps_until_everything_stands_and_never_again(
    phase: SessionPhase,
) -> None:
    paced = Paced()
    paced.start()
    for _ in range(30):
        paced.advance({})
    assert not paced.world.all_stand()
    paced.done(names.SCENARIO_MANAGER, phase)
    paced.advance({})
    assert paced.pacing.running
    while not paced.world.all_stand():
        assert paced.pacing.running
        paced.advance({}, manager_lost=True)
    assert not paced.pacing.running
    paced.done(names.SCENARIO_MANAGER, SessionPhase.RUNNING)
    assert not paced.pacing.running


def test_who_is_silent_is_dropped_and_the_world_goes_on_without() -> None:
    paced = Paced()
    paced.start()
    paced.advance({})
    assert not paced.pacing.has_dropped()
    paced.wait(HANG_LIMIT_S + 2 * LOOK_S)
    # The manager answers when the others have.
    assert paced.lost == [(names.OBJECT_TARGET, HANG_LIMIT_S)]
    assert paced.pacing.has_dropped()
    assert not paced.pacing.manager_lost(paced.now_ns)
    assert paced.lost == []
    paced.wait(HANG_LIMIT_S + 2 * LOOK_S)
    assert paced.lost == [(names.SCENARIO_MANAGER, HANG_LIMIT_S)]
    assert paced.pacing.manager_lost(paced.now_ns)
    assert paced.pacing.may_step(1)


def test_a_recorder_that_hangs_is_dropped_without_a_word() -> None:
    paced = Paced()
    paced.start()
    while True:
        # Recorder aside, each step is answered.
        paced.done(names.OBJECT_TARGET)
        paced.pacing.on_command(BodyCommand("ot1", paced.step, 0.0, 0.0, 0.0, False))
        paced.done(names.SCENARIO_MANAGER, SessionPhase.RUNNING)
        if not paced.pacing.may_step(paced.step):
            break
        paced.advance({})
    paced.wait(HANG_LIMIT_S + 2 * LOOK_S)
    assert paced.lost == []
    assert paced.pacing.has_dropped()
    assert paced.pacing.may_step(paced.step)


def test_an_external_driver_is_heard_before_the_start_obeyed_and_missed() -> None:
    paced = Paced(**EXTERNAL)
    paced.objects()
    assert not paced.pacing.may_start(0)
    # Of the state before the start none is driven by.
    assert not paced.drive()
    assert paced.pacing.may_start(seconds_to_ns(DRIVER_FRESH_S))
    assert not paced.pacing.may_start(seconds_to_ns(DRIVER_FRESH_S) + 1)
    paced.start()
    assert paced.pacing.may_step(0)
    limit = (SafetyCode.PARTICIPANT_LOST, names.VUT_DRIVER, DRIVER_TIMEOUT_S)
    told = [one for _ in range(40) for one in paced.advance({"vut": (0, Command(1.0, 0.0, 0.0))})]
    assert told == [limit]
    assert paced.drive()


def test_a_driver_that_was_dropped_is_not_missed_a_second_time() -> None:
    paced = Paced(**EXTERNAL)
    paced.drive()
    paced.start()
    paced.advance({})
    paced.objects()
    paced.wait(HANG_LIMIT_S + 2 * LOOK_S)
    assert paced.lost == [(names.VUT_DRIVER, HANG_LIMIT_S)]
    assert [one for _ in range(40) for one in paced.advance({})] == []


def test_a_model_is_waited_for_as_long_as_its_driver_says_so() -> None:
    paced = Paced(**DRIVEN)
    assert not paced.drive(finite=False)
    assert paced.drive()
    paced.start()
    paced.advance({})
    paced.objects()
    told = 0
    for _ in range(round(2.0 * BUSY_LIMIT_S / LOOK_S)):
        paced.drive(finite=False)
        paced.wait(LOOK_S)
        told += paced.pacing.is_hold_report_due(paced.step, paced.now_ns)
        assert paced.lost == []
    assert told == pytest.approx(2.0 * BUSY_LIMIT_S / HOLD_TOLD_S, abs=2)
    # Its word ages.
    paced.wait(BUSY_LIMIT_S + 2 * LOOK_S)
    assert not paced.pacing.is_hold_report_due(paced.step, paced.now_ns)
    assert [who for who, _ in paced.lost] == [names.VUT_DRIVER]
