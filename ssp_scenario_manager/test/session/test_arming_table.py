"""The arming checks ask about everything that may end an armed session: one table holds both."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.run_file.model import Camera, RunSpec
from ssp_core.safety.arming import Gate, obstacles
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.link_quality import Exchange
from ssp_core.safety.liveness import SILENCES, WATCHED, SignOfLife, signs_of_life
from ssp_core.safety.object_rules import rules_of
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session import limits as session_limits
from ssp_scenario_manager.session.supervision import LivenessMonitor
from tests.support.runs import cut_in_run

S = 1_000_000_000
MS_S = 0.001
NOW_NS = 100 * S


def run_of(mode: str) -> RunSpec:
    run = RunSpec.model_validate(cut_in_run())
    return run.model_copy(update={"camera": Camera(), "mode": mode})


RUNS = [run_of(mode) for mode in ("lockstep", "realtime", "live")]
TABLE = [
    pytest.param(run, sign, id=f"{run.mode}-{sign.code.name}-{sign.who}-{sign.by_stamp}")
    for run in RUNS
    for sign in signs_of_life(run)
]
BY_ARRIVAL = [one for one in TABLE if not one.values[1].by_stamp]
BY_STAMP = [one for one in TABLE if one.values[1].by_stamp]


def liveness_with(run: RunSpec, silence_s: dict[SignOfLife, float]) -> LivenessMonitor:
    """Everybody was heard just now but those of whom it is said; an infinite silence: never."""
    liveness = LivenessMonitor()
    for target in run.targets:
        liveness.rules.hear((target.id, rules_of(run, target.id)))
    for sign in signs_of_life(run):
        late_s = silence_s.get(sign, 0.0)
        if sign.by_stamp or math.isinf(late_s):
            continue
        at_ns = NOW_NS - round(late_s * S)
        if sign.code is SafetyCode.REPLY_MISSING:
            exchange = Exchange(NOW_NS, NOW_NS, NOW_NS, NOW_NS)
            liveness.links.on_sent(1, NOW_NS)
            liveness.links.on_reply([sign.who], 1, exchange, at_ns)
        elif sign.code is SafetyCode.RECORDER:
            liveness.hear_recorder(True, (), 0, at_ns)
        else:
            liveness.hear(sign.who, at_ns)
    return liveness


def what_is_missing(driver: Any, liveness: LivenessMonitor, gate: Gate) -> list[str]:
    """Return the obstacles that a gate names when all participants stand in place."""
    facts = liveness.facts(driver.run, NOW_NS)
    found = obstacles(gate, driver.run, facts, driver.vut, driver.targets, NOW_NS)
    return [obstacle.text for obstacle in found]


def in_place(make_driver: Any, run: RunSpec, late: SignOfLife, age_s: float) -> Any:
    """A session's participants at their starts, with a state that is so old by its stamp."""
    driver = make_driver(run)
    driver.now_ns = NOW_NS
    driver.hear(ControlState.ARMED)
    if late.by_stamp:
        driver.move(late.who, stamp_ns=NOW_NS - round(age_s * S))
    return driver


@pytest.mark.parametrize("gate", [Gate.ARM, Gate.START])
@pytest.mark.parametrize(("run", "sign"), TABLE)
def test_arming_asks_for_half_of_each_limit(
    make_driver: Any, run: RunSpec, sign: SignOfLife, gate: Gate
) -> None:
    assert sign.arming_limit_s == 0.5 * sign.limit_s

    def missing(silence_s: float) -> list[str]:
        driver = in_place(make_driver, run, sign, silence_s)
        return what_is_missing(driver, liveness_with(run, {sign: silence_s}), gate)

    for kept_s in (0.0, sign.arming_limit_s):
        # A live VUT has a stricter limit of its own, by its trigger.
        assert all("limits.trigger_age_s" in text for text in missing(kept_s))
    for late_s in (sign.arming_limit_s + 2 * MS_S, 2.0 * sign.limit_s):
        told = [text for text in missing(late_s) if "trigger_age_s" not in text]
        assert len(told) == 1
        assert f"limit {sign.arming_limit_s:g} s" in told[0]


@pytest.mark.parametrize("gate", [Gate.ARM, Gate.START])
@pytest.mark.parametrize(("run", "sign"), BY_ARRIVAL)
def test_what_was_never_heard_is_missing(
    make_driver: Any, run: RunSpec, sign: SignOfLife, gate: Gate
) -> None:
    driver = in_place(make_driver, run, sign, 0.0)
    (told,) = what_is_missing(driver, liveness_with(run, {sign: math.inf}), gate)
    assert "inf" not in told
    assert "limit" not in told


@pytest.mark.parametrize(("run", "sign"), BY_ARRIVAL)
def test_a_longer_silence_ends_a_session(run: RunSpec, sign: SignOfLife) -> None:
    for phase in WATCHED:
        for late_s, ends in ((sign.limit_s, False), (sign.limit_s + MS_S, phase in sign.phases)):
            found = liveness_with(run, {sign: late_s}).violations(run, phase, NOW_NS, NOW_NS)
            assert [v.code for v in found] == ([sign.code] if ends else []), phase


@pytest.mark.parametrize(("run", "sign"), BY_STAMP)
def test_an_older_state_ends_a_session(
    make_driver: Any, tools: Any, run: RunSpec, sign: SignOfLife
) -> None:
    for late_s, ends in ((sign.limit_s, False), (sign.limit_s + MS_S, True)):
        driver = make_driver(run)
        driver.until("ARMED")
        driver.hear(ControlState.ARMED)
        since_ns = round(late_s * S)
        other = {driver.run.vut.id, *driver.targets} - {sign.who}
        for who in other:
            driver.move(who, stamp_ns=since_ns)
        driver.session.on_vut_state(driver.vut)
        for state in driver.targets.values():
            driver.session.on_target_state(state)
        driver.session.step(since_ns)
        assert tools.violations(driver.session.outbox) == ([sign.code] if ends else [])


def test_the_table_holds_every_silence_that_ends_a_session() -> None:
    for run in RUNS:
        found = LivenessMonitor().violations(run, SessionPhase.ARMED, NOW_NS, NOW_NS)
        assert {v.code for v in found} <= {s.code for s in signs_of_life(run)} <= SILENCES
        assert all("never heard" in v.text and "inf" not in v.text for v in found)


SILENCE_S = st.one_of(st.just(math.inf), st.floats(0.0, 20.0))


# The fixture is a function without a memory.
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(run=st.sampled_from(RUNS), data=st.data())
def test_what_ends_an_armed_session_keeps_it_from_being_armed(
    make_driver: Any, run: RunSpec, data: st.DataObject
) -> None:
    late = {sign: data.draw(SILENCE_S) for sign in signs_of_life(run) if data.draw(st.booleans())}
    liveness = liveness_with(run, late)
    liveness.recorder_lost = data.draw(st.integers(0, 1))
    if data.draw(st.booleans()):
        liveness.foreign["session_state"] = 1, "session_state has /x and /y"
    driver = in_place(make_driver, run, signs_of_life(run)[0], 0.0)
    if liveness.violations(run, SessionPhase.ARMED, NOW_NS, NOW_NS):
        for gate in (Gate.ARM, Gate.START):
            assert what_is_missing(driver, liveness, gate)


VALUE = st.one_of(st.floats(-3.0, 3.0), st.just(math.nan))
CHANGES: dict[str, st.SearchStrategy[Any]] = {
    "x_m": VALUE,
    "y_m": VALUE,
    "yaw_rad": VALUE,
    "speed_mps": st.one_of(st.floats(-0.1, 0.1), st.just(math.nan)),
    "acceleration_mps2": st.one_of(st.floats(-10.0, 10.0), st.just(math.nan)),
    "position_std_m": st.floats(0.0, 1.0),
    "error_longitudinal_m": VALUE,
    "error_lateral_m": VALUE,
    "error_yaw_rad": VALUE,
    "control_state": st.sampled_from(ControlState),
}


@pytest.mark.parametrize("by_course", [[], ["vut", "ot1"]])
@settings(
    max_examples=300,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_states_that_end_an_armed_session_keep_it_from_being_armed(
    make_driver: Any, by_course: list[str], data: st.DataObject
) -> None:
    """The manager asks before for all that it judges by one state."""
    run = RUNS[1]
    # Little is left beside the starts, so that a turned box sticks out or is too near.
    limits = run.limits.model_copy(
        update={"separation_m": 35.0, "heading_by_course": by_course, "start_region_m": 3.0}
    )
    fence = ((-3.5, -1.5), (60.0, -1.5), (60.0, 5.0), (-3.5, 5.0))
    run = run.model_copy(update={"limits": limits, "geofence": fence})
    driver = in_place(make_driver, run, signs_of_life(run)[0], 0.0)
    assert not what_is_missing(driver, liveness_with(run, {}), Gate.START)
    for who, state in (("vut", driver.vut), *driver.targets.items()):
        reference_id = data.draw(st.sampled_from(["", "of an earlier run"]))
        drawn = {"reference_id": reference_id, "control_state": state.control_state}
        for name in data.draw(st.lists(st.sampled_from(sorted(CHANGES)), max_size=2)):
            drawn[name] = data.draw(CHANGES[name], f"{who} {name}")
        for axis in drawn.keys() & {"x_m", "y_m"}:
            drawn[axis] += getattr(state, axis)
        driver.move(who, **drawn)
    present = [driver.vut, *driver.targets.values()]
    if found := session_limits.violations(present, run):
        for gate in (Gate.ARM, Gate.START):
            assert what_is_missing(driver, liveness_with(run, {}), gate), found


def test_an_error_off_a_reference_of_before_is_named(make_driver: Any) -> None:
    driver = in_place(make_driver, RUNS[1], signs_of_life(RUNS[1])[0], 0.0)
    driver.move("ot1", reference_id="an earlier run", error_lateral_m=-1.5)
    assert what_is_missing(driver, liveness_with(RUNS[1], {}), Gate.ARM) == [
        "the state of ot1 passes a limit: error_lateral -1.50 m, limit 0.8 m"
    ]


@pytest.mark.parametrize(
    ("yaw_rad", "says"),
    [
        (math.nan, "vut has a state with a value that is no number"),
        (math.pi / 2.0, "vut is outside the geofence by 0.60 m, limit 0 m"),
    ],
)
def test_the_heading_that_is_stated_at_rest_counts_for_fence_and_separation_too(
    make_driver: Any, yaw_rad: float, says: str
) -> None:
    """An armed session is judged by what is stated."""
    run = RUNS[1]
    limits = run.limits.model_copy(update={"heading_by_course": ["vut"]})
    fence = ((-10.0, -6.0), (300.0, -6.0), (300.0, 3.0), (-10.0, 3.0))
    run = run.model_copy(update={"limits": limits, "geofence": fence})
    driver = in_place(make_driver, run, signs_of_life(run)[0], 0.0)
    driver.move("vut", yaw_rad=yaw_rad)
    missing = what_is_missing(driver, liveness_with(run, {}), Gate.ARM)
    assert says in [text for text in missing if text.startswith("vut")]
    assert session_limits.violations([driver.vut], run)
