"""Promises of a session that no sequence of commands, states and events may break."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.names import SESSION_COMMANDS
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase, Verdict
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.session import Session

ABORTS = (SessionPhase.ABORTING, SessionPhase.ABORTED)
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
    st.tuples(st.just("facts"), st.booleans()),
    st.tuples(st.just("control"), st.sampled_from(list(ControlState))),
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
    elif kind == "facts":
        # Recorder, links and freshness come and go.
        session.facts = Facts.of_one_process(driver.run) if event[1] else Facts()
    elif kind == "control":
        driver.move("ot1", control_state=event[1])
        driver.hear()
    elif kind == "arming_failed":
        session.arming_failed(driver.now_ns, "refused")
    else:
        driver.move("vut", x_m=0.0, yaw_rad=0.0, yaw_rate_radps=0.0, speed_mps=0.0)
        driver.move("ot1", x_m=40.0, yaw_rad=0.0, yaw_rate_radps=0.0, speed_mps=0.0)
        driver.step(control_state=ControlState.ABORTING)


@settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
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
                if fact.previous in ABORTS and fact.state not in ABORTS:
                    assert (fact.previous.name, fact.event) == ("ABORTED", "all_clear")
                if fact.state is SessionPhase.RUNNING:
                    assert session.targets["ot1"].control_state is ControlState.ARMED
                    assert session.facts.recorder_ready
                    happened = iter(since)
                    assert all(wanted in happened for wanted in needed)
                    assert "abort" not in since or "all_clear" in since
                    since = []
            elif isinstance(fact, Reference | outbox.TriggerDecision | PhaseBegan):
                # Nothing is sent but while running: what follows an abort in the outbox would
                # reach the objects after it.
                assert here is SessionPhase.RUNNING
            elif fact in (outbox.ObjectCommand.ARM, outbox.ObjectCommand.DISARM):
                assert here is (
                    SessionPhase.ARMED
                    if fact is outbox.ObjectCommand.ARM
                    else SessionPhase.CONNECTED
                )
            elif fact is outbox.ObjectCommand.ALL_CLEAR:
                assert here is SessionPhase.IDLE
            elif isinstance(fact, Violation):
                # An event stands before the abort that it leads to.
                assert here not in (SessionPhase.IDLE, SessionPhase.FINISHED) or (
                    fact.code is SafetyCode.OPERATOR
                )
        assert here is session.state
        if "abort" in since and "all_clear" not in since:
            assert session.state in (SessionPhase.ABORTING, SessionPhase.ABORTED)
        # Whoever was told a final verdict was told why, unless everything was well.
        if session.verdict not in (Verdict.NONE, Verdict.VALID):
            assert session.reasons
        if session.verdict is Verdict.VALID:
            assert session.state is not SessionPhase.RUNNING
    # Abort ends whatever this was, at once, for good, and however often it is asked for.
    for _ in range(2):
        assert driver.command("abort").accepted
        assert session.state in ABORTS
