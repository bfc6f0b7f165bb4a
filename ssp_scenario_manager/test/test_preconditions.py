"""What keeps a session from connecting, arming and starting: each thing, and all at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState
from ssp_scenario_manager.session.link_quality import LinkEstimate
from ssp_scenario_manager.session.preconditions import Facts, missing_for
from ssp_scenario_manager.session.state_machine import SessionEvent

S = 1_000_000_000
NOW_NS = 50 * S
LINK = LinkEstimate(0.001, 0.002, 0.1)
READY = Facts(
    recorder_ready=True,
    recorder_age_s=0.1,
    camera_age_s=0.1,
    vut_age_s=0.1,
    target_age_s={"ot1": 0.1},
    links={"ot1": LINK},
)
StateMaker = Callable[..., ObjectState]
# At the instant of the states.
missing_to_connect = partial(missing_for, SessionEvent.CONNECT, now_ns=NOW_NS)
missing_to_arm = partial(missing_for, SessionEvent.ARM, now_ns=NOW_NS)
missing_to_start = partial(missing_for, SessionEvent.START, now_ns=NOW_NS)


@pytest.fixture
def vut(state: StateMaker) -> ObjectState:
    return state("vut", stamp_ns=NOW_NS)


@pytest.fixture
def ot1(state: StateMaker) -> ObjectState:
    return state("ot1", stamp_ns=NOW_NS, x_m=40.0, y_m=3.5, control_state=ControlState.DISARMED)


# -- connect --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("age_s", "says"),
    [
        (1.0, None),
        (1.001, "no state of {} arrives: none for 1.00 s, limit 1 s"),
        (7.5, "no state of {} arrives: none for 7.50 s, limit 1 s"),
        (math.inf, "no state of {} arrives"),
    ],
)
def test_connect_needs_fresh_states(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, age_s: float, says: str | None
) -> None:
    targets = {"ot1": ot1}
    assert missing_to_connect(run, READY, vut, targets) == []
    facts = replace(READY, vut_age_s=age_s)
    missing = [says.format("the VUT")] if says else []
    assert missing_to_connect(run, facts, vut, targets) == missing
    facts = replace(READY, target_age_s={"ot1": age_s})
    missing = [says.format("ot1")] if says else []
    assert missing_to_connect(run, facts, vut, targets) == missing


# -- arm ------------------------------------------------------------------------------------------


def test_nothing_is_missing(run: RunSpec, vut: ObjectState, ot1: ObjectState) -> None:
    assert missing_to_arm(run, READY, vut, {"ot1": ot1}) == []
    assert missing_to_arm(run, Facts.of_one_process(run), vut, {"ot1": ot1}) == []


@pytest.mark.parametrize(
    ("facts", "says"),
    [
        ({"recorder_age_s": 2.0}, None),
        ({"recorder_age_s": 2.01}, "the recorder is silent"),
        ({"recorder_ready": False}, "the recorder is not ready: its file is not open"),
        (
            {"recorder_ready": False, "recorder_missing": ("/ssp/a", "/ssp/b")},
            "the recorder is not ready: /ssp/a, /ssp/b",
        ),
        ({"recorder_lost": 2}, "the recorder has lost 2 messages, limit 0"),
    ],
)
def test_the_recorder(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, facts: dict[str, Any], says: str | None
) -> None:
    missing = [says] if says else []
    assert missing_to_arm(run, replace(READY, **facts), vut, {"ot1": ot1}) == missing


def test_the_camera_counts_if_there_is_one(
    run_mapping: dict[str, Any], run: RunSpec, vut: ObjectState, ot1: ObjectState
) -> None:
    facts = replace(READY, camera_age_s=3.01)
    assert missing_to_arm(run, facts, vut, {"ot1": ot1}) == []
    run_mapping["camera"] = {}
    seen = RunSpec.model_validate(run_mapping)
    assert missing_to_arm(seen, facts, vut, {"ot1": ot1}) == ["no camera frame arrives"]
    assert missing_to_arm(seen, replace(READY, camera_age_s=3.0), vut, {"ot1": ot1}) == []


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"x_m": 41.5}, []),
        ({"x_m": 41.51}, ["ot1 is 1.51 m from its start, limit 1.5 m"]),
        ({"speed_mps": 0.05}, []),
        ({"speed_mps": -0.06}, ["ot1 moves at -0.06 m/s, limit 0.05 m/s"]),
        ({"control_state": ControlState.ARMED}, []),
        ({"control_state": ControlState.ABORTING}, ["ot1 is ABORTING, not DISARMED or ARMED"]),
        ({"control_state": ControlState.OFF}, ["ot1 is OFF, not DISARMED or ARMED"]),
        ({"position_std_m": 0.5}, []),
        ({"position_std_m": 0.51}, ["the position of ot1 is uncertain by 0.51 m, limit 0.5 m"]),
        ({"stamp_ns": NOW_NS - 300_000_000}, []),
        ({"stamp_ns": NOW_NS - 310_000_000}, ["the state of ot1 is 0.31 s old, limit 0.3 s"]),
        ({"stamp_ns": NOW_NS + 50_000_000}, []),
        (
            {"stamp_ns": NOW_NS + 51_000_000},
            ["the state of ot1 is stamped 0.051 s ahead of time, limit 0.05 s"],
        ),
        ({"x_m": math.nan}, ["ot1 has a state with a value that is no number"]),
    ],
)
def test_each_target_in_place_and_disarmed(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, changed: dict[str, Any], says: list[str]
) -> None:
    assert missing_to_arm(run, READY, vut, {"ot1": replace(ot1, **changed)}) == says


@pytest.mark.parametrize(
    ("link", "says"),
    [
        (LinkEstimate(0.05, 0.5, 1.0), []),
        (LinkEstimate(-0.05, 0.0, 0.0), []),
        (LinkEstimate(0.051, 0.002, 0.1), ["the clock of ot1 is off by 0.051 s, limit 0.05 s"]),
        (LinkEstimate(-9.0, 0.002, 0.1), ["the clock of ot1 is off by -9.000 s, limit 0.05 s"]),
        (
            LinkEstimate(0.0, 0.501, 0.1),
            ["the link to ot1 takes 0.501 s there and back, limit 0.5 s"],
        ),
        (
            LinkEstimate(0.2, 0.6, 0.1),
            [
                "the clock of ot1 is off by 0.200 s, limit 0.05 s",
                "the link to ot1 takes 0.600 s there and back, limit 0.5 s",
            ],
        ),
        (
            LinkEstimate(0.0, 0.0, 1.25),
            [
                "clock offset and link delay of ot1 are not measured: "
                "no answer to heartbeats for 1.25 s, limit 1 s"
            ],
        ),
        (
            LinkEstimate(),
            ["clock offset and link delay of ot1 are not measured: no answer to heartbeats"],
        ),
    ],
)
def test_each_link_is_measured_and_good(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, link: LinkEstimate, says: list[str]
) -> None:
    facts = replace(READY, links={"ot1": link})
    assert missing_to_arm(run, facts, vut, {"ot1": ot1}) == says


def test_there_is_one_manager(run: RunSpec, vut: ObjectState, ot1: ObjectState) -> None:
    missing = missing_to_arm(run, replace(READY, other_managers=1), vut, {"ot1": ot1})
    assert missing == ["1 other managers, limit 0"]


def test_the_vut_in_place(run: RunSpec, vut: ObjectState, ot1: ObjectState) -> None:
    away = replace(vut, x_m=-11.0, speed_mps=1.0)
    assert missing_to_arm(run, READY, away, {"ot1": ot1}) == [
        "vut is 11.00 m from its start, limit 1.5 m",
        "vut moves at 1.00 m/s, limit 0.05 m/s",
        "vut is outside the geofence by 1.90 m, limit 0 m",
    ]


def test_the_whole_vut_is_inside_the_fence(
    run_mapping: dict[str, Any], vut: ObjectState, ot1: ObjectState
) -> None:
    """Its reference point is inside, its right side isn't: 0.9 m to the right."""
    run_mapping["geofence"] = [(-10.0, -0.7), (300.0, -0.7), (300.0, 10.0), (-10.0, 10.0)]
    narrow = RunSpec.model_validate(run_mapping)
    assert missing_to_arm(narrow, READY, vut, {"ot1": ot1}) == [
        "vut is outside the geofence by 0.20 m, limit 0 m"
    ]


def test_the_start_region_is_the_sites(
    run_mapping: dict[str, Any], vut: ObjectState, ot1: ObjectState
) -> None:
    run_mapping["limits"]["start_region_m"] = 0.25
    strict = RunSpec.model_validate(run_mapping)
    for x_m, says in ((0.25, []), (0.26, ["vut is 0.26 m from its start, limit 0.25 m"])):
        assert missing_to_arm(strict, READY, replace(vut, x_m=x_m), {"ot1": ot1}) == says


@pytest.mark.parametrize(
    ("mode", "age_ms", "says"),
    [
        ("live", 60, []),  # two periods, and one until the next state comes
        (
            "live",
            80,
            [
                "states of vut are 0.060 s old when they come, limit for triggers 0.04 s "
                "(limits.trigger_age_s)"
            ],
        ),
        ("lockstep", 80, []),
    ],
)
def test_a_live_vut_is_not_too_late_for_triggers(
    run: RunSpec, vut: ObjectState, ot1: ObjectState, mode: str, age_ms: int, says: list[str]
) -> None:
    late = replace(vut, stamp_ns=NOW_NS - age_ms * 1_000_000)
    spec = run.model_copy(update={"mode": mode})
    assert missing_to_arm(spec, READY, late, {"ot1": ot1}) == says


def test_an_age_at_the_limit_for_triggers_is_allowed(
    run_mapping: dict[str, Any], vut: ObjectState, ot1: ObjectState
) -> None:
    run_mapping |= {"mode": "live", "step_s": 0.0625}
    run_mapping["limits"]["trigger_age_s"] = 0.125
    spec = RunSpec.model_validate(run_mapping)
    for age_ns, count in ((187_500_000, 0), (187_500_001, 1)):
        late = replace(vut, stamp_ns=NOW_NS - age_ns)
        assert len(missing_to_arm(spec, READY, late, {"ot1": ot1})) == count


def test_separation_before_the_start(
    run_mapping: dict[str, Any], vut: ObjectState, ot1: ObjectState
) -> None:
    # Bumper to bumper 0.25 m, limit 0.5 m: the run file itself asks for too little.
    run_mapping["targets"][0]["start"] = {"x_m": 4.75, "y_m": 0.0, "yaw_rad": 0.0}
    close = RunSpec.model_validate(run_mapping)
    near = replace(ot1, x_m=4.75, y_m=0.0)
    assert missing_to_arm(close, READY, vut, {"ot1": near}) == [
        "ot1 is 0.25 m from vut, limit 0.5 m"
    ]
    exact = replace(ot1, x_m=5.0, y_m=0.0, size=replace(ot1.size, rear_m=1.0))
    ahead = replace(vut, size=replace(vut.size, front_m=3.5))
    assert missing_to_arm(close, READY, ahead, {"ot1": exact}) == []


def test_separation_of_targets_from_each_other(
    run_mapping: dict[str, Any], vut: ObjectState, ot1: ObjectState
) -> None:
    ot2 = {"id": "ot2", "object_class": "car", "start": {"x_m": 44.9, "y_m": 3.5, "yaw_rad": 0.0}}
    run_mapping["targets"].append(ot2)
    both = RunSpec.model_validate(run_mapping)
    facts = replace(READY, target_age_s={"ot1": 0.1, "ot2": 0.1}, links={"ot1": LINK, "ot2": LINK})
    for x_m, says in ((44.9, ["ot2 is 0.40 m from ot1, limit 0.5 m"]), (45.1, [])):
        second = replace(ot1, object_id="ot2", x_m=x_m)
        assert missing_to_arm(both, facts, vut, {"ot1": ot1, "ot2": second}) == says


def test_everything_that_is_missing_is_named_at_once(
    run_mapping: dict[str, Any], state: StateMaker
) -> None:
    run_mapping["camera"] = {}
    ot2 = {"id": "ot2", "object_class": "car", "start": {"x_m": 70.0, "y_m": 0.0, "yaw_rad": 0.0}}
    run_mapping["targets"].append(ot2)
    both = RunSpec.model_validate(run_mapping)
    stray = state(
        "ot2", stamp_ns=NOW_NS, x_m=99.0, y_m=99.0, speed_mps=3.0, control_state=ControlState.INIT
    )
    assert missing_to_arm(both, Facts(), None, {"ot2": stray}) == [
        "no state of the VUT arrives",
        "no state of ot1 arrives",
        "no state of ot2 arrives",
        "the recorder is silent",
        "no camera frame arrives",
        "clock offset and link delay of ot1 are not measured: no answer to heartbeats",
        "clock offset and link delay of ot2 are not measured: no answer to heartbeats",
        "ot2 is INIT, not DISARMED or ARMED",
        "ot2 is 103.16 m from its start, limit 1.5 m",
        "ot2 moves at 3.00 m/s, limit 0.05 m/s",
        "ot2 is outside the geofence by 89.90 m, limit 0 m",
    ]


# -- start ----------------------------------------------------------------------------------------


def test_start_needs_armed_objects_that_are_still_heard(
    run: RunSpec, vut: ObjectState, ot1: ObjectState
) -> None:
    armed = {"ot1": replace(ot1, control_state=ControlState.ARMED)}
    assert missing_to_start(run, READY, vut, armed) == []
    assert missing_to_start(run, READY, vut, {"ot1": ot1}) == ["ot1 is DISARMED, not ARMED"]
    gone = replace(READY, vut_age_s=1.5, recorder_age_s=2.5)
    assert missing_to_start(run, gone, vut, armed) == [
        "no state of the VUT arrives: none for 1.50 s, limit 1 s",
        "the recorder is silent",
    ]


@pytest.mark.parametrize(
    ("facts", "changed"),
    [
        ({"recorder_ready": False}, {}),
        ({"recorder_lost": 1}, {}),
        ({"other_managers": 1}, {}),
        ({"links": {"ot1": LinkEstimate(0.2, 0.0, 0.0)}}, {}),
        ({}, {"x_m": 45.0}),
        ({}, {"x_m": 400.0}),
        ({}, {"x_m": 3.0, "y_m": 0.0}),
        ({}, {"speed_mps": 0.2}),
        ({}, {"position_std_m": 2.0}),
        ({}, {"stamp_ns": NOW_NS - S}),
        ({}, {"y_m": math.inf}),
    ],
)
def test_what_arming_needs_the_start_needs_again(
    run: RunSpec,
    vut: ObjectState,
    ot1: ObjectState,
    facts: dict[str, Any],
    changed: dict[str, Any],
) -> None:
    """Between the two somebody may have gone, moved or failed."""
    armed = {"ot1": replace(ot1, control_state=ControlState.ARMED, **changed)}
    known = replace(READY, **facts)
    missing = missing_to_start(run, known, vut, armed)
    assert missing
    assert missing == missing_to_arm(run, known, vut, armed)
