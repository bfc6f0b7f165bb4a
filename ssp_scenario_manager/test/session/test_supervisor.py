"""The checks on the steady clock: facts, silence, arming, the end of an abort."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.safety.arming import Gate, obstacles
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.liveness import WORLD_SILENT_LOCKSTEP_S
from ssp_core.safety.publishers import NAMELESS
from ssp_core.vocabulary import ControlState, SessionPhase, Verdict
from ssp_scenario_manager.session.limits import Violation, own_lateness
from ssp_scenario_manager.session.state_machine import STANDSTILL_GIVEN_UP
from ssp_scenario_manager.session.supervision import (
    ABORT_STANDSTILL_S,
    ARM_CONFIRMATION_S,
    LivenessMonitor,
    Supervisor,
)

S = 1_000_000_000


def hear_all(liveness: LivenessMonitor, steady_ns: int) -> None:
    for who in (names.SIL_WORLD, names.VUT_ID, "ot1", "ot2", names.MONITOR):
        liveness.hear(who, steady_ns)


def two_objects(run_mapping: dict[str, Any]) -> RunSpec:
    """The run with one more object, which stands beyond the first."""
    start = {"x_m": 70.0, "y_m": 0.0, "yaw_rad": 0.0}
    run_mapping["targets"].append({"id": "ot2", "object_class": "car", "start": start})
    return RunSpec.model_validate(run_mapping)


def test_the_session_is_told_the_facts(driver: Any) -> None:
    driver.until("LOADED")
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    liveness.hear_recorder(True, (), 0, 2 * S)
    watchdog.look(3 * S, 0)
    assert driver.session.facts.recorder_ready
    assert driver.session.facts.ages_s[names.MONITOR] == 1.0
    # Who is asked for is known by the run.
    assert set(driver.session.facts.links) == {"ot1"}


@pytest.mark.parametrize("phase", ["ARMED", "RUNNING"])
def test_who_falls_silent_ends_the_session(driver: Any, tools: Any, phase: str) -> None:
    driver.until(phase)
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    hear_all(liveness, S)
    watchdog.look(S, 0)
    assert driver.session.state.name == phase
    late_ns = S + round(WORLD_SILENT_LOCKSTEP_S * S) + 1
    for steady_ns in range(S, late_ns, S // 4):
        watchdog.wake(steady_ns)
    liveness.hear(names.MONITOR, late_ns)
    watchdog.look(late_ns, 0)
    told = tools.violations(driver.session.outbox)
    assert told[0] is SafetyCode.WORLD_SILENT
    assert (SafetyCode.OBJECT_SILENT in told) == (phase == "ARMED")
    assert driver.session.state is SessionPhase.ABORTING


@pytest.mark.parametrize("phase", ["IDLE", "LOADED", "CONNECTED", "ABORTING"])
def test_nobody_is_waited_for_before_or_after(driver: Any, tools: Any, phase: str) -> None:
    tools.bring(driver, phase)
    driver.session.outbox.clear()
    Supervisor(driver.session, LivenessMonitor()).look(900 * S, driver.now_ns)
    assert driver.session.state.name == phase
    assert tools.violations(driver.session.outbox) == []


@pytest.mark.parametrize("phase", ["LOADED", "CONNECTED", "FINISHED", "ABORTING"])
def test_losses_and_strangers_end_only_what_is_armed_or_runs(
    driver: Any, tools: Any, phase: str
) -> None:
    """They keep it from arming; what is over already has its reasons."""
    tools.bring(driver, phase)
    before = driver.session.reasons
    driver.session.outbox.clear()
    liveness = LivenessMonitor()
    liveness.hear_recorder(True, (), 3, S)
    liveness.hear_strangers(["2 publish a: ours, forger"])
    Supervisor(driver.session, liveness).look(S, driver.now_ns)
    assert driver.session.state.name == phase
    assert (driver.session.reasons, driver.session.outbox) == (before, [])


@pytest.mark.parametrize(("mode", "given_up"), [("realtime", True), ("live", False)])
def test_a_live_session_waits_for_no_world(
    make_driver: Any, run: RunSpec, mode: str, given_up: bool
) -> None:
    """Its objects brake for as long as they need; a world that died would never say so."""
    driver = make_driver(run.model_copy(update={"mode": mode}))
    driver.until("RUNNING")
    driver.command("abort")
    driver.move("ot1", speed_mps=3.0)
    driver.step(control_state=ControlState.ABORTING)
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    for steady_ns in (S, 3 * S):
        liveness.hear("ot1", steady_ns)
        liveness.hear(names.VUT_ID, steady_ns)
        unconfirmed = watchdog.look(steady_ns, driver.now_ns)
    assert unconfirmed is given_up


@pytest.mark.parametrize("late_s", [1.0, 3.0])
def test_a_manager_that_stood_still_blames_itself(
    run_mapping: dict[str, Any], make_driver: Any, late_s: float
) -> None:
    run = RunSpec.model_validate({**run_mapping, "mode": "realtime"})
    driver = make_driver(run)
    driver.until("RUNNING")
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    hear_all(liveness, S)
    watchdog.wake(S)
    now_ns = S + round(late_s * S)
    driver.session.outbox.clear()
    watchdog.look(now_ns, driver.now_ns)
    assert driver.session.state is SessionPhase.ABORTING
    assert driver.session.verdict is Verdict.INVALID_HARNESS
    assert driver.session.reasons == (
        f"overrun: scenario_manager: {late_s:.3g} s, limit 0.5 s (instead of world_silent of "
        "sil_world) at 0.00 s",
    )


def test_in_lockstep_a_stall_is_no_silence_and_no_overrun(driver: Any, tools: Any) -> None:
    """Simulated time stood still with the manager; what objects say of it is true."""
    driver.until("RUNNING")
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    hear_all(liveness, S)
    watchdog.wake(S)
    watchdog.look(61 * S, driver.now_ns)
    assert driver.session.state is SessionPhase.RUNNING
    # From here on silence counts again.
    for k in range(1, 60):
        watchdog.wake(61 * S + k * S // 4)
    watchdog.look(76 * S, driver.now_ns)
    assert driver.session.reasons[0].startswith("world_silent: sil_world: 15 s, limit 12 s")
    driver = type(driver)(driver.run, driver.state)
    driver.until("RUNNING")
    watchdog = Supervisor(driver.session, LivenessMonitor())
    watchdog.wake(S)
    watchdog.wake(4 * S)
    lost = Violation(SafetyCode.PARTICIPANT_LOST, "object_target", 3.1, 3.0, driver.now_ns, "x")
    driver.session.fail(lost, announced=True)
    assert driver.session.reasons[0].startswith("participant_lost: object_target")


def test_what_objects_say_of_that_pause_is_the_managers_own_too_and_later_it_is_theirs(
    run_mapping: dict[str, Any], make_driver: Any, tools: Any
) -> None:
    driver = make_driver(RunSpec.model_validate({**run_mapping, "mode": "realtime"}))
    driver.until("RUNNING")
    watchdog = Supervisor(driver.session, LivenessMonitor())
    lost = Violation(SafetyCode.HEARTBEAT_LOST, "ot1", 0.52, 0.5, driver.now_ns, "seen by x")
    watchdog.wake(S)
    watchdog.wake(2 * S)
    driver.session.outbox.clear()
    driver.session.fail(lost, announced=True)
    assert tools.violations(driver.session.outbox) == [SafetyCode.OVERRUN]
    for steady_ns in range(2 * S, 4 * S, S // 4):
        watchdog.wake(steady_ns)
    driver.session.fail(lost, announced=True)
    assert [reason.partition(":")[0] for reason in driver.session.reasons] == [
        "overrun",
        "heartbeat_lost",
    ]


def test_a_vut_from_the_future_ends_the_run_by_name_and_sets_no_time(driver: Any) -> None:
    driver.until("RUNNING")
    ahead = replace(driver.vut, stamp_ns=driver.now_ns + 3600 * S)
    assert driver.session.refuse_if_ahead(ahead, driver.now_ns)
    assert driver.session.reasons[0].startswith("clock_offset: vut: 3.6e+03 s, limit 0.05 s")
    assert driver.session.vut.stamp_ns == driver.now_ns


@pytest.mark.parametrize(("mode", "early_s"), [("live", 0.0), ("realtime", 0.02)])
def test_a_vut_may_be_a_step_ahead_in_a_simulated_world_alone(
    run_mapping: dict[str, Any], make_driver: Any, mode: str, early_s: float
) -> None:
    driver = make_driver(RunSpec.model_validate({**run_mapping, "mode": mode}))
    assert driver.run.step_s == 0.02
    driver.until("RUNNING")
    allowed_ns = driver.now_ns + round((0.05 + early_s) * S)
    for stamp_ns, refused in ((driver.now_ns, False), (allowed_ns, False), (allowed_ns + 1, True)):
        ahead = replace(driver.vut, stamp_ns=stamp_ns)
        assert driver.session.refuse_if_ahead(ahead, driver.now_ns) is refused, stamp_ns


@pytest.mark.parametrize("phase", ["IDLE", "LOADED", "CONNECTED", "FINISHED", "ABORTED"])
def test_a_vut_from_the_future_ends_only_what_lasts(driver: Any, tools: Any, phase: str) -> None:
    if phase != "IDLE":
        tools.bring(driver, phase)
    ahead = replace(driver.vut, stamp_ns=driver.now_ns + 3600 * S)
    assert not driver.session.refuse_if_ahead(ahead, driver.now_ns)
    assert driver.session.state.name == phase


def test_only_the_vuts_states_set_the_time(driver: Any) -> None:
    driver.until("RUNNING")
    ahead = replace(driver.targets["ot1"], stamp_ns=driver.now_ns + 3600 * S)
    assert not driver.session.refuse_if_ahead(ahead, driver.now_ns)
    assert driver.session.state is SessionPhase.RUNNING


FOREIGN = Violation(SafetyCode.FOREIGN_MANAGER, "", 1.0, 0.0, 0, NAMELESS)


def test_a_stranger_whose_name_comes_late_is_named_once(driver: Any) -> None:
    driver.until("RUNNING")
    driver.session.fail(FOREIGN)
    (first,) = driver.session.reasons
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    for texts in (
        [f"2 publish a, of them {NAMELESS}"],
        ["2 publish a: ours, forger", "2 publish b: ours, forger"],
        ["2 publish a: ours, forger", "2 publish b: ours, forger"],
    ):
        liveness.hear_strangers(texts)
        watchdog.look(S, driver.now_ns)
    named = "2 publish a: ours, forger; 2 publish b: ours, forger"
    assert driver.session.reasons == (first, f"{named} at {driver.now_ns / S:.2f} s")
    assert driver.session.verdict is Verdict.INVALID_HARNESS


def test_strangers_of_a_session_that_ends_for_another_reason_are_no_reason(driver: Any) -> None:
    driver.session.name_strangers(["2 publish a: ours, forger"], 0)
    driver.until("RUNNING")
    driver.session.name_strangers(["2 publish a: ours, forger"], driver.now_ns)
    driver.command("abort")
    before = driver.session.reasons
    driver.session.name_strangers(["2 publish a: ours, forger"], driver.now_ns)
    assert driver.session.reasons == before


ARM_NS = round(ARM_CONFIRMATION_S * S)


def armed(driver: Any) -> Supervisor:
    """Return the supervisor of an armed session, in which no participant falls silent."""
    driver.until("ARMED")
    liveness = LivenessMonitor()
    hear_all(liveness, 300 * S)
    return Supervisor(driver.session, liveness)


def arm_failures(driver: Any) -> list[str]:
    return [f.reason for f in driver.session.outbox if getattr(f, "event", "") == "arm_failed"]


@pytest.mark.parametrize("heard", [None, ControlState.PRE_ARMING, ControlState.DISARMED])
def test_objects_have_their_time_to_arm(driver: Any, heard: ControlState | None) -> None:
    supervisor, targets = armed(driver), driver.session.targets
    if heard is None:
        del targets["ot1"]
    else:
        targets["ot1"] = replace(targets["ot1"], control_state=heard)
    supervisor.look(99 * S, driver.now_ns)  # nobody was told to
    supervisor.on_arm_commands(100 * S)
    supervisor.look(100 * S + ARM_NS, driver.now_ns)
    assert (arm_failures(driver), driver.session.state) == ([], SessionPhase.ARMED)
    supervisor.look(100 * S + ARM_NS + 1, driver.now_ns)
    supervisor.look(200 * S, driver.now_ns)
    assert arm_failures(driver) == [f"ot1 did not arm in {ARM_CONFIRMATION_S:g} s"]
    assert driver.session.state is SessionPhase.CONNECTED


def test_all_that_did_not_arm_are_named_and_the_fall_back_has_its_time(
    make_driver: Any, run_mapping: dict[str, Any]
) -> None:
    driver = make_driver(two_objects(run_mapping))
    supervisor, targets = armed(driver), driver.session.targets
    for who, state in targets.items():
        targets[who] = replace(state, control_state=ControlState.PRE_ARMING)
    supervisor.on_arm_commands(100 * S)
    supervisor.look(100 * S + ARM_NS + 1, 7 * S)
    change, _ = driver.session.outbox[-2:]
    assert change.reason == f"ot1, ot2 did not arm in {ARM_CONFIRMATION_S:g} s"
    assert (change.event, change.stamp_ns) == ("arm_failed", 7 * S)


@pytest.mark.parametrize("phase", ["ARMED", "CONNECTED"])
def test_nothing_to_wait_for(driver: Any, phase: str) -> None:
    supervisor, targets = armed(driver), driver.session.targets
    waiting = replace(targets["ot1"], control_state=ControlState.DISARMED)
    supervisor.on_arm_commands(0)
    if phase == "CONNECTED":
        driver.command("disarm")
    else:
        targets["ot1"] = replace(waiting, control_state=ControlState.ARMED)
    supervisor.look(S, driver.now_ns)
    # That it was settled once is enough, whatever comes later.
    targets["ot1"] = waiting
    supervisor.look(9 * S, driver.now_ns)
    assert (arm_failures(driver), driver.session.state.name) == ([], phase)


class Aborting:
    """An aborting session whose OT moves, and who was last heard when, s on the steady clock."""

    def __init__(self, driver: Any) -> None:
        driver.until("RUNNING")
        driver.command("abort")
        driver.move("vut", speed_mps=0.0)
        driver.move("ot1", speed_mps=3.0)
        driver.step(control_state=ControlState.ABORTING)
        self.driver = driver
        self._liveness = LivenessMonitor()
        self._supervisor = Supervisor(driver.session, self._liveness)

    def gives_up(self, at_s: float, world_s: float, ot1_s: float) -> bool:
        self._liveness.hear(names.SIL_WORLD, round(world_s * S))
        self._liveness.hear("ot1", round(ot1_s * S))
        return self._supervisor.look(round(at_s * S), self.driver.now_ns)


def test_a_living_world_is_given_time_for_the_standstill(driver: Any) -> None:
    aborting = Aborting(driver)
    for t in (100.0, 101.0, 105.0, 100.0 + ABORT_STANDSTILL_S):
        assert not aborting.gives_up(t, t, t)
    end_s = 100.1 + ABORT_STANDSTILL_S
    assert aborting.gives_up(end_s, end_s, end_s)


def test_a_dead_world_confirms_nothing(driver: Any) -> None:
    """Silent when the abort began, it is given as long to go on as it may need for a step."""
    aborting = Aborting(driver)
    late_s = 100.1 + WORLD_SILENT_LOCKSTEP_S
    assert [aborting.gives_up(t, 96.0, 100.0) for t in (100.0, late_s - 0.2, late_s)] == [
        False,
        False,
        True,
    ]


def test_a_realtime_world_is_dead_after_a_second_of_the_abort(
    make_driver: Any, run: RunSpec
) -> None:
    aborting = Aborting(make_driver(run.model_copy(update={"mode": "realtime"})))
    assert [aborting.gives_up(t, 95.0, t) for t in (100.0, 101.0, 101.1)] == [False, False, True]


@pytest.mark.parametrize(
    ("mode", "world_silent_s", "silent_s", "stops_waiting"),
    [
        ("lockstep", 0.0, 0.5, False),
        ("lockstep", 0.0, 1.0, False),
        ("lockstep", 0.0, 1.5, True),
        # While the world waits, nobody says anything.
        ("lockstep", 5.0, 6.0, False),
        ("lockstep", 5.0, 6.5, True),
        ("lockstep", 60.0, WORLD_SILENT_LOCKSTEP_S + 1.0, False),
        ("lockstep", 60.0, WORLD_SILENT_LOCKSTEP_S + 1.5, True),
        # Here it waits for nobody.
        ("realtime", 0.75, 1.0, False),
        ("realtime", 0.75, 1.5, True),
    ],
)
def test_an_object_that_is_silent_is_not_waited_for(
    make_driver: Any,
    run: RunSpec,
    mode: str,
    world_silent_s: float,
    silent_s: float,
    stops_waiting: bool,
) -> None:
    """The object isn't heard, and all others stand."""
    aborting = Aborting(make_driver(run.model_copy(update={"mode": mode})))
    assert aborting.gives_up(100.0, 100.0 - world_silent_s, 100.0 - silent_s) is stops_waiting


@pytest.mark.parametrize(
    ("mode", "stops_waiting"), [("lockstep", True), ("realtime", True), ("live", False)]
)
def test_the_time_of_a_simulated_world_counts_for_the_standstill_too(
    make_driver: Any, run: RunSpec, mode: str, stops_waiting: bool
) -> None:
    """It may be far ahead of the steady clock; that of a live session may just have been set."""
    driver = make_driver(run.model_copy(update={"mode": mode}))
    driver.now_ns = 100 * S
    aborting = Aborting(driver)
    assert not aborting.gives_up(100.0, 100.0, 100.0)
    driver.now_ns += round(ABORT_STANDSTILL_S * S)
    assert not aborting.gives_up(100.1, 100.1, 100.1)
    driver.now_ns += 1
    assert aborting.gives_up(100.2, 100.2, 100.2) is stops_waiting


def test_an_abort_without_a_run_waits_for_the_world_alone(driver: Any) -> None:
    driver.command("abort")
    liveness = LivenessMonitor()
    liveness.hear_strangers(["2 publish a: ours, forger"])
    watchdog = Supervisor(driver.session, liveness)
    assert [watchdog.look(steady_ns, 0) for steady_ns in (S, 2 * S, 2 * S + 1)] == [
        False,
        False,
        True,
    ]
    assert driver.session.state is SessionPhase.ABORTING


def test_a_standstill_that_nobody_reports_is_given_up_once_and_by_name(driver: Any) -> None:
    """The report ends those that follow the session from elsewhere; the session keeps its state."""
    session = Aborting(driver).driver.session
    session.outbox.clear()
    for _ in range(2):
        session.give_up_on_standstill(driver.now_ns)
    (told,) = session.outbox
    assert (told.state, told.previous) == (SessionPhase.ABORTING, SessionPhase.ABORTING)
    assert (told.event, told.reason) == (STANDSTILL_GIVEN_UP, "not known to stand: ot1")
    assert (told.verdict, session.state) == (Verdict.ABORTED, SessionPhase.ABORTING)
    driver.command("abort")
    session.outbox.clear()
    session.give_up_on_standstill(driver.now_ns)
    assert [one.event for one in session.outbox] == [STANDSTILL_GIVEN_UP]


@pytest.mark.parametrize(
    ("control_state", "who"),
    [
        (ControlState.ARMED, "ot1"),
        (ControlState.RUNNING, "ot1"),
        (ControlState.ABORTING, "everything"),
        (None, "ot1"),
    ],
)
def test_who_stands_without_having_heard_the_abort_is_not_known_to_stand(
    driver: Any, control_state: ControlState | None, who: str
) -> None:
    session = Aborting(driver).driver.session
    if control_state is None:
        del session.targets["ot1"]
    else:
        heard = {"stamp_ns": driver.now_ns, "control_state": control_state, "speed_mps": 0.0}
        session.targets["ot1"] = replace(driver.targets["ot1"], **heard)
    session.outbox.clear()
    session.give_up_on_standstill(driver.now_ns)
    (told,) = session.outbox
    assert told.reason == f"not known to stand: {who}"
    assert told.stamp_ns == driver.now_ns


def test_all_that_are_not_known_to_stand_are_named(
    make_driver: Any, run_mapping: dict[str, Any]
) -> None:
    driver = make_driver(two_objects(run_mapping))
    session = Aborting(driver).driver.session
    driver.move("ot2", speed_mps=3.0)
    driver.hear()
    session.outbox.clear()
    session.give_up_on_standstill(driver.now_ns)
    (told,) = session.outbox
    assert told.reason == "not known to stand: ot1, ot2"


def test_nothing_is_given_up_before_an_abort(driver: Any) -> None:
    driver.until("RUNNING")
    driver.session.outbox.clear()
    driver.session.give_up_on_standstill(driver.now_ns)
    assert driver.session.outbox == []


def test_the_wait_begins_anew_with_each_abort(driver: Any) -> None:
    aborting, session = Aborting(driver), driver.session
    assert not aborting.gives_up(1.0, 1.0, 1.0)
    driver.move("ot1", speed_mps=0.0)
    driver.step(control_state=ControlState.ABORTING)
    assert session.state is SessionPhase.ABORTED
    assert not aborting.gives_up(99.0, 0.0, 0.0)
    driver.move("ot1", speed_mps=3.0)
    session.state = SessionPhase.ABORTING
    assert not aborting.gives_up(99.0, 99.0, 99.0)


@pytest.mark.parametrize(
    ("measured", "limit", "late_s", "own"),
    [
        # A limit shorter than the manager's own pause, which without it was kept.
        (0.32, 0.3, 0.31, True),
        (0.32, 0.3, 0.30, False),
        (0.62, 0.3, 0.31, False),
        (-3.0, 0.1, 0.31, False),
        (math.inf, 0.3, 0.49, False),
        # Just as long as the limit allows, without the pause.
        (0.625, 0.25, 0.375, True),
        # Whatever it was, after half a second nothing is known.
        (3.0, 0.3, 0.5, False),
        (3.0, 0.3, 0.51, True),
    ],
)
def test_a_pause_of_the_manager_counts_from_the_limit_that_is_judged(
    measured: float, limit: float, late_s: float, own: bool
) -> None:
    code = SafetyCode.CLOCK_OFFSET if measured < 0.0 else SafetyCode.OBJECT_SILENT
    found = Violation(code, "ot1", measured, limit, 0)
    judged = own_lateness(found, late_s, 0.5)
    assert (judged.code is SafetyCode.OVERRUN) is own
    assert own or judged is found


def test_the_longest_pause_of_late_is_remembered(driver: Any) -> None:
    watchdog = Supervisor(driver.session, LivenessMonitor())
    for at_s in (1.0, 1.4, 1.45, 1.65):
        watchdog.wake(round(at_s * S))
    assert driver.session.late_s == pytest.approx(0.4)
    for k in range(40):
        watchdog.wake(round((1.7 + 0.05 * k) * S))
    assert driver.session.late_s == 0.0


def test_a_world_that_waits_for_its_camera_is_named_and_not_the_vut(
    run_mapping: dict[str, Any],
) -> None:
    """A machine on which the camera needs long to come up."""
    run = RunSpec.model_validate(run_mapping).model_copy(
        update={"camera": Camera(), "mode": "lockstep"}
    )
    liveness = LivenessMonitor()

    def missing() -> list[str]:
        facts = liveness.facts(run, S)
        return [one.text for one in obstacles(Gate.CONNECT, run, facts, None, {}, 0)]

    for who in (names.OBJECT_TARGET, names.MONITOR):
        liveness.hear_answer(who)
    assert missing()[0] == "no state of the VUT arrives"  # nobody knows of a world yet
    liveness.hear(names.SIL_WORLD, S)
    assert missing()[0] == (
        "the simulated world waits for front_camera: no answer to its first step"
    )
    assert not any("VUT" in text for text in missing())
    liveness.hear_answer(names.FRONT_CAMERA)
    assert missing()[0] == "no state of the VUT arrives"
