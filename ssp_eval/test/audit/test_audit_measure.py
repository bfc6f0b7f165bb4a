"""q(d, k), phases and facts from states alone (METHOD 1, 4): scenes whose answers are known."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.road import CurvePiece, Lane
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_eval.audit.checks import further_findings
from ssp_eval.audit.evidence.evidence import expected_properties, outside_ranges
from ssp_eval.audit.evidence.measure import Measurements, Scene, measure
from ssp_eval.audit.evidence.paths import Lanes
from ssp_eval.data.audit import CONFLICT, FIELDS, MOTION, ORDER, ROLES, TOPOLOGY, is_equal
from ssp_eval.recordings.sight import Moment, Optics, object_sight
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from tests.support.events.audit_scenes import (
    BOTH,
    STEP_S,
    TTC_ONLY,
    braking,
    braking_lead,
    codes,
    crossing,
    crossing_car,
    cut_in,
    cut_out,
    fixed,
    lead,
    merge,
    oncoming_turn,
    road,
    roundabout,
    scene,
    shift,
    slow_lead,
    vut_turn,
)


def words(found: Measurements, field: str, part: str) -> tuple[str, ...]:
    value = found.properties[field].words
    assert value is not None
    return value[part]


@pytest.mark.parametrize(
    ("event", "made", "relation", "motion"),
    [
        ("cut_in", cut_in, "merge", "cutting_in_from_left"),
        ("vru_crossing", crossing, "crossing", "crossing_from_right"),
        ("lead_braking", lead, "following", "same_direction"),
        ("slow_lead", slow_lead, "following", "same_direction"),
        ("cut_out", cut_out, "following", "stationary"),
        ("crossing_car", crossing_car, "crossing", "crossing_from_right"),
        ("oncoming_turn", oncoming_turn, "crossing", "oncoming"),
        ("merge", merge, "merge", "cutting_in_from_right"),
        ("vut_turn", vut_turn, "crossing", "crossing_from_right"),
        ("roundabout", roundabout, "crossing", "crossing_from_left"),
    ],
)
def test_an_event_is_what_its_specification_says(
    event: str, made: Callable[[], Scene], relation: str, motion: str
) -> None:
    found = measure(made())
    assert codes(event, found) == []
    assert words(found, CONFLICT, "paths") == (relation,)
    assert words(found, MOTION, "motion") == (motion,)
    assert words(found, ORDER, "order") == ("ot1 before vut",)
    assert (found.initiator, found.affected) == ("ot1", "vut")
    read = load_event(event)[0]
    mine, wanted = fixed(read, found.properties), fixed(read, expected_properties(read))
    assert all(is_equal(mine[field], wanted[field]) for field in FIELDS)


BRAKES = "ot1 drives 3.0 to 5.4 m/s"


@pytest.mark.parametrize(
    ("made", "fastest_mps", "said"),
    [
        pytest.param(slow_lead, 4.0, [], id="as K* has it"),
        pytest.param(lambda: slow_lead(offset_m=-0.6), 4.0, [], id="noise beside its range"),
        pytest.param(lambda: slow_lead(offset_m=0.35), 4.0, ["ot1 is +0.35"], id="wrong side"),
        pytest.param(
            lambda: slow_lead(offset_m=0.9), 4.0, ["ot1 is +0.90"], id="far on the wrong side"
        ),
        pytest.param(lambda: slow_lead(offset_m=-0.9), 4.0, ["ot1 is -0.90"], id="too far aside"),
        pytest.param(lambda: slow_lead(speed=2.0), 4.0, ["ot1 drives 2.0"] * 2, id="too slow"),
        pytest.param(braking_lead, 12.0, [BRAKES], id="it brakes within its range of speeds"),
    ],
)
def test_speed_and_offset_of_one_that_does_nothing_are_held_against_k_star(
    made: Callable[[], Scene], fastest_mps: float, said: list[str]
) -> None:
    value = load_event("slow_lead")[0].model_dump(mode="json", by_alias=True)
    for speed in value["constraints"]["speeds"]["ot1"].values():
        speed["max"] = fastest_mps
    found = measure(made())
    told = [one.entry for one in further_findings(Event.model_validate(value), found, TTC_ONLY)]
    assert [one["code"] for one in told] == ["off_spec"] * len(said)
    assert all(words in one["detail"] for words, one in zip(said, told, strict=True))


def test_a_lead_that_brakes_is_no_slow_one() -> None:
    event, found = load_event("slow_lead")[0], measure(braking_lead())
    assert codes("slow_lead", found) == []
    told = [one.detail for one in further_findings(event, found, TTC_ONLY)]
    assert any("in the trigger, K* has 3 to 4 m/s" in detail for detail in told)
    assert told[-1].startswith(BRAKES)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"leaves_to_m": 0.0}, "ot2 stays in the VUT's lane, K* has it leave to the left"),
        ({"leaves_to_m": -3.5}, "ot2 leaves the VUT's lane to the right, K* has left"),
        ({"leaves_s": 0.6}, "ot2 begins to leave when ot1 is 77."),
        ({"leaves_s": 5.0}, "ot2 begins to leave when ot1 is 29."),
        ({"leaves_s": -4.0}, "ot2 is beside the VUT's lane from the clip's first state"),
    ],
    ids=["as K* has it", "it stays", "wrong side", "too early", "too late", "before the clip"],
)
def test_where_the_occluder_leaves_is_held_against_k_star(
    changes: dict[str, float], said: str
) -> None:
    event = load_event("cut_out")[0]
    found = measure(cut_out(**changes))
    told = [one.entry for one in further_findings(event, found, TTC_ONLY)]
    assert [one["code"] for one in told] == ["off_spec"] * bool(said)
    assert all(said in one["detail"] for one in told)


@pytest.mark.parametrize("seed", range(4))
def test_noise_of_localisation_moves_the_gap_at_which_an_occluder_leaves_by_its_own_size(
    seed: int,
) -> None:
    """Two places 50 ms apart (20 Hz), each with 3 cm of noise, falsify a speed by 0.8 m/s."""
    made, drawn, sigma_m = cut_out(), random.Random(seed), 0.03
    noisy = [
        (
            t_s,
            {
                name: replace(
                    one,
                    x_m=one.x_m + drawn.gauss(0, sigma_m),
                    y_m=one.y_m + drawn.gauss(0, sigma_m),
                )
                for name, one in now.items()
            },
        )
        for t_s, now in made.series
    ]
    gaps = []
    for series in (made.series, noisy):
        leaving = measure(replace(made, series=series)).leaving
        assert leaving is not None
        gaps.append(leaving.gap_m)
    assert gaps[1] == pytest.approx(gaps[0], abs=0.2)


@pytest.mark.parametrize("leaves", [True, False])
def test_a_vehicle_that_does_not_leave_keeps_the_standing_one_off_camera(leaves: bool) -> None:
    made = cut_out(leaves_to_m=3.5 if leaves else 0.0)
    span = measure(made).phases.critical_s
    assert span is not None
    optics = Optics(Intrinsics(960, 540, 480.0, 480.0, 480.0, 270.0), Mounting(1.5, 1.4, 0.0))
    moments = [Moment(t_s, states) for t_s, states in made.series]
    seen = object_sight(moments, span, STEP_S, optics, "vut", "ot1").fraction
    needed = load_event("cut_out")[0].constraints.camera.visible_fraction.min
    assert seen is not None
    assert needed is not None
    assert (seen >= needed) == leaves


def test_an_oncoming_turn_may_be_recorded_up_to_its_resolution() -> None:
    """It is turning across the corridor still; the resolution is at 7.7 s."""
    assert codes("oncoming_turn", measure(oncoming_turn(length_s=8.5))) == []


def test_phases_and_facts_of_a_cut_in() -> None:
    found = measure(cut_in())
    phases = found.phases
    # 3.5 m in 2.5 s: lateral speed 2.2 m/s · sin(π (t − 5)/2.5) passes 0.2 m/s at 5.07 s.
    assert phases.trigger_s == pytest.approx(5.07, abs=STEP_S)
    assert phases.trigger_s is not None
    assert phases.conflict_s is not None
    assert phases.resolution_s is not None
    assert phases.trigger_s < phases.conflict_s < phases.resolution_s
    # The gap at the trigger: 42 − 0.9 + 8.5 · 5.1 − (13 · 5.1 + 3.6).
    assert found.facts["trigger_gap_m"] == pytest.approx(37.5 - 4.5 * 5.1, abs=0.5)
    assert found.facts["vut_speed_at_trigger_mps"] == pytest.approx(13.0, abs=0.01)
    assert found.facts["ot_speed_at_conflict_mps"] == pytest.approx(8.6, abs=0.3)


def test_time_gap_of_a_crossing_is_from_departure_to_arrival() -> None:
    found = measure(crossing())
    # The walker's far edge leaves the corridor (1.2 m) at y = 1.45 m: 4 + 5.45/1.5 s.
    left_s = 4.0 + 5.45 / 1.5
    assert found.zone_until_s is not None
    assert found.facts["time_gap_s"] == pytest.approx(found.zone_until_s - left_s, abs=0.1)
    # The conflict point: 0.3 m before the walker's near edge. Of the VUT, 3.6 m of which are ahead
    # of its reference: 79.45 = 63.6 + 12 t - 2 t² from 5 s on.
    assert found.zone is not None
    assert min(x for x, _ in found.zone) == pytest.approx(79.45, abs=0.01)
    assert max(x for x, _ in found.zone) == pytest.approx(80.55, abs=0.01)
    assert {round(abs(y), 6) for _, y in found.zone} == {1.2}
    assert found.zone_until_s == pytest.approx(5.0 + (12.0 - math.sqrt(17.2)) / 4.0, abs=0.005)


@pytest.mark.parametrize("slant", [-0.5, 0.5])
def test_the_zone_of_a_slanting_crossing_is_what_both_corridors_share(slant: float) -> None:
    """The walker crosses from the right through x = 80 m with dx/dy = 0.5 or -0.5."""

    def walker(t: float) -> tuple[float, float]:
        y = -4.0 + 1.3 * max(0.0, t - 4.0)
        return 80.0 + slant * y, y

    vut = braking(0.0, 12.0, 5.0, 4.0, 1.5)
    found = measure(scene(vut, walker, ObjectClass.PEDESTRIAN, thresholds=BOTH))
    assert words(found, CONFLICT, "paths") == ("crossing",)
    # Half of the VUT's corridor is 1.2 m; the walker's, 0.55 m, lies slanting on the path.
    reach = 1.2 * 0.5 + 0.55 * math.hypot(1.0, 0.5)
    assert found.zone is not None
    assert min(x for x, _ in found.zone) == pytest.approx(80.0 - reach, abs=0.01)
    assert max(x for x, _ in found.zone) == pytest.approx(80.0 + reach, abs=0.01)


def test_the_zone_of_a_merge_has_no_margin_along_the_path() -> None:
    """METHOD 1: the part of the VUT's lane that the OT enters, from its first overlap."""
    whole = cut_in()
    found = measure(whole)
    half = DEFAULT_SIZES[ObjectClass.CAR].width_m / 2.0 + 0.3
    others = [states["ot1"] for _, states in whole.series]
    entered = next(o for o in others if min(y for _, y in o.box.corners()) < half)
    assert found.zone is not None
    assert min(x for x, _ in found.zone) == pytest.approx(
        min(x for x, _ in entered.box.corners()), abs=1e-6
    )


def test_vut_first() -> None:
    found = measure(crossing(start_s=5.29, vut=lambda t: (12.0 * t, 0.0)))
    assert words(found, ORDER, "order") == ("vut before ot1",)
    assert found.phases.conflict_s is not None
    assert codes("vru_crossing", found) == ["order_differs"]
    # The rear (0.9 m behind the reference) leaves the zone, which ends 0.3 m beyond the walker, at
    # 6.79 s. The walker reaches the corridor at 5.29 + 2.55/1.5 = 6.99 s, and is in it at 7 s.
    assert found.facts["time_gap_s"] == pytest.approx(7.0 - (80.55 + 0.9) / 12.0, abs=0.005)


def test_a_vut_that_had_passed_when_the_recording_begins_has_no_time_gap() -> None:
    found = measure(crossing(vut=lambda t: (90.0 + 12.0 * t, 0.0)))
    assert words(found, ORDER, "order") == ("vut before ot1",)
    assert found.facts["time_gap_s"] is None


def test_from_the_wrong_side() -> None:
    right = [Lane(y_m=y, width_m=3.5, direction="forward") for y in (-3.5, 0.0)]
    right.append(Lane(y_m=3.5, width_m=3.5, direction="backward"))
    found = measure(cut_in(side=-1.0, road=road(lanes=right)))
    assert words(found, TOPOLOGY, "vut_lane") == ("leftmost",)
    assert words(found, ROLES, "ot1 starts in") == ("right_lane",)
    assert codes("cut_in", found) == ["wrong_side"]


def test_who_cuts_in_on_whom() -> None:
    """The VUT changes lanes in front of the OT: nothing but the roles is turned round."""
    turned = scene(
        lambda t: (42.0 + 8.5 * t, shift(t, 5.0, 3.5, 0.0)), braking(0.0, 13.0, 6.0, 3.0, 6.0)
    )
    found = measure(turned)
    assert (found.initiator, found.affected) == ("vut", "ot1")
    assert codes("cut_in", found) == ["roles_swapped"]


def test_a_crossing_is_never_turned_round() -> None:
    found = measure(crossing(start_s=9.5, vut=lambda t: (12.0 * t, 0.0)))
    assert found.affected in ("vut", None)
    assert "roles_swapped" not in codes("vru_crossing", found)


@pytest.mark.parametrize(("speed", "gap_m"), [(13.0, 30.0), (12.5, 30.0)])
def test_without_a_conflict(speed: float, gap_m: float) -> None:
    found = measure(cut_in(speed=speed, gap_m=gap_m))
    assert found.phases.trigger_s is not None
    assert (found.phases.conflict_s, found.phases.resolution_s) == (None, None)
    assert codes("cut_in", found)[0] == "conflict_missing"
    assert found.initiator == "ot1"


def test_without_a_manoeuvre() -> None:
    found = measure(scene(lambda t: (13.0 * t, 0.0), lambda t: (40.0 + 13.0 * t, 3.5)))
    assert found.phases.trigger_s is None
    assert codes("cut_in", found) == ["no_manoeuvre"]
    assert found.properties[MOTION].words is None
    assert words(found, CONFLICT, "paths") == ("none",)


def test_a_clip_that_begins_in_the_manoeuvre_has_no_approach() -> None:
    whole = cut_in()
    late = replace(whole, series=[x for x in whole.series if x[0] >= 5.3], start_s=5.3)
    assert not measure(late).phases.has_approach
    assert codes("cut_in", measure(late)) == ["approach_phase"]


def test_a_conflict_that_never_ends() -> None:
    whole = cut_in()
    early = replace(whole, series=[x for x in whole.series if x[0] <= 6.6], end_s=6.6)
    assert measure(early).phases.conflict_s is not None
    assert codes("cut_in", measure(early)) == ["conflict_unresolved"]


def test_a_one_way_road_does_not_agree_with_two_lanes_each_way() -> None:
    """The oncoming lanes of the shipped cut-in vary, but not down to none (METHOD 4.2)."""
    event = load_event("cut_in")[0]
    one_way = [Lane(y_m=y, width_m=3.5, direction="forward") for y in (0.0, 3.5)]
    found = measure(cut_in(road=road(lanes=one_way))).properties[TOPOLOGY]
    assert outside_ranges(event, found) == ["lanes_opposite 0, K* has 1 to 2"]
    assert outside_ranges(event, measure(cut_in()).properties[TOPOLOGY]) == []


def test_another_road_and_another_class() -> None:
    narrow = [
        Lane(y_m=y, width_m=3.5, direction=d) for y, d in ((0.0, "forward"), (3.5, "backward"))
    ]
    found = measure(cut_in(road=road(lanes=narrow)))
    assert codes("cut_in", found)[0] == "topology_differs"
    assert words(found, ROLES, "ot1 starts in") == ("oncoming_lane",)
    walker = crossing()
    series = [
        (
            t,
            {
                k: replace(s, object_class=ObjectClass.CYCLIST) if k == "ot1" else s
                for k, s in now.items()
            },
        )
        for t, now in walker.series
    ]
    assert codes("vru_crossing", measure(replace(walker, series=series))) == ["roles_differ"]


@settings(max_examples=8, deadline=None)
@given(
    x=st.floats(-1e3, 1e3),
    y=st.floats(-1e3, 1e3),
    yaw=st.floats(-3.1, 3.1),
    which=st.sampled_from([cut_in, crossing, lead]),
)
def test_nothing_depends_on_where_the_site_lies(
    x: float, y: float, yaw: float, which: Callable[[], Scene]
) -> None:
    before, by = which(), Pose2(x, y, yaw)

    def moved(s: ObjectState) -> ObjectState:
        px, py = by.to_parent(s.x_m, s.y_m)
        return replace(s, x_m=px, y_m=py, yaw_rad=wrap_angle(s.yaw_rad + yaw))

    series = [(t, {k: moved(s) for k, s in now.items()}) for t, now in before.series]
    after = replace(before, series=series, road=road(by))
    ours, theirs = measure(before), measure(after)
    for field in FIELDS:
        assert theirs.properties[field].words == ours.properties[field].words
    for name in ("trigger_s", "conflict_s", "resolution_s"):
        here, there = getattr(ours.phases, name), getattr(theirs.phases, name)
        assert there == pytest.approx(here, abs=1.5 * STEP_S)


# -- the road --------------------------------------------------------------------------------------


def at(x_m: float, y_m: float, yaw_rad: float = 0.0) -> ObjectState:
    size = replace(DEFAULT_SIZES[ObjectClass.CAR], front_m=2.25, rear_m=2.25)
    return ObjectState("vut", ObjectClass.CAR, Role.VUT, 0, x_m, y_m, yaw_rad, 10.0, 0.0, 0.0, size)


@pytest.mark.parametrize(
    ("y_m", "lane", "place"),
    [
        (0.4, ("rightmost",), "vut_lane"),
        (3.0, ("leftmost",), "left_lane"),
        (7.0, ("oncoming",), "oncoming_lane"),
        (-2.5, ("off the road",), "right_kerb"),
        (9.5, ("off the road",), "left_kerb"),
    ],
)
def test_lanes_and_places(y_m: float, lane: tuple[str, ...], place: str) -> None:
    lanes = Lanes.of(road().road, [at(10.0, 0.0)])
    spot = lanes.spot(at(50.0, y_m))
    assert spot is not None
    assert lanes.lane_words(spot.lane) == lane
    assert lanes.place_word(spot, 0) == place


def test_left_and_right_are_the_vuts() -> None:
    """Driving against the line: what lies at smaller offsets is to the left."""
    lanes = Lanes.of(road().road, [at(50.0, 7.0, math.pi)])
    assert (lanes.same_direction, lanes.opposite) == (1, 2)
    own, other = lanes.spot(at(50.0, 7.0)), lanes.spot(at(60.0, 3.5))
    assert own is not None
    assert other is not None
    assert lanes.lane_words(own.lane) == ("rightmost", "leftmost")
    assert lanes.place_word(other, own.lane) == "oncoming_lane"
    beyond = lanes.spot(at(60.0, 10.0))
    assert beyond is not None
    assert lanes.place_word(beyond, own.lane) == "right_kerb"


def test_three_lanes_have_a_middle_and_lanes_apart() -> None:
    three = [Lane(y_m=3.5 * k, width_m=3.5, direction="forward") for k in range(3)]
    lanes = Lanes.of(road(lanes=three).road, [at(10.0, 0.0)])
    assert [lanes.lane_words(k) for k in range(3)] == [("rightmost",), ("middle",), ("leftmost",)]
    spot = lanes.spot(at(10.0, 7.0))
    assert spot is not None
    assert lanes.place_word(spot, 0) == "2_lanes_left"


def test_a_bend_is_a_curve_where_it_is_driven_on() -> None:
    pieces = [
        CurvePiece(length_m=100.0),
        CurvePiece(length_m=50.0, end_curvature_1pm=0.01),
        CurvePiece(length_m=100.0, start_curvature_1pm=0.01, end_curvature_1pm=0.01),
    ]
    lanes = Lanes(road(pieces=pieces, length_m=250.0).road)
    assert lanes.segment(0.0, 90.0, None) == "straight"
    assert lanes.segment(80.0, 160.0, None) == "curve"
    assert lanes.segment(240.0, 130.0, None) == "curve"


def test_what_cannot_be_measured() -> None:
    empty = cut_in()
    with pytest.raises(ValueError, match="no states of vut"):
        measure(replace(empty, series=[]))
    with pytest.raises(ValueError, match="none of ot9"):
        measure(replace(empty, target_ids=("ot9",)))
