"""A session from load to its end, its limits, and what no sequence of events may do."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.names import SESSION_COMMANDS
from ssp_core.run_spec import RunSpec
from ssp_core.safety_codes import SafetyCode
from ssp_core.vocab import ControlState, Phase, SessionPhase, Verdict
from ssp_scenario_manager.core import outbox
from ssp_scenario_manager.core.session import REFUSED_CONDITION, REFUSED_TRANSITION, Session
from ssp_scenario_manager.core.session_machine import SessionEvent
from ssp_scenario_manager.core.supervisor import Violation

MS = 1_000_000
S = 1_000_000_000
REACHABLE = ("IDLE", "LOADED", "CONNECTED", "ARMED", "RUNNING", "STOPPING", "FINISHED", "ABORTING",
             "ABORTED")  # fmt: skip


def bring(driver: Any, phase: str) -> None:
    """Any state of the machine, by the shortest way."""
    if phase in ("LOADED", "CONNECTED", "ARMED", "RUNNING"):
        driver.until(phase)
    elif phase in ("STOPPING", "FINISHED"):
        driver.until("RUNNING")
        driver.command("stop")
        if phase == "FINISHED":
            driver.step(control_state=ControlState.DISARMED)
    elif phase in ("ABORTING", "ABORTED"):
        driver.until("RUNNING")
        driver.command("abort")
        if phase == "ABORTED":
            driver.step(control_state=ControlState.ABORTING)
    assert driver.session.state.name == phase


def changes(facts: list[Any]) -> list[tuple[str, str, str]]:
    return [
        (f.previous.name, f.event, f.state.name)
        for f in facts
        if isinstance(f, outbox.StateChanged)
    ]


def violations(facts: list[Any]) -> list[SafetyCode]:
    return [f.violation.code for f in facts if isinstance(f, outbox.LimitPassed)]


# -- the whole way --------------------------------------------------------------------------------


def test_a_run_from_load_to_reset(driver: Any) -> None:
    driver.until("RUNNING")
    facts = driver.acknowledge()
    assert changes(facts) == [
        ("IDLE", "load", "LOADED"),
        ("LOADED", "connect", "CONNECTED"),
        ("CONNECTED", "arm", "ARMED"),
        ("ARMED", "start", "RUNNING"),
    ]
    assert [f.armed for f in facts if isinstance(f, outbox.ArmObjects)] == [True]
    (begun,) = [f for f in facts if isinstance(f, outbox.PhaseBegan)]
    assert (begun.phase, begun.stamp_ns) == (Phase.APPROACH, 0)
    (sent,) = [f.reference for f in facts if isinstance(f, outbox.Dispatch)]
    assert (sent.object_id, sent.purpose, sent.event_version) == ("ot1", "approach", "sha256:event")
    assert (sent.dispatched_ns, sent.execute_at_ns, sent.expires_at_ns) == (0, S // 2, 3 * S // 2)

    # The VUT closes in until the gap is below 12 m; OT at 40, its rear at 39.1, VUT's front 3.6.
    for _ in range(20):  # until the approach says that the OT drives
        driver.step(250 * MS)
    driver.move("vut", x_m=23.0, speed_mps=10.0)
    driver.move("ot1", speed_mps=7.0)
    driver.step()
    assert not driver.session.outbox
    driver.move("vut", x_m=24.0)
    driver.step()
    fired, dispatched = sorted(driver.acknowledge(), key=lambda f: isinstance(f, outbox.Dispatch))
    assert isinstance(fired, outbox.Triggered)
    assert [s.value for s in fired.samples] == pytest.approx([12.5, 11.5])
    assert fired.crossing_ns == 5030 * MS
    assert fired.stamp_ns == 5040 * MS
    assert fired.references == (dispatched.reference,)
    assert dispatched.reference.purpose == "manoeuvre"
    assert dispatched.reference.dispatched_ns == 5040 * MS
    assert dispatched.reference.execute_at_ns == 5140 * MS
    assert driver.session.verdict is Verdict.NONE

    # It moves over, is in conflict, and then both go on at the same speed.
    driver.move("ot1", yaw_rad=-0.2)
    for _ in range(12):
        driver.step()
    driver.move("ot1", yaw_rad=0.0, y_m=0.0, x_m=34.0)
    driver.step()
    driver.move("ot1", speed_mps=12.0)
    for _ in range(60):
        driver.step()
    facts = driver.acknowledge()
    began = [f for f in facts if isinstance(f, outbox.PhaseBegan)]
    assert [f.phase for f in began] == [Phase.TRIGGER, Phase.CONFLICT, Phase.RESOLUTION]
    # Confirmed after a second of resolution, complete 1.5 s after that.
    end_ns = began[-1].stamp_ns + S + 3 * S // 2
    while driver.now_ns < end_ns - 20 * MS:
        driver.step()
    assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert changes(driver.acknowledge()) == [("RUNNING", "complete", "STOPPING")]
    assert driver.session.elapsed_s(driver.now_ns) == driver.now_ns / S == end_ns / S
    driver.step()
    assert driver.session.state is SessionPhase.STOPPING  # they still move
    driver.move("vut", speed_mps=0.0)
    driver.move("ot1", speed_mps=0.0)
    driver.step(control_state=ControlState.POSTRUN)
    assert changes(driver.acknowledge()) == [("STOPPING", "standstill", "FINISHED")]
    assert driver.session.verdict is Verdict.VALID
    assert driver.session.reasons == ()
    assert driver.command("reset").accepted
    assert driver.session.state is SessionPhase.IDLE
    assert driver.session.spec is None


def test_the_verdict_is_announced_with_the_end(driver: Any) -> None:
    bring(driver, "ABORTED")
    announced = [f for f in driver.session.outbox if isinstance(f, outbox.StateChanged)]
    assert [f.verdict for f in announced[-2:]] == [Verdict.ABORTED, Verdict.ABORTED]
    assert announced[-1].reasons == ("abort by test",)


@pytest.mark.parametrize("mover", ["vut", "ot1"])
@pytest.mark.parametrize("phase", ["STOPPING", "ABORTING"])
def test_it_ends_only_when_everybody_stands(driver: Any, phase: str, mover: str) -> None:
    bring(driver, phase)
    driver.move(mover, speed_mps=0.051)
    driver.step(control_state=ControlState.POSTRUN)
    assert driver.session.state.name == phase
    driver.move(mover, speed_mps=0.05)
    driver.step(control_state=ControlState.REMOTE_CONTROLLED)
    assert driver.session.state.name == phase
    driver.step(control_state=ControlState.POSTRUN)
    assert driver.session.state.name in ("FINISHED", "ABORTED")


def test_elapsed_time_begins_with_the_run(driver: Any) -> None:
    driver.now_ns = 3 * S
    assert driver.session.elapsed_s(9 * S) == 0.0
    driver.until("ARMED")
    assert driver.session.elapsed_s(9 * S) == 0.0
    driver.hear(ControlState.ARMED)
    driver.command("start")
    assert driver.session.elapsed_s(9 * S) == 6.0


def test_reasons_of_transitions(driver: Any) -> None:
    driver.until("ARMED")
    driver.session.outbox.clear()
    driver.session.command(SessionEvent.DISARM, 0, "somebody", "rain")
    driver.session.command(SessionEvent.RESET, 0, "somebody", "")
    told = [f.reason for f in driver.session.outbox if isinstance(f, outbox.StateChanged)]
    assert told == ["rain", "requested by somebody"]
    # Whoever disarms the session disarms the objects.
    assert [f.armed for f in driver.session.outbox if isinstance(f, outbox.ArmObjects)] == [False]


def test_one_state_of_the_vut_is_judged_once(driver: Any) -> None:
    """A trigger that must hold doesn't count the same sample twice."""
    driver.until("RUNNING")
    driver.acknowledge()
    driver.step()
    watches = driver.session._run.watches["gap"]
    driver.move("vut", x_m=25.0)
    driver.hear()  # the same stamp once more
    driver.session.step(driver.now_ns)
    assert driver.session._run.watches["gap"] is watches


def test_stopped_by_a_person_before_the_event_is_no_valid_run(driver: Any) -> None:
    bring(driver, "FINISHED")
    assert driver.session.verdict is Verdict.ABORTED
    assert driver.session.reasons == ("stopped by test before resolution, in approach",)


# -- commands -------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", REACHABLE)
def test_abort_is_accepted_announced_and_ends_in_aborted(driver: Any, phase: str) -> None:
    bring(driver, phase)
    driver.session.outbox.clear()
    answer = driver.command("abort")
    assert answer.accepted
    latched = "ABORTED" if phase == "ABORTED" else "ABORTING"
    facts = driver.acknowledge()
    assert changes(facts) == [(phase, "abort", latched)]
    assert violations(facts) == [SafetyCode.OPERATOR]
    driver.step(control_state=ControlState.ABORTING)
    assert driver.session.state is SessionPhase.ABORTED
    assert driver.command("all_clear").accepted
    assert driver.session.state is SessionPhase.IDLE
    assert any(isinstance(f, outbox.ClearObjects) for f in driver.session.outbox)


@pytest.mark.parametrize("command", [c for c in SESSION_COMMANDS if c != "abort"])
@pytest.mark.parametrize("phase", REACHABLE)
def test_a_command_has_its_effect_or_none(driver: Any, phase: str, command: str) -> None:
    bring(driver, phase)
    driver.hear(ControlState.ARMED if command == "start" else None)
    driver.session.outbox.clear()
    before = repr(vars(driver.session))
    answer = driver.command(command)
    if answer.accepted:
        (change,) = changes(driver.session.outbox)
        assert change == (phase, command, driver.session.state.name)
    else:
        assert answer.error_code == REFUSED_TRANSITION
        assert command in answer.error_msg
        assert phase in answer.error_msg
        assert repr(vars(driver.session)) == before


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


def test_all_clear_waits_for_standstill(driver: Any) -> None:
    bring(driver, "ABORTED")
    driver.move("ot1", speed_mps=0.06)
    driver.hear()
    missing = driver.command("all_clear").missing
    assert missing == ("it is not known of everything that it stands",)
    driver.move("ot1", speed_mps=math.nan)
    driver.hear()
    assert not driver.command("all_clear").accepted
    driver.move("ot1", speed_mps=0.05)
    driver.hear()
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


def test_failed_arming_goes_back_and_disarms_all(driver: Any) -> None:
    driver.until("ARMED")
    driver.session.outbox.clear()
    driver.session.arming_failed(0, "ot1 refused")
    assert changes(driver.session.outbox) == [("ARMED", "arm_failed", "CONNECTED")]
    assert [f.armed for f in driver.session.outbox if isinstance(f, outbox.ArmObjects)] == [False]
    driver.session.outbox.clear()
    driver.session.arming_failed(0, "once more")
    assert driver.session.outbox == []


# -- limits while it runs -------------------------------------------------------------------------


def run_with(driver: Any) -> None:
    driver.until("RUNNING")
    driver.acknowledge()


@pytest.mark.parametrize(
    ("changed", "code", "verdict"),
    [
        ({"x_m": 3.0, "y_m": 0.0}, SafetyCode.COLLISION, Verdict.FAILED_SAFETY),
        ({"x_m": 4.9, "y_m": 0.0}, SafetyCode.SEPARATION, Verdict.FAILED_SAFETY),
        (
            {"reference_id": "r", "error_lateral_m": 0.81},
            SafetyCode.ERROR_LATERAL,
            Verdict.FAILED_SAFETY,
        ),
        ({"x_m": math.nan}, SafetyCode.STATE_NOT_FINITE, Verdict.FAILED_SAFETY),
        ({"yaw_rad": math.inf}, SafetyCode.STATE_NOT_FINITE, Verdict.FAILED_SAFETY),
    ],
)
@pytest.mark.parametrize("phase", ["RUNNING", "STOPPING"])
def test_a_limit_aborts_with_its_event_and_verdict(
    driver: Any, phase: str, changed: dict[str, Any], code: SafetyCode, verdict: Verdict
) -> None:
    run_with(driver)
    driver.move("vut", speed_mps=1.0)
    if phase == "STOPPING":
        driver.session._move(SessionEvent.COMPLETE, 0, "")
    driver.move("ot1", **changed)
    driver.step()
    assert violations(driver.session.outbox) == [code]
    assert driver.session.state is SessionPhase.ABORTING
    assert driver.session.verdict is verdict
    assert len(driver.session.reasons) == 1


def test_a_vut_state_that_is_no_number_aborts(driver: Any) -> None:
    run_with(driver)
    driver.move("vut", yaw_rad=math.inf, speed_mps=math.nan)
    driver.step()
    assert violations(driver.session.outbox) == [SafetyCode.STATE_NOT_FINITE]


def test_a_collision_while_aborting_is_a_further_reason_once(driver: Any) -> None:
    run_with(driver)
    driver.move("vut", speed_mps=5.0)
    driver.step()
    driver.command("abort")
    driver.move("ot1", x_m=3.0, y_m=0.0)
    for _ in range(5):
        driver.step()
    assert violations(driver.session.outbox) == [SafetyCode.OPERATOR, SafetyCode.COLLISION]
    assert driver.session.verdict is Verdict.ABORTED
    assert [r.split(":")[0] for r in driver.session.reasons] == ["abort by test", "collision"]


def test_silence_of_either_side(driver: Any) -> None:
    """The limit is 0.3 s: the last state may be that old."""
    run_with(driver)
    driver.session.step(300 * MS)
    assert driver.session.state is SessionPhase.RUNNING
    driver.session.step(301 * MS)
    assert set(violations(driver.session.outbox)) == {
        SafetyCode.VUT_SILENT,
        SafetyCode.OBJECT_SILENT,
    }
    assert driver.session.verdict is Verdict.ABORTED


def test_an_unanswered_reference(driver: Any) -> None:
    driver.until("RUNNING")
    for _ in range(25):
        driver.step()
    assert driver.now_ns == 500 * MS
    assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert violations(driver.session.outbox) == [SafetyCode.ACK_MISSING]


def test_a_refused_reference(driver: Any) -> None:
    driver.until("RUNNING")
    driver.session.on_ack("nobody's", False, 7, "", 0)
    assert driver.session.state is SessionPhase.RUNNING
    driver.session.on_ack("ot1-1", False, 7, "leaves the geofence", 5)
    (passed,) = [f for f in driver.session.outbox if isinstance(f, outbox.LimitPassed)]
    assert passed.violation == Violation(
        SafetyCode.REFERENCE_REFUSED, "ot1", 7.0, 0.0, 5, "leaves the geofence"
    )
    assert driver.session.state is SessionPhase.ABORTING
    driver.session.on_ack("ot1-1", False, 7, "leaves the geofence", 6)  # a duplicate
    assert len(driver.session.reasons) == 1


def test_an_object_that_aborts_is_given_time_to_say_why(driver: Any) -> None:
    run_with(driver)
    driver.step(control_state=ControlState.ABORTING)
    for _ in range(4):
        driver.step()
        assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert violations(driver.session.outbox) == [SafetyCode.OBJECT_ABORTED]


def test_duration_and_a_missing_event(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any]
) -> None:
    run_mapping["end"] = {"at_latest_s": 1.0}
    run_mapping["limits"]["state_age_s"] = 5.0
    driver = make_driver(RunSpec.model_validate(run_mapping))
    run_with(driver)
    driver.step(S - 1)
    assert driver.session.state is SessionPhase.RUNNING
    driver.step(1)
    assert violations(driver.session.outbox) == [SafetyCode.EVENT_MISSING]
    assert driver.session.verdict is Verdict.INVALID_HARNESS
    assert "phase reached: approach" in driver.session.reasons[0]

    run_mapping["end"] = {"at_latest_s": 50.0}
    run_mapping["limits"]["duration_s"] = 2.0
    driver = make_driver(RunSpec.model_validate(run_mapping))
    run_with(driver)
    driver.step(2 * S)
    assert driver.session.state is SessionPhase.RUNNING
    driver.step(1)
    assert violations(driver.session.outbox) == [SafetyCode.DURATION]
    assert driver.session.verdict is Verdict.FAILED_SAFETY


def test_a_manoeuvre_that_cannot_be_driven_aborts_with_the_reason(driver: Any) -> None:
    """The gap is reached while the OT still stands: there is nothing to change lane with."""
    run_with(driver)
    driver.move("vut", x_m=25.0, speed_mps=5.0)
    driver.step()
    assert violations(driver.session.outbox) == [SafetyCode.EVENT_MISSING]
    assert "trigger gap fired" in driver.session.reasons[0]
    assert not [f for f in driver.session.outbox if isinstance(f, outbox.Dispatch)]


def test_the_first_reason_gives_the_verdict(driver: Any) -> None:
    run_with(driver)
    driver.session.fail(Violation(SafetyCode.RECORDER, "monitor", 3.0, 2.0, 1))
    driver.session.fail(Violation(SafetyCode.OVER_SPEED, "ot1", 20.0, 15.0, 2))
    assert driver.session.verdict is Verdict.INVALID_HARNESS
    assert len(driver.session.reasons) == 2
    assert changes(driver.session.outbox) == [("RUNNING", "abort", "ABORTING")]


def test_older_states_do_not_replace_newer_ones(driver: Any) -> None:
    run_with(driver)
    driver.step(100 * MS)
    driver.session.on_vut_state(driver.state("vut", stamp_ns=50 * MS, x_m=9.0))
    driver.session.on_target_state(driver.state("ot1", stamp_ns=50 * MS, x_m=9.0))
    assert driver.session.vut.x_m == 0.0
    assert driver.session.targets["ot1"].x_m == 40.0


# -- what no sequence may do ----------------------------------------------------------------------

floats = st.one_of(
    st.floats(-50.0, 60.0), st.sampled_from([0.0, 24.0, math.nan, math.inf, -math.inf])
)
events = st.one_of(
    st.tuples(st.just("load")),
    st.tuples(st.just("command"), st.sampled_from(SESSION_COMMANDS)),
    st.tuples(st.just("command"), st.sampled_from(["connect", "arm", "start", "all_clear"])),
    st.tuples(st.just("go"), st.sampled_from(["ARMED", "RUNNING"])),
    st.tuples(st.just("step"), st.sampled_from(list(ControlState))),
    st.tuples(
        st.just("move"),
        st.sampled_from(["vut", "ot1"]),
        st.sampled_from(["x_m", "y_m", "yaw_rad", "speed_mps", "yaw_rate_radps"]),
        floats,
    ),
    st.tuples(st.just("fail"), st.sampled_from(list(SafetyCode))),
    st.tuples(st.just("ack"), st.booleans()),
    st.tuples(st.just("arming_failed")),
    st.tuples(st.just("rest")),
)


def apply(driver: Any, event: tuple[Any, ...]) -> None:
    session: Session = driver.session
    kind = event[0]
    if kind == "load":
        session.load(driver.run, driver.now_ns)
    elif kind == "command":
        driver.command(event[1])
    elif kind == "go":
        driver.session.load(driver.run, driver.now_ns)
        for command, control in (
            ("connect", ControlState.DISARMED),
            ("arm", ControlState.DISARMED),
            ("start", ControlState.ARMED),
        ):
            driver.move("vut", x_m=0.0, y_m=0.0, yaw_rad=0.0, speed_mps=0.0, yaw_rate_radps=0.0)
            driver.move("ot1", x_m=40.0, y_m=3.5, yaw_rad=0.0, speed_mps=0.0, yaw_rate_radps=0.0)
            driver.hear(control)
            if session.state.name != event[1]:
                driver.command(command)
    elif kind == "step":
        driver.step(control_state=event[1])
    elif kind == "move":
        driver.move(event[1], **{event[2]: event[3]})
    elif kind == "fail":
        session.fail(Violation(event[1], "ot1", 1.0, 0.0, driver.now_ns))
    elif kind == "ack":
        session.on_ack("ot1-1", event[1], 3, "no", driver.now_ns)
    elif kind == "arming_failed":
        session.arming_failed(driver.now_ns, "refused")
    else:
        driver.move("vut", x_m=0.0, yaw_rad=0.0, yaw_rate_radps=0.0, speed_mps=0.0)
        driver.move("ot1", x_m=40.0, yaw_rad=0.0, yaw_rate_radps=0.0, speed_mps=0.0)
        driver.step(control_state=ControlState.ABORTING)


@settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(sequence=st.lists(events, max_size=30))
def test_no_sequence_breaks_the_promises(
    make_driver: Callable[[RunSpec], Any], run: RunSpec, sequence: list[tuple[Any, ...]]
) -> None:
    driver = make_driver(run)
    session: Session = driver.session
    # What must have happened, in this order, before a run may start (again).
    needed = ["load", "connect", "arm", "start"]
    since: list[str] = []
    for event in sequence:
        before = session.state
        session.outbox.clear()
        apply(driver, event)
        facts = session.outbox
        # Every transition stands in the outbox exactly once, and they make a chain.
        here = before
        for fact in facts:
            if isinstance(fact, outbox.StateChanged):
                assert fact.previous is here
                here = fact.state
                if fact.event == "abort":
                    since = ["abort"]
                else:
                    since.append(fact.event)
                if fact.state is SessionPhase.RUNNING:
                    happened = iter(since)
                    assert all(wanted in happened for wanted in needed)
                    assert "abort" not in since or "all_clear" in since
                    since = []
            elif isinstance(fact, outbox.Dispatch):
                # Nothing is sent but while running.
                assert here is SessionPhase.RUNNING
        assert here is session.state
        if "abort" in since and "all_clear" not in since:
            assert session.state in (SessionPhase.ABORTING, SessionPhase.ABORTED)
        # Whoever was told a final verdict was told why, unless everything was well.
        if session.verdict not in (Verdict.NONE, Verdict.VALID):
            assert session.reasons
        if session.verdict is Verdict.VALID:
            assert session.state is not SessionPhase.RUNNING
