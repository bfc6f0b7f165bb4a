"""Scenes that are nearly an event: the audit refuses each for what differs first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from ssp_core.vocabulary import ObjectClass
from ssp_eval.audit.evidence.measure import Scene, measure
from ssp_ot_controller.camera.ring import VUT_ARM
from tests.support.events.audit_scenes import (
    as_turn,
    braking,
    codes,
    crossed_from_the_left,
    crossing_car,
    crossing_road,
    cut_out,
    drift_across,
    from_the_right_arm,
    merge,
    oncoming_turn,
    ramp_road,
    ring_road,
    road,
    roundabout,
    slow_lead,
    turn_road,
    turning_left,
    turning_right,
    vut_turn,
    without_arms,
)

# The event, what is different, the scene, and the first finding.
NEAR = [
    ("roundabout", "a pedestrian", lambda: roundabout(cls=ObjectClass.PEDESTRIAN), "roles_differ"),
    ("roundabout", "a truck", lambda: roundabout(cls=ObjectClass.TRUCK), "roles_differ"),
    ("roundabout", "it waits", lambda: roundabout(start_s=60.0), "no_manoeuvre"),
    ("roundabout", "it leaves before the VUT", lambda: roundabout(leaves=VUT_ARM), "no_manoeuvre"),
    (
        "roundabout",
        "the VUT first",
        lambda: roundabout(8.0, vut=braking(23.0, 5.0, 60.0, 2.0)),
        "order_differs",
    ),
    (
        "roundabout",
        "no junction",
        lambda: roundabout(road=ring_road(junction=False)),
        "topology_differs",
    ),
    ("roundabout", "from the right, straight on", crossing_car, "wrong_side"),
    ("slow_lead", "a truck", lambda: slow_lead(cls=ObjectClass.TRUCK), "roles_differ"),
    ("slow_lead", "it stands", lambda: slow_lead(speed=0.0), "motion_differs"),
    ("slow_lead", "in the next lane", lambda: slow_lead(offset_m=3.5), "no_manoeuvre"),
    ("slow_lead", "beside the road", lambda: slow_lead(offset_m=-3.5), "no_manoeuvre"),
    ("slow_lead", "the VUT is first", lambda: slow_lead(x_m=-40.0), "no_manoeuvre"),
    (
        "slow_lead",
        "the VUT keeps away",
        lambda: slow_lead(vut=braking(0.0, 11.0, 1.0, 2.5, 3.0)),
        "no_manoeuvre",
    ),
    ("slow_lead", "it comes the other way", lambda: slow_lead(speed=-8.0), "motion_differs"),
    ("cut_out", "a truck stands", lambda: cut_out(cls=ObjectClass.TRUCK), "roles_differ"),
    ("cut_out", "it drives", lambda: cut_out(x_m=72.0, speed=2.0), "motion_differs"),
    ("cut_out", "it stands in the next lane", lambda: cut_out(side=3.5), "no_manoeuvre"),
    ("cut_out", "the VUT is first", lambda: cut_out(x_m=-20.0), "no_manoeuvre"),
    ("cut_out", "kept away", lambda: cut_out(vut=braking(0.0, 11.0, 1.0, 2.5)), "no_manoeuvre"),
    ("crossing_car", "from the left", lambda: crossing_car(side=1.0), "wrong_side"),
    (
        "crossing_car",
        "a pedestrian",
        lambda: crossing_car(cls=ObjectClass.PEDESTRIAN),
        "roles_differ",
    ),
    ("crossing_car", "a truck", lambda: crossing_car(cls=ObjectClass.TRUCK), "roles_differ"),
    (
        "crossing_car",
        "the VUT is first",
        lambda: crossing_car(6.5, vut=braking(0.0, 9.0, 60.0, 3.0)),
        "order_differs",
    ),
    ("crossing_car", "it waits", lambda: crossing_car(start_s=60.0), "no_manoeuvre"),
    (
        "crossing_car",
        "from beside the road",
        lambda: crossing_car(road=without_arms(crossing_road())),
        "place_differs",
    ),
    (
        "crossing_car",
        "far before the junction",
        lambda: crossing_car(road=crossing_road(120.0)),
        "topology_differs",
    ),
    (
        "crossing_car",
        "no junction",
        lambda: crossing_car(road=replace(crossing_road(), road=road().road)),
        "topology_differs",
    ),
    ("oncoming_turn", "from the right", lambda: oncoming_turn(side=-1.0), "lane_differs"),
    (
        "oncoming_turn",
        "a pedestrian",
        lambda: oncoming_turn(cls=ObjectClass.PEDESTRIAN),
        "roles_differ",
    ),
    ("oncoming_turn", "a truck", lambda: oncoming_turn(cls=ObjectClass.TRUCK), "roles_differ"),
    (
        "oncoming_turn",
        "the VUT is first",
        lambda: oncoming_turn(5.0, vut=braking(0.0, 9.0, 60.0, 3.0)),
        "order_differs",
    ),
    ("oncoming_turn", "it waits", lambda: oncoming_turn(start_s=60.0), "no_manoeuvre"),
    ("oncoming_turn", "it drifts across", drift_across, "conflict_type_differs"),
    (
        "oncoming_turn",
        "from the road on the left",
        lambda: crossing_car(side=1.0),
        "motion_differs",
    ),
    (
        "oncoming_turn",
        "no junction",
        lambda: oncoming_turn(road=replace(crossing_road(), road=road().road)),
        "topology_differs",
    ),
    (
        "oncoming_turn",
        "far before the junction",
        lambda: oncoming_turn(road=crossing_road(250.0)),
        "topology_differs",
    ),
    ("merge", "from the left", lambda: merge(side=-1.0), "wrong_side"),
    ("merge", "a pedestrian", lambda: merge(cls=ObjectClass.PEDESTRIAN), "roles_differ"),
    ("merge", "a truck", lambda: merge(cls=ObjectClass.TRUCK), "roles_differ"),
    ("merge", "it waits", lambda: merge(start_s=60.0), "no_manoeuvre"),
    (
        "merge",
        "the VUT is first",
        lambda: merge(8.0, vut=braking(8.0, 9.8, 60.0, 2.5)),
        "roles_swapped",
    ),
    (
        "merge",
        "from beside the road",
        lambda: merge(road=without_arms(ramp_road())),
        "place_differs",
    ),
    ("merge", "far before the junction", lambda: merge(road=ramp_road(200.0)), "topology_differs"),
    (
        "merge",
        "no junction",
        lambda: merge(road=replace(ramp_road(), road=road().road)),
        "topology_differs",
    ),
    ("vut_turn", "on the VUT's right", lambda: vut_turn(y_m=-3.5), "no_manoeuvre"),
    ("vut_turn", "a pedestrian", lambda: vut_turn(cls=ObjectClass.PEDESTRIAN), "roles_differ"),
    ("vut_turn", "a truck", lambda: vut_turn(cls=ObjectClass.TRUCK), "roles_differ"),
    ("vut_turn", "it waits", lambda: vut_turn(start_s=60.0), "no_manoeuvre"),
    (
        "vut_turn",
        "the VUT is first",
        lambda: vut_turn(6.0, vut=turning_left(36.0, 5.0, 60.0, 0.5, 80.0)),
        "order_differs",
    ),
    (
        "vut_turn",
        "it gets no priority",
        lambda: vut_turn(vut=turning_left(36.0, 5.0, 60.0, 0.5, 80.0)),
        "order_differs",
    ),
    ("vut_turn", "from the road on the left", crossed_from_the_left, "roles_differ"),
    ("vut_turn", "from the road on the right", from_the_right_arm, "roles_differ"),
    ("vut_turn", "from there in a wider turn", lambda: from_the_right_arm(10.0), "roles_differ"),
    (
        "vut_turn",
        "the VUT turns right",
        lambda: vut_turn(vut=turning_right(36.0, 5.0, 5.0, 0.5, 8.0)),
        "roles_differ",
    ),
    (
        "vut_turn",
        "the VUT goes on",
        lambda: vut_turn(vut=braking(36.0, 5.0, 60.0, 2.0)),
        "roles_differ",
    ),
    (
        "vut_turn",
        "no junction",
        lambda: vut_turn(road=turn_road(junction=False)),
        "topology_differs",
    ),
    ("vut_turn", "the VUT goes straight on", lambda: as_turn(crossing_car()), "roles_differ"),
]


@pytest.mark.parametrize(
    ("event", "made", "code"),
    [pytest.param(event, made, code, id=f"{event}: {name}") for event, name, made, code in NEAR],
)
def test_what_is_nearly_an_event_is_refused_with_what_differs(
    event: str, made: Callable[[], Scene], code: str
) -> None:
    assert codes(event, measure(made()))[:1] == [code]
