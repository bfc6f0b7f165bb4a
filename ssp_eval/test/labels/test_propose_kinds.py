"""Label proposals for what comes without a side: a lead vehicle that brakes, and one hidden."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import Observable
from ssp_core.motion.event import find_event, instants_of
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.vocabulary import ObjectClass
from ssp_eval.labels.check import response_problems
from ssp_eval.labels.propose import propose
from ssp_eval.labels.truth import Truth
from ssp_eval.recordings.event import NO_RULES, rules_of
from ssp_eval.recordings.sight import blocked, clear_share, surface_points
from ssp_scenario_manager.event_spec.load import load_event
from tests.support.states import object_state as state

STEP_S = 0.04
TTC_ONLY = ConflictThresholds(ttc_s=3.0, arrival_gap_s=None)


def truth(
    series: list[tuple[float, list[ObjectState]]],
    thresholds: ConflictThresholds = NO_RULES.thresholds,
    observable: Observable | None = None,
    **more: object,
) -> Truth:
    rules = replace(NO_RULES, thresholds=thresholds, observable=observable)
    given = {
        "scenario": "made_up",
        "domain": "simulation",
        "event_version": "sha256:0",
        "start_s": 0.0,
        "end_s": series[-1][0],
        "vut_id": "vut",
        "target_ids": ("ot1",),
        "series": series,
        "source": "made up",
        "rules": rules,
    }
    return Truth(**{**given, **more})  # type: ignore[arg-type]  # a dictionary of fields


def with_observable(source: Truth, observable: Observable | None) -> Truth:
    return replace(source, rules=replace(source.rules, observable=observable))


def lead_braking(touch_s: float = 0.0) -> Truth:
    """A car 25 m ahead in the lane brakes at 4 m/s² from 4 s on, the VUT from 5.5 s on.

    Before that it eases off at 0.5 m/s², and touches its brake for ``touch_s`` at 2 s.
    """
    lead_x, lead_v, vut_x, vut_v = 33.0, 12.0, 0.0, 12.0
    series = []
    for k in range(round(12.0 / STEP_S)):
        t_s = k * STEP_S
        lead_a = -4.0 if t_s >= 4.0 else -0.5 if t_s >= 3.0 else 0.0
        if 2.0 <= t_s < 2.0 + touch_s:
            lead_a = -2.0
        lead_a = lead_a if lead_v > 0.0 else 0.0
        vut_a = -5.0 if t_s >= 5.5 and vut_v > 0.0 else 0.0
        cars = [
            state("ot1", ObjectClass.CAR, lead_x, 0.1, 0.0, lead_v, acceleration_mps2=lead_a),
            state("vut", ObjectClass.CAR, vut_x, 0.0, 0.0, vut_v, acceleration_mps2=vut_a),
        ]
        series.append((t_s, cars))
        lead_x, lead_v = lead_x + lead_v * STEP_S, max(0.0, lead_v + lead_a * STEP_S)
        vut_x, vut_v = vut_x + vut_v * STEP_S, max(0.0, vut_v + vut_a * STEP_S)
    return truth(series, thresholds=TTC_ONLY)


def occluded(trigger_s: float = 4.0, truck: bool = True) -> Truth:
    """A pedestrian walks out from before a truck that is parked at the right."""
    series = []
    for k in range(round(12.0 / STEP_S)):
        t_s = k * STEP_S
        walked = 1.6 * max(0.0, t_s - trigger_s)
        braking_s = min(max(0.0, t_s - 5.0), 10.0 / 4.0)
        x_m = 10.0 * min(t_s, 5.0) + 10.0 * braking_s - 2.0 * braking_s**2
        objects = [
            state(
                "ot1",
                ObjectClass.PEDESTRIAN,
                76.0,
                -5.0 + walked,
                math.pi / 2,
                1.6 if walked else 0.0,
            ),
            state("vut", ObjectClass.CAR, x_m, 0.0, 0.0, 10.0 - 4.0 * braking_s),
        ]
        if truck:
            objects.insert(1, state("ot2", ObjectClass.TRUCK, 67.0, -3.6))
        series.append((t_s, objects))
    ids = ("ot1", "ot2") if truck else ("ot1",)
    return truth(series, target_ids=ids, observable="lateral")


@pytest.mark.parametrize("observable", ["braking", None])
def test_a_lead_vehicle_that_brakes(observable: Observable | None) -> None:
    proposal = propose(with_observable(lead_braking(), observable))
    event = proposal.event
    assert event.trigger_s == pytest.approx(4.0, abs=STEP_S)
    assert event.arrival_s == event.trigger_s
    assert event.conflict_s is not None
    assert event.resolution_s is not None
    assert event.trigger_s < event.conflict_s < event.resolution_s
    labels = proposal.labels.labels
    assert {(x.position, x.motion) for x in labels if x.t_s < 6.0} == {("front", "same_direction")}
    assert {x.conflict for x in labels} >= {"no_conflict", "potential", "active"}
    assert response_problems(proposal.labels) == []


@pytest.mark.parametrize(("touch_s", "trigger_s"), [(0.12, 4.0), (0.4, 2.0)])
def test_a_touch_of_the_brake_is_no_manoeuvre(touch_s: float, trigger_s: float) -> None:
    event = propose(lead_braking(touch_s)).event
    assert event.trigger_s == pytest.approx(trigger_s, abs=STEP_S)


def test_braking_is_looked_for_only_where_it_is_the_event() -> None:
    with pytest.raises(InputError, match="from the side"):
        propose(with_observable(lead_braking(), "lateral"))
    with pytest.raises(InputError, match="brakes ahead"):
        propose(with_observable(occluded(), "braking"))


def test_braking_behind_the_vut_is_none() -> None:
    source = lead_braking()
    series = []
    for t_s, (lead, vut) in source.series:
        series.append((t_s, {"ot1": replace(lead, x_m=lead.x_m - 60.0), "vut": vut}))
    corridor = Corridor.of([now["vut"] for _, now in series])
    samples = instants_of(series, "vut", "ot1")
    assert find_event(samples, corridor.path, TTC_ONLY, "braking") is None


def test_who_is_hidden_has_no_position_and_no_risk_yet() -> None:
    hidden, open_ = propose(occluded()), propose(occluded(truck=False))
    assert hidden.event == open_.event
    onset_s = hidden.labels.risk_time_s
    assert onset_s is not None
    assert open_.labels.risk_time_s == open_.event.trigger_s
    assert open_.event.trigger_s + 0.2 < onset_s < open_.event.arrival_s
    for ours, theirs in zip(hidden.labels.labels, open_.labels.labels, strict=True):
        assert ours.phase == theirs.phase
        assert ours.risk_visible == (ours.t_s >= onset_s)
        if ours.t_s < onset_s:
            assert ours.objects == ("truck",)  # it matters: it hides somebody
            assert (ours.position, ours.motion) == (None, None)
            assert ours.conflict == ("no_conflict" if ours.phase == "approach" else None)
        else:
            assert ours.objects == ("pedestrian",)
            assert (ours.position, ours.motion) == (theirs.position, theirs.motion)
            assert ours.conflict == theirs.conflict
    assert {label.motion for label in hidden.labels.labels} == {None, "crossing_from_right"}


def test_thresholds_and_observable_of_a_shipped_event() -> None:
    event, _ = load_event("lead_braking")
    rules = rules_of(event)
    assert (rules.observable, rules.thresholds) == ("braking", TTC_ONLY)


EYE = np.array([0.0, 0.0, 1.4])


def test_a_wall_hides_what_is_lower_and_behind_it() -> None:
    truck = state("ot2", ObjectClass.TRUCK, 10.0, 0.0)
    walker = state("ot1", ObjectClass.PEDESTRIAN, 30.0, 0.0)
    assert clear_share(EYE, walker, []) == 1.0
    assert clear_share(EYE, walker, [truck]) == 0.0
    assert clear_share(EYE, replace(walker, x_m=5.0), [truck]) == 1.0  # before it
    assert clear_share(EYE, replace(walker, y_m=8.0), [truck]) == 1.0  # beside it
    car = state("ot3", ObjectClass.CAR, 10.0, 0.0)
    # 1.5 m high at 14 m: at 30 m what is higher than about 1.6 m looks over it.
    heights = surface_points(walker)[:, 2]
    seen = ~blocked(EYE, surface_points(walker), [car])
    assert not seen[heights < 1.5].any()
    tall = state("ot4", ObjectClass.TRUCK, 30.0, 0.0)
    assert 0.2 < clear_share(EYE, tall, [car]) < 0.8


@given(
    angle=st.floats(-3.0, 3.0),
    x_m=st.floats(3.0, 60.0),
    y_m=st.floats(-15.0, 15.0),
    yaw=st.floats(-3.1, 3.1),
)
def test_occlusion_does_not_depend_on_the_frame(
    angle: float, x_m: float, y_m: float, yaw: float
) -> None:
    wall = state("ot2", ObjectClass.BUS, 20.0, 1.0, yaw)
    other = state("ot1", ObjectClass.CAR, x_m, y_m, -yaw)
    c, s = math.cos(angle), math.sin(angle)

    def turned(o: ObjectState) -> ObjectState:
        return replace(
            o, x_m=c * o.x_m - s * o.y_m, y_m=s * o.x_m + c * o.y_m, yaw_rad=o.yaw_rad + angle
        )

    before = clear_share(EYE, other, [wall])
    # A line that only grazes a corner may fall on either side of it.
    assert clear_share(EYE, turned(other), [turned(wall)]) == pytest.approx(before, abs=0.13)
