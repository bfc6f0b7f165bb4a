"""The obstacles to connecting, arming and starting a session: each thing, and all at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts, Gate, obstacles
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.object_rules import RulesCheck
from ssp_core.vocabulary import ControlState, ObjectClass
from ssp_scenario_manager.session.preconditions import moving, stands

S = 1_000_000_000
NOW_NS = 50 * S
LINK = LinkEstimate(0.001, 0.002, 0.1)
NODES = (names.SIL_WORLD, names.MONITOR, names.FRONT_CAMERA, names.VUT_ID, "ot1", "ot2")
AGES_S = dict.fromkeys(NODES, 0.1)
READY = Facts(
    recorder_ready=True,
    ages_s=AGES_S,
    links={"ot1": LINK, "ot2": LINK},
    rules={"ot1": RulesCheck("sha256:a"), "ot2": RulesCheck("sha256:b")},
)
CONNECT, ARM, START = Gate.CONNECT, Gate.ARM, Gate.START
StateMaker = Callable[..., ObjectState]
Changes = dict[str, Any]
NONE: Changes = {}
Ask = Callable[..., list[str]]


def ages(**changed: float) -> Changes:
    """Facts in which somebody was heard at another time."""
    return {"ages_s": {**AGES_S, **changed}}


@pytest.fixture
def ask(run_mapping: dict[str, Any], state: StateMaker) -> Ask:
    """A function that names the obstacles of a sound session with some changes."""

    def missing_at(
        event: Gate = ARM,
        facts: Changes = NONE,
        vut: Changes = NONE,
        ot1: Changes = NONE,
        ot2: Changes | None = None,
        limits: Changes = NONE,
        **run: Any,
    ) -> list[str]:
        given = {**run_mapping, **run, "limits": {**run_mapping["limits"], **limits}}
        placed = {"stamp_ns": NOW_NS, "x_m": 40.0, "y_m": 3.5}
        placed["control_state"] = ControlState.ARMED if event is START else ControlState.DISARMED
        targets = {"ot1": state("ot1", **{**placed, **ot1})}
        if ot2 is not None:
            targets["ot2"] = state("ot2", **{**placed, **ot2})
        spec, own = RunSpec.model_validate(given), state("vut", **{"stamp_ns": NOW_NS, **vut})
        found = obstacles(event, spec, replace(READY, **facts), own, targets, NOW_NS)
        return [obstacle.text for obstacle in found]

    return missing_at


def second(run_mapping: dict[str, Any], x_m: float, y_m: float) -> list[dict[str, Any]]:
    """The run's target, and one more."""
    start = {"x_m": x_m, "y_m": y_m, "yaw_rad": 0.0}
    return [*run_mapping["targets"], {"id": "ot2", "object_class": "car", "start": start}]


@pytest.mark.parametrize(
    ("age_s", "says"),
    [
        (0.25, None),
        (0.251, "no state of {} arrives: none for 0.25 s, limit 0.25 s"),
        (7.5, "no state of {} arrives: none for 7.50 s, limit 0.25 s"),
        (math.inf, "no state of {} arrives"),
    ],
)
def test_connect_needs_fresh_states(ask: Ask, age_s: float, says: str | None) -> None:
    missing = ask(CONNECT, facts=ages(vut=age_s), mode="live")
    assert missing == ([says.format("the VUT")] if says else [])
    missing = ask(CONNECT, facts=ages(ot1=age_s), mode="live")
    assert missing == ([says.format("ot1")] if says else [])


@pytest.mark.parametrize("event", [CONNECT, ARM, START])
def test_a_receiver_that_gives_no_state_says_why(ask: Ask, event: Gate) -> None:
    refused = "fix type: FIX, GBAS is asked for"
    says = f"the VUT's GNSS/INS gives no state: {refused}"
    assert ask(event, facts={"vut_refused": refused}) == [says]


@pytest.mark.parametrize("event", [CONNECT, ARM, START])
def test_nothing_is_missing(ask: Ask, run: RunSpec, event: Gate) -> None:
    assert ask(event) == []
    assert ask(event, facts=vars_of(Facts.of_one_process(run))) == []


def vars_of(facts: Facts) -> Changes:
    return {name: getattr(facts, name) for name in facts.__dataclass_fields__}


CAMERA: Changes = {"camera": {}}


OTHER_RULES = "ot1 judges by another step_s"
UNMEASURED = "clock offset and link delay of ot1 are not measured: no answer to heartbeats"


@pytest.mark.parametrize(
    ("facts", "run", "says"),
    [
        (ages(monitor=1.0), {}, []),
        (ages(monitor=1.01), {}, ["the recorder is silent for 1.01 s, limit 1 s"]),
        (ages(monitor=math.inf), {}, ["the recorder is silent"]),
        ({"recorder_ready": False}, {}, ["the recorder is not ready: its file is not open"]),
        (
            {"recorder_ready": False, "recorder_missing": ("/ssp/a", "/ssp/b")},
            {},
            ["the recorder is not ready: /ssp/a, /ssp/b"],
        ),
        ({"recorder_lost": 2}, {}, ["the recorder has lost 2 messages, limit 0"]),
        (ages(front_camera=1.51), {}, []),
        (ages(front_camera=math.inf), CAMERA, ["no camera frame arrives"]),
        (
            ages(front_camera=1.51),
            {**CAMERA, "mode": "live"},
            ["no camera frame arrives: none for 1.51 s, limit 1.5 s"],
        ),
        (ages(front_camera=1.5), {**CAMERA, "mode": "live"}, []),
        (ages(sil_world=math.inf), {}, ["no tick of the simulated world arrives"]),
        (ages(sil_world=math.inf), {"mode": "live"}, []),
        ({"rules": {}}, {}, ["ot1 has not said what it judges by"]),
        ({"rules": {"ot1": RulesCheck("d", "ot1 judges by another step_s")}}, {}, [OTHER_RULES]),
        ({"rules": {"ot1": RulesCheck("d", "", ("limits.speed_mps 8.0",))}}, {}, []),
        ({"other_managers": 1}, {}, ["1 publishers too many, limit 0"]),
    ],
)
def test_the_session_around_it(ask: Ask, facts: Changes, run: Changes, says: list[str]) -> None:
    assert ask(facts=facts, **run) == says
    assert ask(START, facts=facts, **run) == says


@pytest.mark.parametrize(
    ("link", "says"),
    [
        (LinkEstimate(0.05, 0.5, 0.25), []),
        (LinkEstimate(-0.05, 0.0, 0.0), []),
        (LinkEstimate(0.052, 0.002, 0.1), ["the clock of ot1 is off by 0.052 s, limit 0.051 s"]),
        (LinkEstimate(-9.0, 0.002, 0.1), ["the clock of ot1 is off by -9.000 s, limit 0.051 s"]),
        (
            LinkEstimate(0.2, 0.501, 0.1),
            ["the link to ot1 takes 0.501 s there and back, limit 0.5 s"],
        ),
        (LinkEstimate(0.0, 0.0, 1.25), [f"{UNMEASURED} for 1.25 s, limit 0.25 s"]),
        (LinkEstimate(), [UNMEASURED]),
    ],
)
def test_each_link_is_measured_and_good(ask: Ask, link: LinkEstimate, says: list[str]) -> None:
    assert ask(facts={"links": {"ot1": link}}) == says
    assert ask(START, facts={"links": {"ot1": link}}) == says


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"x_m": 41.5}, []),
        ({"x_m": 41.51}, ["ot1 is 1.51 m from its start, limit 1.5 m"]),
        ({"speed_mps": 0.05}, []),
        ({"speed_mps": -0.06}, ["ot1 moves at -0.06 m/s, limit 0.05 m/s"]),
        ({"control_state": ControlState.ABORTING}, ["ot1 is ABORTING, not {}"]),
        ({"control_state": ControlState.OFF}, ["ot1 is OFF, not {}"]),
        ({"position_std_m": 0.5}, []),
        ({"position_std_m": 0.51}, ["the position of ot1 is uncertain by 0.51 m, limit 0.5 m"]),
        ({"stamp_ns": NOW_NS - 150_000_000}, []),
        ({"stamp_ns": NOW_NS - 160_000_000}, ["the state of ot1 is 0.16 s old, limit 0.15 s"]),
        ({"stamp_ns": NOW_NS + 50_000_000}, []),
        (
            {"stamp_ns": NOW_NS + 51_000_000},
            ["the state of ot1 is stamped 0.051 s ahead of time, limit 0.05 s"],
        ),
        ({"x_m": math.nan}, ["ot1 has a state with a value that is no number"]),
        (
            {"size": Size(3.6, math.nan, 1.8, 1.5)},
            ["ot1 has a state with a value that is no number"],
        ),
        (
            {"size": Size(0.0, 0.0, 0.0, 0.0)},
            ["ot1 states an extent of 0 × 0 m, the least for a car is 2.25 × 0.9 m"],
        ),
        (
            {"object_class": ObjectClass.PEDESTRIAN},
            ["ot1 states that it is a pedestrian, and run.yaml that it is a car"],
        ),
    ],
)
def test_each_target_in_place(ask: Ask, changed: Changes, says: list[str]) -> None:
    """The place is checked at arming and again at the start: it may have changed meanwhile."""
    for event, wanted in ((ARM, "DISARMED or ARMED"), (START, "ARMED")):
        assert ask(event, ot1=changed) == [one.format(wanted) for one in says]


def test_the_start_needs_armed_objects(ask: Ask) -> None:
    assert ask(ARM, ot1={"control_state": ControlState.ARMED}) == []
    disarmed = {"control_state": ControlState.DISARMED}
    assert ask(START, ot1=disarmed) == ["ot1 is DISARMED, not ARMED"]


def test_the_vut_in_place(ask: Ask) -> None:
    assert ask(vut={"x_m": -11.0, "speed_mps": 1.0}) == [
        "vut is 11.00 m from its start, limit 1.5 m",
        "vut moves at 1.00 m/s, limit 0.05 m/s",
        "vut is outside the geofence by 1.90 m, limit 0 m",
    ]
    # Its reference point is inside, its right side isn't: 0.9 m to the right.
    narrow = [(-10.0, -0.7), (300.0, -0.7), (300.0, 10.0), (-10.0, 10.0)]
    assert ask(geofence=narrow) == ["vut is outside the geofence by 0.20 m, limit 0 m"]
    for x_m, says in ((0.25, []), (0.26, ["vut is 0.26 m from its start, limit 0.25 m"])):
        assert ask(vut={"x_m": x_m}, limits={"start_region_m": 0.25}) == says


def test_a_live_vut_is_not_too_late_for_triggers(ask: Ask) -> None:
    """Two periods or as the site says, and one until the next state comes."""
    old = {"stamp_ns": NOW_NS - 80_000_000}
    assert ask(vut={"stamp_ns": NOW_NS - 60_000_000}, mode="live") == []
    assert ask(vut=old) == []
    assert ask(vut=old, mode="live") == [
        "states of vut are 0.060 s old when they come, limit for triggers 0.04 s "
        "(limits.trigger_age_s)"
    ]
    for age_ns, count in ((187_500_000, 0), (187_500_001, 1)):
        late, limits = {"stamp_ns": NOW_NS - age_ns}, {"trigger_age_s": 0.125, "state_age_s": 0.5}
        assert len(ask(vut=late, mode="live", step_s=0.0625, limits=limits)) == count


def test_separation_before_the_start(ask: Ask, run_mapping: dict[str, Any]) -> None:
    """The run file itself asks for too little."""
    both = second(run_mapping, 44.9, 3.5)
    assert ask(ot2={"x_m": 44.9}, targets=both) == ["ot2 is 0.40 m from ot1, limit 0.5 m"]
    assert ask(ot2={"x_m": 45.1}, targets=both) == []
    run_mapping["targets"][0]["start"] = {"x_m": 4.75, "y_m": 0.0, "yaw_rad": 0.0}
    near = {"x_m": 4.75, "y_m": 0.0}
    assert ask(ot1=near) == ["ot1 is 0.25 m from vut, limit 0.5 m"]


def test_everything_that_is_missing_is_named_at_once(
    run_mapping: dict[str, Any], state: StateMaker
) -> None:
    given = {**run_mapping, "camera": {}, "targets": second(run_mapping, 70.0, 0.0)}
    stray = state(
        "ot2", stamp_ns=NOW_NS, x_m=99.0, y_m=99.0, speed_mps=3.0, control_state=ControlState.INIT
    )
    both = RunSpec.model_validate(given)
    found = obstacles(ARM, both, Facts(), None, {"ot2": stray}, NOW_NS)
    assert [obstacle.text for obstacle in found] == [
        "no state of the VUT arrives",
        "no state of ot1 arrives",
        "no state of ot2 arrives",
        "ot1 has not said what it judges by",
        "ot2 has not said what it judges by",
        "no tick of the simulated world arrives",
        "the recorder is silent",
        "no camera frame arrives",
        UNMEASURED,
        UNMEASURED.replace("ot1", "ot2"),
        "ot2 is INIT, not DISARMED or ARMED",
        "ot2 is 103.16 m from its start, limit 1.5 m",
        "ot2 moves at 3.00 m/s, limit 0.05 m/s",
        "ot2 is outside the geofence by 89.90 m, limit 0 m",
    ]


@pytest.mark.parametrize(
    ("yaw_rad", "says"),
    [
        (0.35, []),
        (-0.35, []),
        (0.36, ["vut is turned by +0.36 rad from its start's heading, limit 0.35 rad"]),
        (math.pi, ["vut is turned by +3.14 rad from its start's heading, limit 0.35 rad"]),
    ],
)
@pytest.mark.parametrize("event", [ARM, START])
def test_who_is_turned_is_named(ask: Ask, event: Gate, yaw_rad: float, says: list[str]) -> None:
    assert ask(event, vut={"yaw_rad": yaw_rad}) == says
    assert ask(CONNECT, vut={"yaw_rad": yaw_rad}) == []


@pytest.mark.parametrize("event", [ARM, START])
def test_who_has_no_heading_at_rest_is_turned_as_its_start_is(ask: Ask, event: Gate) -> None:
    by_course = {"heading_by_course": ["vut", "ot1"]}
    assert ask(event, vut={"yaw_rad": math.pi}, ot1={"yaw_rad": -1.5}, limits=by_course) == []
    (far,) = ask(event, vut={"yaw_rad": 1.0, "x_m": 2.0}, limits=by_course)
    assert far.startswith("vut is 2.00 m from its start")


def test_who_contradicts_its_places_is_named(ask: Ask) -> None:
    watch = ConsistencyWatch(Bounds())
    for k in range(100):
        watch.take(k * S // 50, 0.2 * k, 0.0, 0.0, 0.0)
    went, contradicts = ask(facts={"motion": {"vut": watch}})
    assert went == "vut says that it stands and went 10.00 m in 1 s, limit 0.10 m"
    assert contradicts.startswith("the states of vut contradict its places: empty twist: ")


# -- who is known to stand -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, True),
        ({"speed_mps": 0.05}, True),
        ({"speed_mps": -0.05}, True),
        ({"speed_mps": math.nextafter(0.05, 1.0)}, False),
        ({"speed_mps": -0.06}, False),
        ({"speed_mps": math.nan}, False),
        ({"stamp_ns": NOW_NS - S}, True),
        ({"stamp_ns": NOW_NS - S - 1}, False),
        ({"stamp_ns": NOW_NS + S}, True),
        ({"stamp_ns": NOW_NS + S + 1}, False),  # a clock that is far off proves nothing
        ({"control_state": ControlState.ARMED}, True),
        ({"control_state": ControlState.PRE_RUNNING}, False),
        ({"control_state": ControlState.RUNNING}, False),
        ({"control_state": ControlState.REMOTE_CONTROLLED}, False),
    ],
)
def test_one_object(state: StateMaker, changed: dict[str, Any], expected: bool) -> None:
    known = state("ot1", **{"stamp_ns": NOW_NS, **changed})
    assert stands(known, ConsistencyWatch(Bounds()), NOW_NS) is expected


@pytest.mark.parametrize("control", ControlState)
def test_in_an_abort_everybody_must_have_heard_it(state: StateMaker, control: ControlState) -> None:
    could_go = {"ARMED", "PRE_ARMING", "PRE_RUNNING", "RUNNING", "REMOTE_CONTROLLED"}
    known = state("ot1", stamp_ns=NOW_NS, control_state=control)
    assert stands(known, ConsistencyWatch(Bounds()), NOW_NS, aborting=True) is (
        control.name not in could_go
    )


def test_who_is_asked(run: RunSpec, state: StateMaker) -> None:
    vut, ot1 = state("vut", stamp_ns=NOW_NS), state("ot1", stamp_ns=NOW_NS)
    fast = state("ot1", stamp_ns=NOW_NS, speed_mps=1.0)
    places = {"vut": ConsistencyWatch(Bounds()), "ot1": ConsistencyWatch(Bounds())}
    assert moving(run, vut, {"ot1": ot1}, places, NOW_NS, armed=True) == []
    assert moving(run, vut, {"ot1": fast}, places, NOW_NS, armed=True) == ["ot1"]
    assert moving(run, vut, {"ot1": fast}, places, NOW_NS, armed=True, without=["ot1"]) == []
    # What was never heard must prove that it stands only once it could have been set in motion.
    assert moving(run, None, {}, places, NOW_NS, armed=False) == []
    assert moving(run, None, {}, places, NOW_NS, armed=True) == ["vut", "ot1"]


@pytest.mark.parametrize(("aborting", "who_moves"), [(False, []), (True, ["ot1"])])
def test_only_in_an_abort_an_object_that_is_armed_and_stands_counts_as_moving(
    run: RunSpec, state: StateMaker, aborting: bool, who_moves: list[str]
) -> None:
    places = {who: ConsistencyWatch(Bounds()) for who in ("vut", "ot1")}
    vut, ot1 = state("vut", stamp_ns=NOW_NS), state("ot1", stamp_ns=NOW_NS)
    targets = {"ot1": replace(ot1, control_state=ControlState.ARMED)}
    abort: Changes = {"aborting": True} if aborting else {}
    assert moving(run, vut, targets, places, NOW_NS, armed=True, **abort) == who_moves


@pytest.mark.parametrize("mode", ["lockstep", "realtime", "live"])
@pytest.mark.parametrize("covers_s", [0.0, 0.5, 0.98, 1.0, 1.5])
def test_in_a_live_session_places_must_show_a_standstill_of_a_second(
    run: RunSpec, state: StateMaker, mode: str, covers_s: float
) -> None:
    """A simulated world may hold, so that its places never cover one."""
    places = {who: ConsistencyWatch(Bounds()) for who in ("vut", "ot1")}
    for k in range(round(covers_s * 50) + 1):
        for watch in places.values():
            watch.take(k * S // 50, 5.0, 0.0, 0.0, 0.0)
    vut, ot1 = state("vut", stamp_ns=NOW_NS), state("ot1", stamp_ns=NOW_NS)
    spec = run.model_copy(update={"mode": mode})
    stand = mode != "live" or covers_s >= 1.0
    who_moves = [] if stand else ["vut", "ot1"]
    assert moving(spec, vut, {"ot1": ot1}, places, NOW_NS, armed=True) == who_moves
