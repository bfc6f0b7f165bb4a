"""A session that ends because the machine kept a process waiting says so, and blames no object."""

from __future__ import annotations

import math
import os

import pytest

from ssp_core import names
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.run.over_dds.processor_waits import (
    ProcessorWaits,
    waited_ns,
    with_busy_machine,
)
from ssp_scenario_manager.session.run_script import RunOutcome

MS = 1_000_000
S = 1000 * MS
LOOK_NS = 50 * MS
LIMIT_S = 0.5
SILENT = int(SafetyCode.OBJECT_SILENT)


def waits(*steps_ms: float, node: str = names.OBJECT_TARGET) -> ProcessorWaits:
    """Looks each 50 ms up to 10 s, before which a node waited so long more."""
    made, total_ns = ProcessorWaits(), 0
    begin_ns = 10 * S - len(steps_ms) * LOOK_NS
    made.look({node: 0}, begin_ns)
    for k, step_ms in enumerate(steps_ms, 1):
        total_ns += round(step_ms * MS)
        made.look({node: total_ns}, begin_ns + k * LOOK_NS)
    return made


@pytest.mark.parametrize(
    ("steps_ms", "busy"),
    [
        ((0, 0, 600, 0), True),  # one wait of 0.55 s at least
        ((0, 0, 451, 0), True),
        ((0, 0, 450, 0), False),  # 0.4 s of the limit of 0.5 s
        ((40,) * 60, False),  # always a little, as on each busy machine
        ((), False),
    ],
)
def test_one_long_wait_is_the_reason_and_many_short_ones_are_none(
    steps_ms: tuple[float, ...], busy: bool
) -> None:
    reason = waits(*steps_ms).too_busy(SILENT, "ot1", LIMIT_S, 10 * S)
    assert bool(reason) is busy
    if busy:
        assert reason.startswith("overrun: the machine was too busy: object_target waited 0.")
        assert reason.endswith("(instead of object_silent of ot1)")


@pytest.mark.parametrize(
    ("code", "who", "node", "busy"),
    [
        (SafetyCode.VUT_SILENT, names.VUT_ID, names.SIL_WORLD, True),
        (SafetyCode.VUT_SILENT, names.VUT_ID, names.VUT_ADAPTER, True),
        (SafetyCode.VUT_SILENT, names.VUT_ID, names.OBJECT_TARGET, False),
        (SafetyCode.RECORDER, names.MONITOR, names.MONITOR, True),
        (SafetyCode.STATE_STALE, "ot1", names.SCENARIO_MANAGER, True),
        (SafetyCode.OVER_SPEED, "ot1", names.OBJECT_TARGET, False),
        (SafetyCode.COLLISION, "ot1", names.OBJECT_TARGET, False),
        (SafetyCode.OPERATOR, "", names.SCENARIO_MANAGER, False),
    ],
)
def test_only_what_a_wait_can_cause_is_excused_by_it(
    code: SafetyCode, who: str, node: str, busy: bool
) -> None:
    assert bool(waits(900, node=node).too_busy(int(code), who, LIMIT_S, 10 * S)) is busy


@pytest.mark.parametrize(("at_s", "busy"), [(9.0, True), (8.9, False), (11.5, True), (11.6, False)])
def test_a_wait_of_another_time_is_no_reason(at_s: float, busy: bool) -> None:
    found = waits(900).too_busy(SILENT, "ot1", LIMIT_S, round(at_s * S))
    assert bool(found) is busy


def test_a_limit_that_is_no_number_or_has_no_end_is_passed_by_no_wait() -> None:
    for limit_s in (math.inf, math.nan):
        assert waits(900).too_busy(int(SafetyCode.OPERATOR), "", limit_s, 10 * S) == ""


def test_the_machine_comes_first_and_the_rest_stays() -> None:
    ended = RunOutcome(Verdict.ABORTED, ("object_silent: ot1: 0.55 s, limit 0.5 s",))
    found = with_busy_machine(ended, "overrun: the machine was too busy")
    assert found.verdict is Verdict.INVALID_HARNESS
    assert found.reasons == ("overrun: the machine was too busy", *ended.reasons)
    assert with_busy_machine(ended, "") is ended
    valid = RunOutcome(Verdict.VALID, ())
    assert with_busy_machine(valid, "overrun: the machine was too busy") is valid


def test_what_the_kernel_says_of_a_process_is_read() -> None:
    if not os.path.exists("/proc/self/schedstat"):
        pytest.skip("this kernel doesn't count waits")
    assert (waited_ns(os.getpid()) or 0) >= 0
    assert waited_ns(2**22 + 1) is None


def test_what_counts_losses_has_no_time_to_wait_for() -> None:
    assert (
        waits(900, node="monitor").too_busy(int(SafetyCode.RECORDER), "monitor", 0.0, 10 * S) == ""
    )
