"""States that are late, ahead of time, or don't follow from those before, in a whole session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.state import Size
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase, Verdict

MS = 1_000_000
S = 1_000_000_000


@pytest.mark.parametrize("who", ["vut", "ot1"])
def test_a_clock_that_was_wrong_for_a_moment_leaves_no_abort_without_end(
    driver: Any, tools: Any, who: str
) -> None:
    driver.until("RUNNING")
    driver.acknowledge()
    driver.step()
    hear = driver.session.on_vut_state if who == "vut" else driver.session.on_target_state
    ahead = driver.vut if who == "vut" else driver.targets[who]
    hear(replace(ahead, stamp_ns=driver.now_ns + 1000 * S))
    driver.session.step(driver.now_ns)
    assert tools.violations(driver.session.outbox) == [SafetyCode.CLOCK_OFFSET]
    # What was heard with the wrong stamp is no standstill; what comes with the right one is.
    assert driver.session.state is SessionPhase.ABORTING
    driver.session.step(driver.now_ns)
    assert driver.session.state is SessionPhase.ABORTING
    driver.step(control_state=ControlState.ABORTING)
    assert driver.session.state is SessionPhase.ABORTED
    assert driver.command("all_clear").accepted


# -- states that don't follow from those before them ----------------------------------------------


def strict(run_mapping: dict[str, Any]) -> RunSpec:
    run_mapping["limits"] |= {"jump_m": 1.0, "frozen_s": 0.25}
    return RunSpec.model_validate(run_mapping)


@pytest.mark.parametrize("who", ["vut", "ot1"])
@pytest.mark.parametrize("phase", ["ARMED", "RUNNING"])
def test_a_position_that_jumps(
    make_driver: Callable[[RunSpec], Any],
    run_mapping: dict[str, Any],
    tools: Any,
    phase: str,
    who: str,
) -> None:
    driver = make_driver(strict(run_mapping))
    driver.until(phase)
    driver.acknowledge()
    driver.step()
    before = driver.vut if who == "vut" else driver.targets[who]
    driver.move(who, x_m=before.x_m - 1.0)
    driver.step()
    assert driver.session.state.name == phase
    driver.move(who, x_m=before.x_m + 0.5)
    driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.POSITION_JUMP]
    assert driver.session.verdict is Verdict.FAILED_SAFETY
    assert driver.session.reasons[0].startswith(f"position_jump: {who}: 1.5 m")


@pytest.mark.parametrize("who", ["vut", "ot1"])
@pytest.mark.parametrize("phase", ["ARMED", "RUNNING"])
def test_a_thin_notch_of_the_fence_between_two_states(
    make_driver: Callable[[RunSpec], Any],
    run_mapping: dict[str, Any],
    tools: Any,
    phase: str,
    who: str,
) -> None:
    """Neither state is outside, but what is swept from one to the other is."""
    start = make_driver(strict(run_mapping))
    before = start.vut if who == "vut" else start.targets[who]
    at_m, low_m = before.x_m + before.size.front_m + 0.1, before.y_m + 0.5
    for corner_m, found in ((low_m, [SafetyCode.OUTSIDE_GEOFENCE]), (low_m + 0.4, [])):
        fence = [tuple(corner) for corner in run_mapping["geofence"]]
        wall = [(at_m + 0.001, 10.0), (at_m + 0.001, corner_m), (at_m, corner_m), (at_m, 10.0)]
        assert fence[2:] == [(300.0, 10.0), (-10.0, 10.0)]
        run = strict({**run_mapping, "geofence": [*fence[:3], *wall, fence[3]]})
        driver = make_driver(run)
        driver.until(phase)
        driver.acknowledge()
        driver.step()
        # Its front left corner passes by the end of the wall.
        driver.move(who, x_m=before.x_m + 0.6, y_m=before.y_m - 0.6)
        driver.step()
        assert tools.violations(driver.session.outbox) == found


@pytest.mark.parametrize("who", ["vut", "ot1"])
def test_a_position_that_stands_while_its_object_moves(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any], tools: Any, who: str
) -> None:
    driver = make_driver(strict(run_mapping))
    driver.until("RUNNING")
    driver.acknowledge()
    driver.move(who, speed_mps=5.0)
    for _ in range(13):  # the first is where it stands from; 12 periods are 0.24 s
        driver.step()
        assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.STATE_FROZEN]


def test_what_jumped_before_the_arming_is_forgotten(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any]
) -> None:
    driver = make_driver(strict(run_mapping))
    driver.until("CONNECTED")
    driver.move("ot1", x_m=90.0)
    driver.step()
    driver.move("ot1", x_m=40.0)
    driver.step()
    assert driver.command("arm").accepted
    driver.step()
    assert driver.session.state is SessionPhase.ARMED


def test_the_order_of_arrival_decides_nothing(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any]
) -> None:
    """Two positions jump in one step; whichever state comes first, the reasons are the same."""
    told = []
    for order in (1, -1):
        driver = make_driver(strict(run_mapping))
        driver.until("RUNNING")
        driver.acknowledge()
        driver.step()
        driver.now_ns += 20 * MS
        states = [
            replace(driver.vut, stamp_ns=driver.now_ns, x_m=3.0),
            replace(driver.targets["ot1"], stamp_ns=driver.now_ns, x_m=50.0),
        ]
        for state in states[::order]:
            if state.object_id == "vut":
                driver.session.on_vut_state(state)
            else:
                driver.session.on_target_state(state)
        driver.session.step(driver.now_ns)
        told.append(driver.session.reasons)
    assert told[0] == told[1]
    assert len(told[0]) == 2


# -- clocks ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("who", ["vut", "ot1"])
@pytest.mark.parametrize(
    ("mode", "ahead_ms", "passed"),
    [
        ("lockstep", 50, False),
        ("lockstep", 51, True),
        ("live", 51, True),
        # Session time itself is a step behind until the tick has come.
        ("realtime", 70, False),
        ("realtime", 71, True),
    ],
)
def test_a_state_from_the_future(
    make_driver: Callable[[RunSpec], Any],
    run: RunSpec,
    tools: Any,
    who: str,
    mode: str,
    ahead_ms: int,
    passed: bool,
) -> None:
    driver = make_driver(run.model_copy(update={"mode": mode}))
    driver.until("RUNNING")
    driver.acknowledge()
    driver.step()
    state = driver.vut if who == "vut" else driver.targets[who]
    early = replace(state, stamp_ns=driver.now_ns + ahead_ms * MS)
    assert driver.session.on_vut_state(early) or driver.session.on_target_state(early)
    driver.session.step(driver.now_ns)
    expected = [SafetyCode.CLOCK_OFFSET] if passed else []
    assert tools.violations(driver.session.outbox) == expected


def test_a_clock_that_was_set_right_is_believed_before_the_run(driver: Any) -> None:
    """A stamp from far ahead must not keep out all that come after it."""
    driver.until("CONNECTED")
    driver.session.on_vut_state(driver.state("vut", stamp_ns=3600 * S))
    assert not driver.command("arm").accepted
    driver.hear()
    assert driver.command("arm").accepted


@pytest.mark.parametrize("who", ["vut", "ot1"])
@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"x_m": 5.0}, SafetyCode.POSITION_JUMP),
        ({"speed_mps": 8.0}, SafetyCode.STATE_FROZEN),
        ({"size": Size(0.3, 0.3, 0.3, 0.3)}, SafetyCode.STATE_CONTRADICTS),
    ],
)
def test_a_stamp_from_far_ahead_before_the_run_hides_nothing_in_it(
    make_driver: Callable[[RunSpec], Any],
    run_mapping: dict[str, Any],
    tools: Any,
    changed: dict[str, Any],
    code: SafetyCode,
    who: str,
) -> None:
    driver = make_driver(strict(run_mapping))
    driver.until("CONNECTED")
    state = driver.vut if who == "vut" else driver.targets[who]
    ahead = replace(state, stamp_ns=18 * S)
    assert driver.session.on_vut_state(ahead) or driver.session.on_target_state(ahead)
    driver.step()
    assert driver.command("arm").accepted
    driver.step(control_state=ControlState.ARMED)
    assert driver.command("start").accepted
    driver.step(control_state=ControlState.RUNNING)
    driver.acknowledge()
    driver.move(who, **changed)
    for _ in range(14):
        driver.step()
    assert tools.violations(driver.session.outbox)[0] is code


# -- strangers ------------------------------------------------------------------------------------
