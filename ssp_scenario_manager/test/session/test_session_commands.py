"""Commands to a session: in every state, with their effects and answers."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.names import SESSION_COMMANDS
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.state_machine import (
    REFUSED_CONDITION,
    REFUSED_TRANSITION,
    TABLE,
    Answer,
    SessionEvent,
)

S = 1_000_000_000
REACHABLE = (
    "IDLE",
    "LOADED",
    "CONNECTED",
    "ARMED",
    "RUNNING",
    "STOPPING",
    "FINISHED",
    "ABORTING",
    "ABORTED",
)


# State, command: the state after it and the facts that go out with the change of state. Every pair
# that isn't here must be refused without any effect.
EFFECTS: dict[tuple[str, str], tuple[str, list[type]]] = {
    ("IDLE", "load"): ("LOADED", []),
    ("LOADED", "load"): ("LOADED", []),
    ("LOADED", "connect"): ("CONNECTED", []),
    ("LOADED", "reset"): ("IDLE", []),
    ("CONNECTED", "arm"): ("ARMED", [outbox.ObjectCommand]),
    ("CONNECTED", "reset"): ("IDLE", []),
    ("ARMED", "disarm"): ("CONNECTED", [outbox.ObjectCommand]),
    ("ARMED", "start"): ("RUNNING", [PhaseBegan, Reference]),
    ("RUNNING", "stop"): ("STOPPING", []),
    ("FINISHED", "reset"): ("IDLE", []),
    ("ABORTED", "all_clear"): ("IDLE", [outbox.ObjectCommand]),
}


@pytest.mark.parametrize("command", ["load", *(c for c in SESSION_COMMANDS if c != "abort")])
@pytest.mark.parametrize("phase", REACHABLE)
def test_a_command_has_its_effect_or_none(
    driver: Any, tools: Any, phase: str, command: str
) -> None:
    tools.bring(driver, phase)
    driver.hear(ControlState.ARMED if command == "start" else None)
    driver.session.outbox.clear()
    before = repr(vars(driver.session))
    load = command == "load"
    answer = driver.session.load(driver.run, driver.now_ns) if load else driver.command(command)
    if (phase, command) in EFFECTS:
        target, facts = EFFECTS[phase, command]
        assert answer == Answer(True)
        # The change of state comes first: who hears of an effect has heard of its cause.
        assert tools.changes(driver.session.outbox[:1]) == [(phase, command, target)]
        assert [type(fact) for fact in driver.session.outbox[1:]] == facts
        assert driver.session.state.name == target
    else:
        assert (answer.accepted, answer.error_code) == (False, REFUSED_TRANSITION)
        assert command in answer.error_msg
        assert phase in answer.error_msg
        assert repr(vars(driver.session)) == before


def test_the_effects_are_those_of_the_table() -> None:
    commands = {SessionEvent(c) for c in ("load", *SESSION_COMMANDS)} - {SessionEvent.ABORT}
    table = {
        (state.name, event.value): target.name
        for state, row in TABLE.items()
        for event, target in row.items()
        if event in commands
    }
    assert {pair: target for pair, (target, _) in EFFECTS.items()} == table


# -- abort ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", REACHABLE)
def test_abort_is_accepted_announced_and_ends_in_aborted(
    driver: Any, tools: Any, phase: str
) -> None:
    tools.bring(driver, phase)
    driver.session.outbox.clear()
    answer = driver.command("abort")
    assert answer.accepted
    latched = "ABORTED" if phase == "ABORTED" else "ABORTING"
    facts = driver.acknowledge()
    assert tools.changes(facts) == [(phase, "abort", latched)]
    assert tools.violations(facts) == [SafetyCode.OPERATOR]
    driver.step(control_state=ControlState.ABORTING)
    assert driver.session.state is SessionPhase.ABORTED
    assert driver.command("all_clear").accepted
    assert driver.session.state is SessionPhase.IDLE
    assert outbox.ObjectCommand.ALL_CLEAR in driver.session.outbox


@pytest.mark.parametrize("command", [c for c in SESSION_COMMANDS if c != "abort"])
@pytest.mark.parametrize("phase", REACHABLE)
@pytest.mark.parametrize("first", [True, False])
def test_abort_wins_over_any_command_at_the_same_instant(
    driver: Any, tools: Any, phase: str, command: str, first: bool
) -> None:
    """Whichever is heard first: nothing new has been heard of the objects in between."""
    tools.bring(driver, phase)
    driver.hear(ControlState.ARMED if command == "start" else None)
    for name in ("abort", command) if first else (command, "abort"):
        driver.command(name)
    assert driver.session.state.name in ("ABORTING", "ABORTED")
    driver.session.step(driver.now_ns)
    assert driver.session.state.name in ("ABORTING", "ABORTED")


@pytest.mark.parametrize("phase", REACHABLE)
def test_a_second_abort_changes_nothing_more(driver: Any, tools: Any, phase: str) -> None:
    tools.bring(driver, phase)
    driver.command("abort")
    state, verdict, reasons = (
        driver.session.state,
        driver.session.verdict,
        driver.session.reasons,
    )
    for _ in range(3):
        assert driver.command("abort").accepted
        assert (driver.session.state, driver.session.verdict) == (state, verdict)
        assert driver.session.reasons == reasons


def test_what_was_heard_before_an_abort_clears_nothing(driver: Any, tools: Any) -> None:
    tools.bring(driver, "ABORTED")
    driver.command("abort")
    assert driver.command("all_clear").missing == (
        "ot1 is not known to stand",
        "vut is not known to stand",
    )
    driver.session.on_vut_state(driver.vut)
    assert driver.command("all_clear").missing == ("ot1 is not known to stand",)
    driver.session.on_target_state(driver.targets["ot1"])
    assert driver.command("all_clear").accepted


def test_an_abort_by_a_person_is_announced_with_who_why_and_when(driver: Any) -> None:
    driver.until("ARMED")
    driver.session.outbox.clear()
    driver.session.command(SessionEvent.ABORT, 7 * S, "somebody", "rain")
    event, change = driver.session.outbox
    text = "abort by somebody: rain"
    assert event == Violation(SafetyCode.OPERATOR, "", 0.0, 0.0, 7 * S, text)
    assert (change.stamp_ns, change.reason) == (7 * S, text)


# -- conditions -----------------------------------------------------------------------------------


def test_a_refused_condition_changes_nothing_and_names_all(driver: Any) -> None:
    driver.session.load(driver.run, 0)
    driver.session.outbox.clear()
    before = repr(vars(driver.session))
    answer = driver.command("connect")
    assert (answer.accepted, answer.error_code) == (False, REFUSED_CONDITION)
    assert answer.missing == ("no state of the VUT arrives", "no state of ot1 arrives")
    for missing in answer.missing:
        assert missing in answer.error_msg
    assert repr(vars(driver.session)) == before


def test_all_clear_waits_for_standstill(driver: Any, tools: Any) -> None:
    tools.bring(driver, "ABORTED")
    driver.move("ot1", speed_mps=0.06)
    driver.hear()
    missing = driver.command("all_clear").missing
    assert missing == ("ot1 is not known to stand",)
    driver.move("ot1", speed_mps=math.nan)
    driver.hear()
    assert not driver.command("all_clear").accepted
    driver.move("ot1", speed_mps=0.05)
    driver.hear()
    assert driver.command("all_clear").accepted


def test_without_a_run_an_abort_claims_nothing_and_its_all_clear_clears_no_object(
    driver: Any,
) -> None:
    driver.command("abort")
    driver.session.step(0)
    assert driver.session.state is SessionPhase.ABORTED
    assert driver.session.outbox[-1].reason == "no run is loaded: what moves isn't known"
    assert driver.command("all_clear").accepted
    reasons = [one.reason for one in driver.session.outbox if isinstance(one, outbox.StateChanged)]
    assert reasons[-1].endswith("no object was cleared: load theirs, abort and clear again")


@pytest.mark.parametrize("control_state", [ControlState.PRE_ARMING, ControlState.ARMED])
def test_an_armed_object_that_stands_is_not_cleared(
    driver: Any, tools: Any, control_state: ControlState
) -> None:
    """The standstill of an abort doesn't count it either: a start would let it drive."""
    tools.bring(driver, "ABORTED")
    driver.hear(control_state)
    missing = driver.command("all_clear").missing
    assert missing == ("ot1 is armed: abort once more",)
    assert driver.session.state is SessionPhase.ABORTED
    assert driver.command("abort").accepted
    driver.hear(ControlState.ABORTING)
    assert driver.command("all_clear").accepted


def test_what_is_no_command_is_a_bug_of_the_caller(driver: Any) -> None:
    for event in (SessionEvent.LOAD, SessionEvent.STANDSTILL, SessionEvent.COMPLETE):
        with pytest.raises(ValueError, match="no command"):
            driver.session.command(event, 0, "test", "")


def test_loading_forgets_what_was_heard_before(driver: Any) -> None:
    driver.now_ns = 5 * S
    driver.until("CONNECTED")
    driver.command("reset")
    driver.now_ns = 0  # a world that was started anew
    driver.session.load(driver.run, 0)
    driver.hear(ControlState.DISARMED)
    assert driver.command("connect").accepted
    assert driver.session.vut.stamp_ns == 0


def test_a_run_that_cannot_fire_is_not_loaded(driver: Any, run_mapping: dict[str, Any]) -> None:
    run_mapping["triggers"][0]["object_id"] = "ot9"
    answer = driver.session.load(RunSpec.model_validate(run_mapping), 0)
    assert (answer.accepted, answer.error_code) == (False, REFUSED_CONDITION)
    assert "triggers[0].object_id" in answer.missing[0]
    assert (driver.session.state, driver.session.spec) == (SessionPhase.IDLE, None)


def test_failed_arming_goes_back_and_disarms_all(driver: Any, tools: Any) -> None:
    driver.until("ARMED")
    driver.session.outbox.clear()
    driver.session.arming_failed(7 * S, "ot1 refused")
    assert tools.changes(driver.session.outbox) == [("ARMED", "arm_failed", "CONNECTED")]
    change = driver.session.outbox[0]
    assert (change.stamp_ns, change.reason) == (7 * S, "ot1 refused")
    assert [f for f in driver.session.outbox if isinstance(f, outbox.ObjectCommand)] == [
        outbox.ObjectCommand.DISARM
    ]
    driver.session.outbox.clear()
    driver.session.arming_failed(0, "once more")
    assert driver.session.outbox == []
