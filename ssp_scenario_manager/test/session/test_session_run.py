"""A session from load to its end, and its reports on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, Phase, SessionPhase, Verdict
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.state_machine import SessionEvent
from ssp_scenario_manager.triggers.evaluator import TriggerWatch

MS = 1_000_000
S = 1_000_000_000


def test_a_run_from_load_to_reset(driver: Any, tools: Any) -> None:
    driver.until("RUNNING")
    facts = driver.acknowledge()
    assert tools.changes(facts) == [
        ("IDLE", "load", "LOADED"),
        ("LOADED", "connect", "CONNECTED"),
        ("CONNECTED", "arm", "ARMED"),
        ("ARMED", "start", "RUNNING"),
    ]
    assert [f for f in facts if isinstance(f, outbox.ObjectCommand)] == [outbox.ObjectCommand.ARM]
    (begun,) = [f for f in facts if isinstance(f, PhaseBegan)]
    assert (begun.phase, begun.stamp_ns) == (Phase.APPROACH, 0)
    (sent,) = [f for f in facts if isinstance(f, Reference)]
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
    fired, dispatched = sorted(driver.acknowledge(), key=lambda f: isinstance(f, Reference))
    assert isinstance(fired, outbox.TriggerDecision)
    assert [s.value for s in fired.samples] == pytest.approx([12.5, 11.5])
    assert fired.crossing_ns == 5030 * MS
    assert fired.stamp_ns == 5040 * MS
    assert fired.reference_ids == (dispatched.reference_id,)
    assert fired.dispatched_ns == dispatched.dispatched_ns
    assert dispatched.purpose == "manoeuvre"
    assert dispatched.dispatched_ns == 5040 * MS
    assert dispatched.execute_at_ns == 5140 * MS
    assert driver.session.verdict is Verdict.NONE

    # It moves over, is in conflict, and then both go on at the same speed.
    driver.move("ot1", yaw_rad=-0.2)
    for _ in range(12):
        driver.step()
    driver.move("ot1", yaw_rad=0.0, y_m=0.0, x_m=34.0)
    driver.step()
    driver.move("ot1", speed_mps=12.0)
    driver.drive(60)
    facts = driver.acknowledge()
    began = [f for f in facts if isinstance(f, PhaseBegan)]
    assert [f.phase for f in began] == [Phase.TRIGGER, Phase.CONFLICT, Phase.RESOLUTION]
    # Confirmed after a second of resolution, complete 1.5 s after that.
    end_ns = began[-1].stamp_ns + S + 3 * S // 2
    while driver.now_ns < end_ns - 20 * MS:
        driver.drive(1)
    assert driver.session.state is SessionPhase.RUNNING
    driver.drive(1)
    assert tools.changes(driver.acknowledge()) == [("RUNNING", "complete", "STOPPING")]
    assert driver.session.elapsed_s(driver.now_ns) == driver.now_ns / S == end_ns / S
    driver.step()
    assert driver.session.state is SessionPhase.STOPPING  # they still move
    driver.move("vut", speed_mps=0.0)
    driver.move("ot1", speed_mps=0.0)
    for _ in range(40):
        driver.step(control_state=ControlState.POSTRUN)
    assert driver.session.state is SessionPhase.STOPPING  # they haven't stood for a second
    for _ in range(10):
        driver.step(control_state=ControlState.POSTRUN)
    assert tools.changes(driver.acknowledge()) == [("STOPPING", "standstill", "FINISHED")]
    assert driver.session.verdict is Verdict.VALID
    assert driver.session.reasons == ()
    assert driver.command("reset").accepted
    assert driver.session.state is SessionPhase.IDLE
    assert driver.session.spec is None


def test_the_event_is_that_of_the_initiator(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any]
) -> None:
    """A standing target before it in the list has no reference, and no say about phases."""
    start = {"x_m": 60.0, "y_m": -3.0, "yaw_rad": 0.0}
    truck = {"id": "ot2", "object_class": "truck", "start": start}
    run_mapping["targets"].insert(0, truck)
    run_mapping.update(observable="braking", initiator="ot1")
    driver = make_driver(RunSpec.model_validate(run_mapping))
    driver.until("RUNNING")
    sent = [f for f in driver.acknowledge() if isinstance(f, Reference)]
    assert [r.object_id for r in sent] == ["ot1"]
    driver.move("ot1", y_m=0.0, acceleration_mps2=-2.0)
    driver.move("ot2", y_m=0.0, acceleration_mps2=-2.0)
    for _ in range(11):
        driver.step()
    (began,) = [f for f in driver.acknowledge() if isinstance(f, PhaseBegan)]
    assert (began.phase, began.stamp_ns) == (Phase.TRIGGER, 20 * MS)
    assert began.evidence == "gap 35.5 m, TTC inf s, deceleration 2.00 m/s^2"

    run_mapping.update(initiator=None)
    driver = make_driver(RunSpec.model_validate(run_mapping))
    driver.until("RUNNING")
    driver.acknowledge()
    driver.move("ot2", y_m=0.0, acceleration_mps2=-2.0)
    for _ in range(11):
        driver.step()
    assert not driver.acknowledge()


def test_the_verdict_is_announced_with_the_end(driver: Any, tools: Any) -> None:
    tools.bring(driver, "ABORTED")
    announced = [f for f in driver.session.outbox if isinstance(f, outbox.StateChanged)]
    assert [f.verdict for f in announced[-2:]] == [Verdict.ABORTED, Verdict.ABORTED]
    assert announced[-1].reasons == ("abort by test at 0.00 s",)


@pytest.mark.parametrize("mover", ["vut", "ot1"])
@pytest.mark.parametrize("phase", ["STOPPING", "ABORTING"])
def test_it_ends_only_when_everybody_stands(
    driver: Any, tools: Any, phase: str, mover: str
) -> None:
    tools.bring(driver, phase)
    driver.move(mover, speed_mps=0.051)
    driver.step(control_state=ControlState.POSTRUN)
    assert driver.session.state.name == phase
    driver.move(mover, speed_mps=0.05)
    driver.step(control_state=ControlState.REMOTE_CONTROLLED)
    assert driver.session.state.name == phase
    driver.step(control_state=ControlState.POSTRUN)
    assert driver.session.state.name in ("FINISHED", "ABORTED")


@pytest.mark.parametrize(
    ("driven", "end_ns", "reason"),
    [
        (None, 3 * S // 2, "the event is resolved"),
        (
            Driven(driver="no_response", first_request_s=1.0, hand_over_s=2.0, end_s=9.0),
            9 * S,
            "the driven run is over",
        ),
    ],
)
def test_the_end_of_a_run_says_what_ended_it_and_when(
    make_driver: Callable[[RunSpec], Any],
    run: RunSpec,
    driven: Driven | None,
    end_ns: int,
    reason: str,
) -> None:
    """A resolution ends no driven run."""
    driver = make_driver(run.model_copy(update={"driven": driven}))
    driver.now_ns = S
    driver.until("RUNNING")
    driver.session._run.event.resolved_ns = driver.now_ns
    driver.acknowledge()
    driver.step(end_ns - 20 * MS)
    assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    change = driver.session.outbox[0]
    assert (change.event, change.reason, change.stamp_ns) == ("complete", reason, S + end_ns)


def test_an_abort_is_over_only_when_every_object_has_heard_it(driver: Any) -> None:
    """An object that stands and is armed would drive off at a command."""
    driver.until("ARMED")
    driver.command("abort")
    driver.step(control_state=ControlState.ARMED)
    assert driver.session.state is SessionPhase.ABORTING
    driver.step(control_state=ControlState.ABORTING)
    assert driver.session.state is SessionPhase.ABORTED


def test_an_arrival_is_judged_along_the_path_that_the_vut_is_to_drive(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any]
) -> None:
    """Its front, 3.6 m ahead, is 31 m from the anchor, then 29 m."""
    arrival = {"type": "time_to_arrival", "anchor": [100.0, 0.0], "below_s": 3.0}
    hold = {"id": "arrival", "object_id": "ot1", "manoeuvre": {"kind": "hold"}}
    run_mapping["triggers"] = [{**hold, "condition": arrival}]
    driver = make_driver(RunSpec.model_validate(run_mapping))
    driver.until("RUNNING")
    driver.acknowledge()
    for x_m, count in ((65.4, 0), (67.4, 1)):
        driver.move("vut", x_m=x_m, speed_mps=10.0)
        driver.step()
        decisions = [f for f in driver.acknowledge() if isinstance(f, outbox.TriggerDecision)]
        assert len(decisions) == count


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
    assert [f for f in driver.session.outbox if isinstance(f, outbox.ObjectCommand)] == [
        outbox.ObjectCommand.DISARM
    ]


def test_one_state_of_the_vut_is_judged_once(driver: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A trigger that must hold doesn't count the same sample twice."""
    judged: list[int] = []

    monkeypatch.setattr(TriggerWatch, "observe", lambda _, now: judged.append(now.stamp_ns))
    driver.until("RUNNING")
    driver.acknowledge()
    driver.step()
    driver.move("vut", x_m=25.0)
    driver.hear()  # the same stamp once more
    driver.session.step(driver.now_ns)
    driver.step()
    assert judged == [20 * MS, 40 * MS]


@pytest.mark.parametrize(("given_s", "most_ns"), [(None, 40 * MS), (0.1, 100 * MS)])
def test_no_trigger_is_judged_on_an_old_state_of_the_vut(
    make_driver: Callable[[RunSpec], Any],
    run_mapping: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    given_s: float | None,
    most_ns: int,
) -> None:
    """Two periods of 20 ms, unless the site says another age."""
    run_mapping["limits"]["trigger_age_s"] = given_s
    run_mapping["end"] = {"at_latest_s": 0.5}
    driver = make_driver(RunSpec.model_validate(run_mapping))
    judged: list[int] = []
    monkeypatch.setattr(TriggerWatch, "observe", lambda *_: judged.append(1))
    driver.until("RUNNING")
    driver.acknowledge()
    driver.step()
    for age_ns, count in ((most_ns, 2), (most_ns + 1, 2)):
        driver.now_ns += most_ns + 10 * MS
        driver.session.on_vut_state(driver.state("vut", stamp_ns=driver.now_ns - age_ns))
        driver.session.on_target_state(replace(driver.targets["ot1"], stamp_ns=driver.now_ns))
        driver.session.step(driver.now_ns)
        assert len(judged) == count
    assert driver.session._run.triggers.late_states == 1
    while driver.session.state is SessionPhase.RUNNING:
        driver.step()
    assert "1 states of the VUT came too late for triggers" in driver.session.reasons[0]
    # It is nobody else's fault that the event stayed away.
    assert driver.session.verdict is Verdict.INVALID_HARNESS


def test_stopped_by_a_person_before_the_event_is_no_valid_run(driver: Any, tools: Any) -> None:
    tools.bring(driver, "FINISHED")
    assert driver.session.verdict is Verdict.ABORTED
    assert driver.session.reasons == ("stopped by test before resolution, in approach at 0.00 s",)
