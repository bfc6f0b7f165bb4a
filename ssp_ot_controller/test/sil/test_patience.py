"""A participant is dropped when it doesn't answer, not when the machine leaves it no processor."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.safety.liveness import WORLD_SILENT_LOCKSTEP_S
from ssp_ot_controller.objects.pool import WORLD_HANG_S
from ssp_ot_controller.sil.patience import (
    BUSY_LIMIT_S,
    HANG_LIMIT_S,
    OWN_PAUSE_S,
    Patience,
    idle_s,
)

LOOK_S = 0.1


class Waiting:
    """A world that looks ten times a second, on a machine with so many processors to spare."""

    def __init__(self) -> None:
        self.patience = Patience(0)
        self.now_s = 0.0
        self.idle_s = 100.0
        self.patience.look(0, self.idle_s)

    def wait(self, seconds: float, spare: float, known: bool = True) -> None:
        for _ in range(round(seconds / LOOK_S)):
            self.now_s += LOOK_S
            self.idle_s += spare * LOOK_S
            self.patience.look(seconds_to_ns(self.now_s), self.idle_s if known else None)


@pytest.mark.parametrize("spare", [1.0, 7.5])
def test_one_that_does_not_answer_on_a_machine_with_a_processor_to_spare_is_lost(
    spare: float,
) -> None:
    waiting = Waiting()
    waiting.wait(HANG_LIMIT_S - LOOK_S, spare)
    assert not waiting.patience.may_end
    waiting.wait(2.0 * LOOK_S, spare)
    assert waiting.patience.passed_limit_s() == HANG_LIMIT_S
    assert waiting.patience.waited_s == pytest.approx(HANG_LIMIT_S + LOOK_S)


def test_one_that_a_saturated_machine_keeps_waiting_is_not_lost_before_the_longest_wait() -> None:
    waiting = Waiting()
    waiting.wait(BUSY_LIMIT_S - LOOK_S, 0.0)
    assert not waiting.patience.may_end
    waiting.wait(2.0 * LOOK_S, 0.0)
    assert waiting.patience.passed_limit_s() == BUSY_LIMIT_S


def test_time_counts_as_far_as_a_processor_was_to_spare() -> None:
    waiting = Waiting()
    waiting.wait(4.0, 0.0)
    waiting.wait(4.0, 0.5)
    assert not waiting.patience.may_end
    waiting.wait(1.2, 1.0)
    assert waiting.patience.passed_limit_s() == HANG_LIMIT_S


def test_the_camera_may_draw_for_long_on_any_machine() -> None:
    waiting = Waiting()
    waiting.wait(BUSY_LIMIT_S - LOOK_S, 1.0)
    assert waiting.patience.passed_limit_s(draws=True) is None
    waiting.wait(2.0 * LOOK_S, 1.0)
    assert waiting.patience.passed_limit_s(draws=True) == BUSY_LIMIT_S


def test_all_time_counts_where_the_kernel_tells_nothing() -> None:
    waiting = Waiting()
    waiting.wait(HANG_LIMIT_S + 2.0 * LOOK_S, 0.0, known=False)
    assert waiting.patience.passed_limit_s() == HANG_LIMIT_S


def test_a_pause_of_the_world_counts_for_little_and_nothing_is_judged_before_the_next_look() -> (
    None
):
    waiting = Waiting()
    waiting.wait(HANG_LIMIT_S - LOOK_S, 1.0)
    waiting.now_s += BUSY_LIMIT_S + OWN_PAUSE_S
    waiting.wait(LOOK_S, 1.0)
    assert waiting.patience.waited_s == pytest.approx(HANG_LIMIT_S - LOOK_S + OWN_PAUSE_S)
    assert not waiting.patience.may_end
    waiting.wait(2.0 * LOOK_S, 1.0)
    assert waiting.patience.passed_limit_s() == HANG_LIMIT_S


def test_a_world_that_is_itself_kept_waiting_again_and_again_drops_the_dead_in_time() -> None:
    waiting = Waiting()
    for look in itertools.count(1):
        waiting.now_s += OWN_PAUSE_S if look % 34 == 0 else 0.0
        waiting.wait(LOOK_S, 0.0)
        if waiting.patience.may_end:
            break
        assert waiting.now_s < min(WORLD_HANG_S, WORLD_SILENT_LOCKSTEP_S)
    assert waiting.now_s == pytest.approx(BUSY_LIMIT_S, abs=0.5)


def test_a_camera_that_is_lost_beside_another_one_is_dropped_after_its_own_limit() -> None:
    waiting, lost, dropped = Waiting(), ["front_camera", "ot1"], {}
    while lost:
        waiting.wait(LOOK_S, 1.0)
        if waiting.patience.may_end:
            now_ns = seconds_to_ns(waiting.now_s)
            for one in waiting.patience.overdue(lost, "front_camera", now_ns):
                lost.remove(one)
                dropped[one] = waiting.now_s
    assert dropped["ot1"] == pytest.approx(HANG_LIMIT_S, abs=2.0 * LOOK_S)
    assert dropped["front_camera"] == pytest.approx(BUSY_LIMIT_S, abs=2.0 * LOOK_S)
    assert waiting.patience.waited_s == 0.0


def test_an_answer_begins_a_new_wait_between_two_looks() -> None:
    waiting = Waiting()
    waiting.wait(HANG_LIMIT_S, 1.0)
    waiting.patience.begin(seconds_to_ns(waiting.now_s + LOOK_S / 2.0))
    waiting.wait(LOOK_S, 1.0)
    assert waiting.patience.waited_s == pytest.approx(LOOK_S / 2.0)


def test_the_world_drops_a_participant_before_others_take_the_world_for_dead() -> None:
    assert min(WORLD_HANG_S, WORLD_SILENT_LOCKSTEP_S) > BUSY_LIMIT_S + 2.0 * LOOK_S


def test_idle_time_is_read_from_the_line_of_all_processors(tmp_path: Path) -> None:
    stat = tmp_path / "stat"
    stat.write_text("cpu  100 0 100 4200 17 0 0 0 0 0\ncpu0 50 0 50 2100 8 0 0 0 0 0\n")
    read_s = idle_s(stat)
    stat.write_text("cpu  100 0 100 4300 17 0 0 0 0 0\n")
    later_s = idle_s(stat)
    assert read_s is not None
    assert later_s == pytest.approx(read_s * 4300 / 4200)
    for text in ("", "cpu  1 2", "cpu  a b c d e"):
        stat.write_text(text)
        assert idle_s(stat) is None
    assert idle_s(tmp_path / "missing") is None
    here_s = idle_s()
    assert here_s is None or here_s < 1e3 * NS_PER_S
