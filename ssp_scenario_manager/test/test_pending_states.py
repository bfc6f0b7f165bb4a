"""States of many objects that wait while a trigger is judged, and triggers before all else."""

from __future__ import annotations

from typing import Any

import pytest

from ssp_core.cdr.states import StateArray, encode_states
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session.inputs import PendingStates

MS = 1_000_000


def message(*states: Any) -> bytes:
    return encode_states(StateArray(states[-1].stamp_ns, "object_target", states))


def test_the_state_that_arrived_last_counts(state: Any) -> None:
    arrivals = PendingStates()
    arrivals.put(message(state("ot1", x_m=1.0), state("ot2")), 10)
    arrivals.put(message(state("ot1", x_m=2.0)), 20)
    arrivals.put(b"broken", 30)
    newest = arrivals.newest("ot1")
    assert newest is not None
    assert newest.x_m == 2.0
    assert arrivals.newest("ot2") == state("ot2")
    assert arrivals.newest("ot3") is None
    assert [steady_ns for _, steady_ns in arrivals.take()] == [10, 20, 30]
    assert arrivals.newest("ot1") is None
    assert arrivals.take() == []


def test_what_waits_covers_what_is_known_unless_it_is_older(state: Any) -> None:
    known = {name: state(name, stamp_ns=50 * MS) for name in ("ot1", "ot2", "ot3")}
    arrivals = PendingStates()
    assert arrivals.over(known) is known
    arrivals.put(message(state("ot1", stamp_ns=60 * MS), state("ot2", stamp_ns=40 * MS)), 0)
    over = arrivals.over(known)
    assert over["ot1"].stamp_ns == 60 * MS
    assert over["ot2"].stamp_ns == 50 * MS
    assert over.get("ot3") == known["ot3"]
    assert over.get("stranger") is None
    assert "ot3" in over
    assert "stranger" not in over
    arrivals.put(message(state("late")), 0)
    assert "late" in over
    assert list(over) == list(known)
    assert len(over) == 3


def near(driver: Any) -> None:
    """A run in which the next state of the VUT fires the trigger: the gap falls below 12 m."""
    driver.until("RUNNING")
    driver.acknowledge()
    for k in range(20):
        x_m = max(0.0, 22.8 - 2.5 * (19 - k))
        driver.move("vut", x_m=x_m, speed_mps=10.0 if x_m > 0.0 else 0.0)
        driver.step(250 * MS)
    driver.move("vut", x_m=23.0)
    driver.move("ot1", speed_mps=7.0)
    driver.step()
    assert driver.session.outbox == []
    driver.now_ns += 20 * MS


def test_a_trigger_is_judged_before_the_states_of_the_targets_are_taken_in(
    driver: Any, state: Any
) -> None:
    near(driver)
    driver.session.on_vut_state(
        state("vut", stamp_ns=driver.now_ns, x_m=23.2, speed_mps=10.0, sequence=9)
    )
    arrivals = PendingStates()
    waiting = state(
        "ot1", stamp_ns=driver.now_ns, x_m=39.0, speed_mps=7.0, control_state=ControlState.RUNNING
    )
    arrivals.put(message(waiting), 0)
    driver.session.outbox += driver.session.judge_triggers(
        driver.now_ns, arrivals.over(driver.session.targets)
    )
    # With the states that were taken in, the gap would be 12.3 m.
    dispatched, fired = driver.acknowledge()
    assert isinstance(dispatched, Reference)
    assert fired.samples[-1].value == pytest.approx(39.0 - 0.9 - 23.2 - 3.6)
    driver.session.on_target_state(waiting)
    driver.session.step(driver.now_ns)
    assert driver.session.outbox == []


def test_a_state_that_does_not_follow_from_the_last_one_fires_no_trigger(
    make_driver: Any, run: RunSpec, tools: Any
) -> None:
    limits = run.limits.model_copy(update={"jump_m": 1.0})
    driver = make_driver(run.model_copy(update={"limits": limits}))
    near(driver)
    driver.move("vut", x_m=26.0)
    driver.hear()
    driver.session.outbox += driver.session.judge_triggers(driver.now_ns)
    assert driver.session.outbox == []
    driver.session.step(driver.now_ns)
    assert tools.violations(driver.session.outbox) == [SafetyCode.POSITION_JUMP]
    assert not any(isinstance(fact, Reference) for fact in driver.session.outbox)


def test_a_limit_that_is_passed_with_a_trigger_still_ends_the_run(driver: Any, tools: Any) -> None:
    near(driver)
    driver.move("vut", x_m=23.8, speed_mps=99.0)
    driver.hear()
    driver.session.outbox += driver.session.judge_triggers(driver.now_ns)
    assert tools.violations(driver.session.outbox) == []
    driver.session.step(driver.now_ns)
    assert SafetyCode.OVER_SPEED in tools.violations(driver.session.outbox)
    assert driver.session.state is SessionPhase.ABORTING
