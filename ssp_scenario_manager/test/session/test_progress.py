"""The judgement of one instant of a run: from when it counts, whom it names, what is sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ElapsedTime, Hold, PhaseReached
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, Phase
from ssp_scenario_manager.dispatch.adaptation import Decision
from ssp_scenario_manager.dispatch.planned_motion import as_planned
from ssp_scenario_manager.session import outbox, progress
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.run import Run

MS = 1_000_000
S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (250.0, 0.0)])
# Another time than 0, since the session is older than its run.
START_NS = 10 * S
HOLD = Hold(kind="hold")
AT_ONCE = ElapsedTime(type="elapsed_time", after_s=0.0)
StateMaker = Callable[..., ObjectState]


def start_run(spec: RunSpec) -> Run:
    """A run that began at START_NS."""
    one = Run(spec, PATH)
    one.start(START_NS)
    return one


def findings(
    one: Run,
    now_ns: int,
    vut: ObjectState | None = None,
    target: ObjectState | None = None,
    *,
    running: bool = False,
) -> list[Violation]:
    targets: Mapping[str, ObjectState] = {} if target is None else {target.object_id: target}
    return progress.limits_passed(one, vut, targets, now_ns, running=running)


# -- silence --------------------------------------------------------------------------------------


def test_who_was_never_heard_has_been_silent_since_the_start_of_the_run(run: RunSpec) -> None:
    one = Run(run, PATH)
    assert findings(one, START_NS) == []
    one.start(START_NS)
    assert findings(one, START_NS + 300 * MS) == []
    now_ns = START_NS + 400 * MS
    assert findings(one, now_ns) == [
        Violation(SafetyCode.VUT_SILENT, "vut", 0.4, 0.3, now_ns),
        Violation(SafetyCode.OBJECT_SILENT, "ot1", 0.4, 0.3, now_ns),
    ]


def test_an_object_that_is_silent_is_not_judged_by_what_it_said_last(
    run: RunSpec, state: StateMaker
) -> None:
    now_ns = START_NS + S
    outside = state("ot1", stamp_ns=now_ns - 400 * MS, x_m=40.0, y_m=14.0)
    assert findings(start_run(run), now_ns, state(stamp_ns=now_ns), outside) == [
        Violation(SafetyCode.OBJECT_SILENT, "ot1", 0.4, 0.3, now_ns)
    ]


# -- states of one instant ------------------------------------------------------------------------


@pytest.mark.parametrize(("speed_mps", "codes"), [(0.0, []), (10.0, [SafetyCode.COLLISION])])
def test_an_object_is_judged_where_it_is_at_the_stamp_of_the_vut(
    run: RunSpec, state: StateMaker, speed_mps: float, codes: list[SafetyCode]
) -> None:
    """Its front was 1.5 m behind the VUT's rear 0.2 s before."""
    now_ns = START_NS + 200 * MS
    behind = state("ot1", stamp_ns=START_NS, x_m=-6.0, speed_mps=speed_mps)
    vut = state(stamp_ns=now_ns)
    assert [v.code for v in findings(start_run(run), now_ns, vut, behind)] == codes
    touching = progress.collisions(start_run(run), vut, {"ot1": behind}, now_ns)
    assert [v.code for v in touching] == codes


@pytest.mark.parametrize(("age_ms", "counts"), [(300, True), (301, False)])
@pytest.mark.parametrize("silent", ["vut", "ot1"])
def test_no_collision_is_made_of_where_a_silent_one_would_be(
    run: RunSpec, state: StateMaker, silent: str, age_ms: int, counts: bool
) -> None:
    now_ns = START_NS + S
    stamps_ns = {"vut": now_ns, "ot1": now_ns, silent: now_ns - age_ms * MS}
    vut = state(stamp_ns=stamps_ns["vut"])
    ot1 = state("ot1", stamp_ns=stamps_ns["ot1"], x_m=2.0, speed_mps=5.0)
    touching = progress.collisions(start_run(run), vut, {"ot1": ot1}, now_ns)
    assert [v.code for v in touching] == ([SafetyCode.COLLISION] if counts else [])


def test_before_the_vut_is_heard_an_object_is_judged_where_it_said_that_it_is(
    run: RunSpec, state: StateMaker
) -> None:
    outside = state("ot1", stamp_ns=START_NS, x_m=40.0, y_m=14.0)
    (one,) = findings(start_run(run), START_NS + 200 * MS, None, outside)
    assert (one.code, one.object_id) == (SafetyCode.OUTSIDE_GEOFENCE, "ot1")


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_state_that_is_no_number_is_named_whatever_its_stamp(
    run: RunSpec, state: StateMaker, value: float
) -> None:
    bad_state = state("ot1", stamp_ns=START_NS, x_m=40.0, yaw_rad=value)
    now_ns = START_NS + 20 * MS
    for vut in (state(stamp_ns=START_NS), state(stamp_ns=now_ns)):
        (one,) = findings(start_run(run), now_ns, vut, bad_state)
        assert (one.code, one.object_id) == (SafetyCode.STATE_NOT_FINITE, "ot1")
        assert progress.collisions(start_run(run), vut, {"ot1": bad_state}, now_ns) == []


# -- what is due in the run's own time ------------------------------------------------------------


def test_an_answer_that_stays_away_is_that_of_the_object_that_owes_it(
    run: RunSpec, state: StateMaker
) -> None:
    one = start_run(run)
    one.dispatches.approaches(START_NS)
    for late_ms, count in ((500, 0), (600, 1)):
        now_ns = START_NS + late_ms * MS
        ot = state("ot1", stamp_ns=now_ns, x_m=40.0, y_m=3.5)
        missing = [Violation(SafetyCode.ACK_MISSING, "ot1", 0.6, 0.5, now_ns)]
        assert findings(one, now_ns, state(stamp_ns=now_ns), ot) == missing[:count]


def test_the_duration_of_a_run_counts_from_its_start_and_is_nobodys_limit(
    run: RunSpec, state: StateMaker
) -> None:
    spec = run.model_copy(update={"limits": run.limits.model_copy(update={"duration_s": 2.0})})
    for elapsed_s, figures in ((2.0, []), (2.5, [(SafetyCode.DURATION, "", 2.5, 2.0)])):
        now_ns = START_NS + round(elapsed_s * S)
        ot = state("ot1", stamp_ns=now_ns, x_m=40.0, y_m=3.5)
        violations = findings(start_run(spec), now_ns, state(stamp_ns=now_ns), ot)
        assert [(v.code, v.object_id, v.measured, v.limit) for v in violations] == figures


@pytest.mark.parametrize("control", [ControlState.ARMED, ControlState.PRE_RUNNING])
def test_an_object_has_its_time_to_begin_from_the_start_of_the_run(
    run: RunSpec, state: StateMaker, control: ControlState
) -> None:
    """It may bear 0.5 s of silence, and its states may be 0.3 s old."""
    detail = f"it is {control.name} while the session runs"
    for elapsed_ms, count in ((800, 0), (820, 1)):
        now_ns = START_NS + elapsed_ms * MS
        ot = state("ot1", stamp_ns=now_ns, x_m=40.0, y_m=3.5, control_state=control)
        departure = [Violation(SafetyCode.OBJECT_ABORTED, "ot1", 1.0, 0.0, now_ns, detail)]
        vut = state(stamp_ns=now_ns)
        assert findings(start_run(run), now_ns, vut, ot, running=True) == departure[:count]
        assert findings(start_run(run), now_ns, vut, ot) == []


# -- an event that stays away ---------------------------------------------------------------------


def with_latest(run: RunSpec, at_latest_s: float) -> RunSpec:
    return run.model_copy(update={"end": run.end.model_copy(update={"at_latest_s": at_latest_s})})


def test_an_event_is_overdue_at_its_latest_time_and_nobody_is_named(run: RunSpec) -> None:
    spec = with_latest(run, 2.0)
    one = start_run(spec)
    assert progress.overdue(one, START_NS + 2 * S - 1) is None
    now_ns = START_NS + 2 * S
    assert progress.overdue(one, now_ns) == Violation(
        SafetyCode.EVENT_MISSING, "", 2.0, 2.0, now_ns, "phase reached: approach"
    )


def test_no_event_is_overdue_before_the_start_nor_once_it_is_resolved_nor_in_a_driven_run(
    run: RunSpec,
) -> None:
    spec, now_ns = with_latest(run, 2.0), START_NS + 9 * S
    assert progress.overdue(start_run(spec), now_ns) is not None
    assert progress.overdue(Run(spec, PATH), now_ns) is None
    one = start_run(spec)
    one.event.resolved_ns = START_NS + S
    assert progress.overdue(one, now_ns) is None
    driven = Driven(driver="no_response", first_request_s=1.0, hand_over_s=2.0, end_s=20.0)
    assert progress.overdue(start_run(spec.model_copy(update={"driven": driven})), now_ns) is None


def test_states_that_came_too_late_for_triggers_stand_beside_the_phase_that_was_reached(
    run: RunSpec,
) -> None:
    one = start_run(with_latest(run, 2.0))
    one.triggers.late_states = 2
    late = progress.overdue(one, START_NS + 2 * S)
    assert late is not None
    assert late.detail.startswith("phase reached: approach; 2 states ")
    assert late.by_us


# -- triggers -------------------------------------------------------------------------------------


def test_a_trigger_that_has_nothing_to_send_is_blamed_on_its_object(
    run: RunSpec, state: StateMaker
) -> None:
    trigger = run.triggers[0].model_copy(update={"condition": AT_ONCE})
    one = start_run(run.model_copy(update={"triggers": [trigger]}))
    now_ns = START_NS + S
    assert progress.judge_triggers(one, state(stamp_ns=now_ns), {}, now_ns) == []
    why = "trigger gap fired, but ot1 was never heard"
    assert one.triggers.failed == Violation(
        SafetyCode.EVENT_MISSING, "ot1", 1.0, run.end.at_latest_s, now_ns, why
    )


def test_all_triggers_that_fire_at_one_state_send_what_they_should(
    run: RunSpec, state: StateMaker
) -> None:
    first = run.triggers[0].model_copy(update={"condition": AT_ONCE, "manoeuvre": HOLD})
    triggers = [first.model_copy(update={"id": name}) for name in ("a", "b", "c")]
    one = start_run(run.model_copy(update={"triggers": triggers}))
    now_ns = START_NS + 20 * MS
    facts = progress.judge_triggers(
        one, state(stamp_ns=now_ns), {"ot1": state("ot1", stamp_ns=now_ns)}, now_ns
    )
    assert [f.trigger_id for f in facts if isinstance(f, outbox.TriggerDecision)] == ["a", "b", "c"]


def test_a_trigger_that_waits_for_a_phase_fires_with_the_state_after_its_confirmation(
    make_driver: Callable[[RunSpec], Any], run: RunSpec
) -> None:
    first = run.triggers[0]
    condition = PhaseReached(type="phase_reached", phase="trigger")
    later = {"id": "later", "condition": condition, "manoeuvre": HOLD}
    triggers = [first, first.model_copy(update=later)]
    driver = make_driver(run.model_copy(update={"triggers": triggers, "observable": "braking"}))
    driver.until("RUNNING")
    driver.acknowledge()
    driver.move("ot1", y_m=0.0, acceleration_mps2=-2.0)
    for _ in range(11):
        driver.step()
    (start,) = driver.acknowledge()
    assert isinstance(start, PhaseBegan)
    assert (start.phase, start.stamp_ns) == (Phase.TRIGGER, 20 * MS)
    driver.step()
    (fact,) = driver.acknowledge()
    assert isinstance(fact, outbox.TriggerDecision)
    # The phase counts from when it began, and what fires from when that is known.
    assert (fact.trigger_id, fact.crossing_ns, fact.stamp_ns) == ("later", 20 * MS, 240 * MS)


# -- adaptation -----------------------------------------------------------------------------------


def manoeuvre_of(object_id: str) -> Any:
    """A manoeuvre of an object that stands for a second."""
    columns = np.zeros((7, 2))
    columns[0, 1] = 1.0
    return SimpleNamespace(
        target=SimpleNamespace(id=object_id), planned_motion=SimpleNamespace(columns=columns)
    )


def test_every_decision_on_a_manoeuvre_is_told_of_and_a_wrong_order_hides_no_other(
    run: RunSpec, state: StateMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    one, now_ns = start_run(run), START_NS + S
    pace = as_planned(now_ns + 100 * MS)
    decisions = [
        (manoeuvre_of("ot1"), Decision(wrong_order="the VUT would be too early")),
        (manoeuvre_of("ot2"), Decision(pace, "the gap will be off")),
        (manoeuvre_of("ot3"), Decision()),
    ]
    adaptations = one.dispatches.adaptations
    monkeypatch.setattr(adaptations, "judge", lambda *_: decisions)
    monkeypatch.setattr(adaptations, "take_notes", lambda: ["ot4 doesn't come there"])
    violation, reference, *notes = progress.watch_adaptation(one, state(stamp_ns=now_ns), now_ns)
    limit_s = run.end.at_latest_s
    assert violation == Violation(
        SafetyCode.EVENT_MISSING, "ot1", 1.0, limit_s, now_ns, "the VUT would be too early"
    )
    assert isinstance(reference, Reference)
    assert (reference.object_id, reference.execute_at_ns) == ("ot2", pace.start_ns)
    assert notes == [
        outbox.Note(now_ns, "ot2: the gap will be off"),
        outbox.Note(now_ns, "ot4 doesn't come there"),
    ]
