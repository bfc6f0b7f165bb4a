"""The world goes on exactly when everybody who is waited for has answered."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.cdr.steps import RECORDER_LAG_STEPS
from ssp_ot_controller.sil.patience import DriverHold
from ssp_ot_controller.sil.world import StepBarrier

OT, MANAGER, CAMERA = "object_target", "scenario_manager", "front_camera"


def barrier(
    camera: str | None = None, frame_steps: int = 5, objects: Any = ("ot1",)
) -> StepBarrier:
    return StepBarrier((OT, MANAGER), objects, OT, camera, frame_steps, MANAGER)


def answer(b: StepBarrier, step: int) -> None:
    b.on_command("ot1", step)
    b.on_done(OT, step)
    b.on_done(MANAGER, step)


def test_a_run_may_start_when_everybody_but_its_leader_is_heard() -> None:
    b = StepBarrier((OT, MANAGER), ("ot1",), OT, CAMERA, 5, MANAGER, "monitor")
    assert b.unheard() == [OT, "monitor", CAMERA]
    b.on_done(OT, 0)
    b.on_done("monitor", 0)
    assert b.unheard() == [OT, CAMERA]
    b.on_command("ot1", 0)
    assert b.unheard() == [CAMERA]
    b.on_done(CAMERA, 0)
    assert b.unheard() == []


def test_a_camera_that_draws_every_step_is_missed_once() -> None:
    assert barrier(camera=CAMERA, frame_steps=1).unheard() == [OT, CAMERA]


def test_each_participant_and_each_command_is_waited_for() -> None:
    b = barrier(objects=("ot1", "ot2"))
    assert b.waiting_for(1) == [OT, MANAGER]
    b.on_done(OT, 1)
    b.on_done(MANAGER, 1)
    assert b.waiting_for(1) == [OT]  # its commands are on another topic
    b.on_command("ot1", 1)
    assert b.waiting_for(1) == [OT]
    b.on_command("ot2", 1)
    assert b.waiting_for(1) == []
    assert b.waiting_for(2) == [OT, MANAGER]


def test_old_and_foreign_answers_do_not_count() -> None:
    b = barrier()
    answer(b, 2)
    b.on_done(OT, 1)
    b.on_command("ot1", 1)
    assert b.waiting_for(2) == []
    b.on_done("monitor", 9)
    b.on_command("ot9", 9)
    assert b.waiting_for(3) == [OT, MANAGER]


def test_who_is_dropped_is_not_waited_for_any_more() -> None:
    b = barrier(camera=CAMERA, frame_steps=1)
    for name in (MANAGER, CAMERA, OT):
        assert name in b.waiting_for(5)
        b.drop(name)
        assert name not in b.waiting_for(5)
    assert b.dropped == {OT, MANAGER, CAMERA}


@pytest.mark.parametrize("frame_steps", [1, 4, 5])
def test_the_camera_may_lag_by_one_frame(frame_steps: int) -> None:
    """The newest frame at or before k + 1 - frame_steps must be there to leave step k."""
    for step in range(1, 40):
        due = list(range(0, step + 2 - frame_steps, frame_steps))
        b = barrier(camera=CAMERA, frame_steps=frame_steps)
        answer(b, step)
        assert (CAMERA in b.waiting_for(step)) == bool(due)
        if due:
            if due[-1] > 0:
                b.on_done(CAMERA, due[-1] - frame_steps)
                assert b.waiting_for(step) == [CAMERA]
            b.on_done(CAMERA, due[-1])
            assert b.waiting_for(step) == []


def test_the_world_never_runs_ahead_of_the_camera_by_more_than_a_frame() -> None:
    b = barrier(camera=CAMERA, frame_steps=5)
    step = 0
    answer(b, step)
    for frame in range(0, 50, 5):
        while not b.waiting_for(step):
            step += 1
            answer(b, step)
        assert b.waiting_for(step) == [CAMERA]
        assert step == frame + 4
        b.on_done(CAMERA, frame)


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_any_order_of_answers_opens_it_with_the_last(data: st.DataObject) -> None:
    objects = ["ot1", "ot2"]
    b = StepBarrier((OT, MANAGER), objects, OT, CAMERA, 1, MANAGER)
    for step in range(1, 4):
        messages = [(b.on_done, name) for name in (OT, MANAGER)]
        messages += [(b.on_command, name) for name in objects]
        messages += [(b.on_done, CAMERA)]
        for deliver, name in data.draw(st.permutations(messages)):
            assert b.waiting_for(step)
            deliver(name, step)
        assert b.waiting_for(step) == []


def test_the_leader_is_lost_only_when_nobody_else_is() -> None:
    b = StepBarrier((OT, MANAGER), ("ot1",), OT, None, 1, MANAGER)
    assert b.lost(1) == [OT]
    b.drop(OT)
    assert b.lost(1) == [MANAGER]


def test_a_recorder_is_waited_for_once_it_was_heard_and_may_lag() -> None:
    b = StepBarrier((OT, MANAGER), ("ot1",), OT, None, 1, MANAGER, "monitor")
    answer(b, 500)
    assert b.waiting_for(500) == []
    b.on_done("monitor", 0)
    assert b.waiting_for(RECORDER_LAG_STEPS) == []
    assert b.waiting_for(RECORDER_LAG_STEPS + 1) == ["monitor"]
    b.on_done("monitor", 5)
    b.on_done("monitor", 0)  # an older one that came late
    assert b.waiting_for(5 + RECORDER_LAG_STEPS) == []
    assert b.lost(6 + RECORDER_LAG_STEPS) == ["monitor"]
    b.drop("monitor")
    assert b.waiting_for(500) == []


def test_a_hold_lasts_as_long_as_its_driver_says_so_and_is_told_once_a_period() -> None:
    hold = DriverHold(limit_s=3.0, period_s=1.0)
    second = 1_000_000_000
    hold.wait(7)
    assert not hold.is_at(7, second)  # nothing was heard yet
    hold.hear(second)
    assert hold.is_at(7, 4 * second)
    assert not hold.is_at(8, 4 * second)
    assert not hold.is_at(7, 4 * second + 1)
    told = [hold.is_report_due(k * second // 2, holds=k > 2) for k in range(8)]
    assert told == [False, False, False, False, True, False, True, False]


def test_a_driver_that_waits_before_a_model_can_be_asked_holds_nothing() -> None:
    hold = DriverHold(limit_s=3.0, period_s=1.0, first_step=1)
    hold.hear(0)
    hold.wait(0)
    assert not hold.is_at(0, 0)
    hold.wait(1)
    assert hold.is_at(1, 0)
