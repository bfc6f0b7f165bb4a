"""METHOD 2.2: scores, the reasons that exclude a block, ties."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.files.reading import load_model
from ssp_core.geometry import Pose2
from ssp_core.run_file.road import CurvePiece
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.retrieval import score_block, score_blocks, ties
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import (
    Block,
    BlockLane,
    Conflict,
    ConflictArea,
    Library,
    Passage,
)
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import with_routes
from ssp_scenario_manager.maps.site import find_shipped, load_site, site_library
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from tests.support.events.blocks import block_of
from tests.support.events.places import site_of

Made = Any
Words = Any

EVENTS = tuple(sorted(KINDS))


# Figures that the tests count on, whatever the shipped events say today.
BOUNDARIES = ["kerb", "sidewalk", "shoulder", "verge"]


def fixed(value: Any) -> dict[str, Any]:
    return {"value": value, "identity": True}


def varying(varies: Any, value: Any = "unresolved") -> dict[str, Any]:
    return {"value": value, "varies": varies, "why": "the tests count on it"}


TOPOLOGY = {
    "road_type": varying(["urban", "rural", "motorway", "proving_ground"]),
    "segment": fixed("straight"),
    "lanes_opposite": varying({"min": 0, "max": 4}),
    "vut_lane": fixed("rightmost"),
    "left_boundary": varying(BOUNDARIES),
    "right_boundary": varying(BOUNDARIES),
    "lane_width": varying({"min": 3.0, "max": 4.2, "unit": "m"}),
    "curvature": varying({"min": 0.0, "max": 0.005, "unit": "1/m"}),
}
LENGTH_M = {"cut_in": 250.0, "lead_braking": 250.0}
APPROACH_MPS = {"cut_in": (12.0, 14.0), "lead_braking": (12.0, 14.0)}


def metres(low: float) -> dict[str, Any]:
    return {"min": low, "max": None, "unit": "m"}


@lru_cache
def shipped(name: str) -> Event:
    value = load_model(Event, find_shipped(name, "event")).model_dump(by_alias=True)
    value["topology"] |= TOPOLOGY
    if KINDS[name].at_junction:
        value["topology"]["segment"] = fixed("junction")
    lanes_least = 2 if name == "cut_in" else 1
    value["topology"]["lanes_same_direction"] = varying({"min": lanes_least, "max": 4})
    value["constraints"]["site"] = {
        "length": metres(LENGTH_M.get(name, 120.0)),
        "lateral_clearance": metres(1.5 if "crossing" in name else 1.0),
    }
    low, high = APPROACH_MPS.get(name, (9.0, 11.0))
    vut = value["constraints"]["speeds"]["vut"]
    vut["approach"] = {"min": low, "max": high, "unit": "m/s"}
    return Event.model_validate(value)


def shipped_whole(name: str) -> Event:
    """A shipped event; where roads cross, as it is, since these sites leave no choice."""
    return (
        load_model(Event, find_shipped(name, "event")) if KINDS[name].at_junction else event(name)
    )


def event(name: str, **parts: dict[str, Any]) -> Event:
    """A shipped event, with fields of its parts changed."""
    value = shipped(name).model_dump(by_alias=True)
    for part, fields in parts.items():
        value[part] |= fields
    return Event.model_validate(value)


def straight(length_m: float = 300.0, curvature_1pm: float = 0.0) -> ReferenceLine:
    arc = CurvePiece(
        length_m=length_m, start_curvature_1pm=curvature_1pm, end_curvature_1pm=curvature_1pm
    )
    return ReferenceLine(Pose2(0.0, 0.0, 0.0), [arc])


def made_block(block_id: str = "b", **changes: Any) -> Block:
    """A block that suits every shipped event."""
    whole = [ConflictArea(kind, 0.0, 300.0) for kind in ("crossing", "following", "merge")]
    good: dict[str, Any] = {
        "line": straight(),
        "sidewalk_left_m": 2.0,
        "sidewalk_right_m": 2.0,
        "permitted": block_of().permitted | {"stop"},
        "conflict_areas": tuple(whole),
        "speed_limit_mps": 20.0,
    }
    return replace(block_of(block_id=block_id), **{**good, **changes})


def library(*blocks: Block) -> Library:
    return Library("made", "sha256:0", "opendrive", blocks)


def lanes(forward: int, backward: int, width_m: float = 3.5) -> tuple[BlockLane, ...]:
    return tuple(
        BlockLane(width_m * i, width_m, i < forward, str(i)) for i in range(forward + backward)
    )


# -- scores ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EVENTS)
def test_a_block_that_suits_scores_one(name: str) -> None:
    block = made_block()
    if KINDS[name].at_junction:
        side = -1.0 if name == "roundabout" else 1.0
        angle = side * math.pi / 2
        crossed = Conflict("other", KINDS[name].relation, 150.0, 80.0, angle, 146.0, 154.0)
        turns = KINDS[name].turns_left or "turn_left" in KINDS[name].vut_intents
        turn_rad = math.pi / 2 if turns else 0.0
        passage = Passage(("inside",), 140.0, 160.0, turn_rad, (crossed,))
        block = replace(block, segment="junction", junction="j", passage=passage)
    (score,) = score_blocks(event(name), library(block))
    assert (score.topology, score.interaction, score.constraints) == (1.0, 1.0, 1.0)
    assert score.total == pytest.approx(1.0)
    assert score.eligible
    assert score.reasons == []


@pytest.mark.parametrize(
    ("turn_deg", "reasons"),
    [
        (90, []),
        (-90, ["it turns by -90 deg, needs turn_left"]),
        (0, ["it turns by 0 deg, needs turn_left"]),
    ],
)
def test_a_route_turns_as_the_vut_means_to(turn_deg: int, reasons: list[str]) -> None:
    crossed = Conflict("other", "crossing", 150.0, 80.0, math.pi, 146.0, 154.0)
    passage = Passage(("inside",), 140.0, 160.0, math.radians(turn_deg), (crossed,))
    block = replace(made_block(), segment="junction", junction="j", passage=passage)
    (score,) = score_blocks(event("vut_turn"), library(block))
    assert score.reasons == reasons
    assert (score.total == pytest.approx(1.0)) == (not reasons)


@pytest.mark.parametrize(
    ("name", "site"),
    [
        (name, site)
        for name in EVENTS
        for site in (
            (site_of(name), site_of(name, "physical"))
            if KINDS[name].at_junction
            else ("boulevard", "north_track", "south_loop")
        )
    ],
)
def test_shipped_events_fit_shipped_sites(name: str, site: str) -> None:
    scores = score_blocks(shipped_whole(name), with_routes(site_library(load_site(site)[0])))
    assert len(ties(scores)) == 1
    assert scores[0].eligible


def test_the_total_is_the_weighted_sum_of_means() -> None:
    block = made_block(
        road_type="rural",
        left_boundary="verge",
        speed_limit_mps=None,
        sidewalk_right_m=0.5,
        sidewalk_left_m=0.5,
    )
    wanted = event(
        "cut_in",
        topology={
            "road_type": varying(["urban"]),
            "left_boundary": varying(["sidewalk"]),
            "right_boundary": varying(["kerb"]),
        },
    )
    score = score_block(wanted, block, KINDS["cut_in"])
    # Seven needs of T, of which two aren't met; five of C: the limit is unknown, half the room.
    assert score.topology == pytest.approx(5 / 7)
    assert score.interaction == 1.0
    assert score.constraints == pytest.approx((1 + 0.5 + 1 + 1 + 0.5) / 5)
    assert score.total == pytest.approx((score.topology + 1.0 + score.constraints) / 3)
    assert score.eligible


@pytest.mark.parametrize(
    ("wanted", "found", "share"),
    [
        (BOUNDARIES, "verge", 1.0),
        (BOUNDARIES, "any", 1.0),
        (None, "verge", 1.0),
        (["kerb"], "sidewalk", 1.0),
        (["sidewalk"], "kerb", 0.5),
        (["kerb"], "any", 0.5),
        (["kerb"], "verge", 0.0),
    ],
)
def test_boundaries(wanted: list[str] | None, found: str, share: float) -> None:
    score = score_block(
        event("cut_in", topology={"right_boundary": varying(wanted)}),
        made_block(right_boundary=found),
        KINDS["cut_in"],
    )
    assert score.topology == pytest.approx((6 + share) / 7)


@pytest.mark.parametrize(
    ("limit", "share"), [(11.9, None), (12.0, 0.0), (13.0, 0.5), (14.0, 1.0), (None, 0.5)]
)
def test_the_speed_limit_leaves_a_part_of_the_approach_speeds(
    limit: float | None, share: float | None
) -> None:
    score = score_block(event("cut_in"), made_block(speed_limit_mps=limit), KINDS["cut_in"])
    if share is None:
        assert score.reasons == ["speed limit 11.9 m/s, needs at least 12 m/s"]
    else:
        assert score.reasons == []
        assert score.constraints == pytest.approx((4 + share) / 5)


# -- reasons --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "changes", "reason"),
    [
        ("cut_in", {"segment": "curve"}, "segment curve, needs straight"),
        ("cut_in", {"lanes": lanes(1, 2)}, "same-direction lanes 1, needs at least 2"),
        (
            "cut_in",
            {"lanes": lanes(1, 1)},
            "one driving lane per direction: same-direction lanes 1, needs at least 2",
        ),
        ("cut_in", {"lanes": lanes(5, 0)}, "same-direction lanes 5, needs at most 4"),
        ("vru_crossing", {"lanes": lanes(1, 5)}, "oncoming lanes 5, needs at most 4"),
        ("cut_in", {"conflict_areas": ()}, "no conflict area for the relation merge"),
        ("vru_crossing", {"conflict_areas": ()}, "no conflict area for the relation crossing"),
        (
            "cut_in",
            {"permitted": frozenset({"keep_lane", "lane_change_left"})},
            "not permitted: lane_change_right",
        ),
        ("cut_in", {"line": straight(249.0)}, "length 249.0 m, needs at least 250 m"),
        ("cut_in", {"lanes": lanes(2, 2, 2.8)}, "lane widths 2.80, 2.80 m from right to left"),
        ("cut_in", {"lanes": lanes(2, 2, 4.5)}, "needs 3 to 4.2 m"),
        ("cut_in", {"line": straight(300.0, 0.006)}, "curvature 0.0060 1/m, needs at most 0.005"),
        (
            "vru_crossing",
            {"sidewalk_right_m": 1.0},
            "clearance on the right 1.0 m, needs at least 1.5 m",
        ),
        (
            "vru_crossing",
            {"sidewalk_left_m": 0.0, "shoulder_left_m": 1.2},
            "clearance on the left 1.2 m, needs at least 1.5 m",
        ),
    ],
)
def test_what_is_missing_is_named_with_numbers(
    name: str, changes: dict[str, Any], reason: str
) -> None:
    (score,) = score_blocks(event(name), library(made_block(**changes)))
    assert not score.eligible
    assert any(reason in found for found in score.reasons), score.reasons
    assert score.total < 1.0


def test_the_number_of_lanes_is_the_first_reason() -> None:
    poor = made_block(lanes=lanes(1, 1), segment="curve", line=straight(20.0), speed_limit_mps=1.0)
    (score,) = score_blocks(event("cut_in"), library(poor))
    assert score.reasons[0].startswith("one driving lane per direction")
    assert len(score.reasons) >= 4


def test_places_that_a_block_hasnt() -> None:
    base = event("lead_braking")
    ot = base.participants["ot1"].model_dump(by_alias=True)
    ot["region"] |= {"place": "oncoming_lane"}
    vut = base.participants["vut"].model_dump(by_alias=True)
    wanted = event("lead_braking", participants={"vut": vut, "ot1": ot})
    assert score_block(wanted, made_block(), KINDS["lead_braking"]).eligible
    score = score_block(wanted, made_block(lanes=lanes(2, 0)), KINDS["lead_braking"])
    assert score.reasons == ["ot1 needs an oncoming lane"]
    ot["region"] |= {"place": "right_lane"}
    wanted = event("lead_braking", participants={"vut": vut, "ot1": ot})
    score = score_block(wanted, made_block(), KINDS["lead_braking"])
    assert score.reasons == ["ot1 needs a lane to the right of the VUT's"]


def test_a_lane_in_the_middle_takes_three() -> None:
    wanted = event("lead_braking", topology={"vut_lane": fixed("middle")})
    score = score_block(wanted, made_block(), KINDS["lead_braking"])
    assert score.reasons == ["same-direction lanes 2, none of them is the middle (identity)"]
    assert score_block(wanted, made_block(lanes=lanes(3, 1)), KINDS["lead_braking"]).eligible


def test_open_and_unresolved_needs_are_met() -> None:
    wanted = event(
        "cut_in",
        topology={
            "segment": fixed("unresolved"),
            "lane_width": varying(None),
            "curvature": varying(None),
            "vut_lane": fixed("unresolved"),
        },
    )
    block = made_block(lanes=lanes(2, 1, 9.0), line=straight(300.0, 0.01), segment="curve")
    assert score_block(wanted, block, KINDS["cut_in"]).eligible


def test_units_of_the_event_are_converted() -> None:
    wanted = event(
        "cut_in", topology={"lane_width": varying({"min": 3.0, "max": 4.2, "unit": "m"})}
    )
    speeds = wanted.constraints.model_dump(by_alias=True)
    speeds["speeds"]["vut"]["approach"] = {"min": 43.2, "max": 50.4, "unit": "km/h"}
    slow = Event.model_validate(wanted.model_dump(by_alias=True) | {"constraints": speeds})
    score = score_block(slow, made_block(speed_limit_mps=13.0), KINDS["cut_in"])
    assert score.constraints == pytest.approx(4.5 / 5)


# -- identity -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("topology", "block", "reason"),
    [
        (
            {"lanes_opposite": fixed(2)},
            {"lanes": lanes(2, 0)},
            "oncoming lanes 0, needs 2 (identity)",
        ),
        (
            {"lanes_same_direction": fixed(2)},
            {"lanes": lanes(3, 2)},
            "same-direction lanes 3, needs 2 (identity)",
        ),
        ({}, {"segment": "curve"}, "segment curve, needs straight (identity)"),
        (
            {"road_type": fixed("urban")},
            {"road_type": "rural"},
            "road_type rural, needs urban (identity)",
        ),
        (
            {"road_type": fixed("urban")},
            {"road_type": "any"},
            "road_type unknown to the map, needs urban (identity)",
        ),
        (
            {"left_boundary": fixed("kerb")},
            {"left_boundary": "sidewalk"},
            "left_boundary sidewalk, needs kerb (identity)",
        ),
        (
            {"lane_width": fixed({"min": 3.4, "max": 3.4, "unit": "m"})},
            {},
            "lane_width 3.5, needs 3.4 m (identity)",
        ),
        (
            {"curvature": fixed({"min": 0, "max": 0.001, "unit": "1/m"})},
            {"line": straight(300.0, 0.004)},
            "curvature 0.004, needs 0 to 0.001 1/m (identity)",
        ),
        (
            {"permitted_manoeuvres": fixed(["keep_lane", "lane_change_right"])},
            {},
            "permitted_manoeuvres crossing, keep_lane, lane_change_left, lane_change_right, stop, "
            "needs keep_lane, lane_change_right (identity)",
        ),
    ],
)
def test_a_block_that_differs_in_an_identity_field_is_no_candidate(
    topology: dict[str, Any], block: dict[str, Any], reason: str
) -> None:
    score = score_block(event("cut_in", topology=topology), made_block(**block), KINDS["cut_in"])
    assert not score.eligible
    assert reason in score.reasons


def test_a_one_way_lane_and_two_lanes_each_way_are_not_the_same_road() -> None:
    event = load_model(Event, find_shipped("lead_braking", "event"))
    scores = score_blocks(
        event,
        library(made_block("two and two"), made_block("one way", lanes=lanes(1, 0))),
    )
    assert [(score.block, score.eligible) for score in scores] == [
        ("two and two", True),
        ("one way", False),
    ]
    assert scores[1].reasons[0] == (
        "one driving lane per direction: same-direction lanes 1, needs 2 (identity)"
    )
    assert not event.topology.lanes_opposite.admits(0)


# -- ties and order -------------------------------------------------------------------------------


def test_equal_blocks_tie_and_a_better_one_wins() -> None:
    scores = score_blocks(
        event("cut_in"),
        library(
            made_block("c"),
            made_block("a"),
            made_block("worse", speed_limit_mps=None),
            made_block("no", segment="curve"),
        ),
    )
    assert [score.block for score in scores] == ["a", "c", "worse", "no"]
    assert [score.block for score in ties(scores)] == ["a", "c"]
    assert [s.block for s in ties(scores[1:])] == ["c"]
    assert ties([]) == []
    assert ties(scores[-1:]) == []


@settings(max_examples=100, deadline=None)
@given(
    forward=st.integers(0, 6),
    backward=st.integers(0, 6),
    width=st.floats(2.0, 6.0),
    length=st.floats(1.0, 500.0),
    bend=st.floats(-0.02, 0.02),
    room=st.floats(0.0, 3.0),
    limit=st.none() | st.floats(0.1, 40.0),
    kinds=st.sets(st.sampled_from(["merge", "crossing", "following"])),
    words=st.sets(st.sampled_from(sorted(made_block().permitted))),
    name=st.sampled_from(EVENTS),
)
def test_scores_are_shares_and_eligible_means_without_reason(
    forward: int,
    backward: int,
    width: float,
    length: float,
    bend: float,
    room: float,
    limit: float | None,
    kinds: set[Any],
    words: set[str],
    name: str,
) -> None:
    if forward + backward == 0:
        forward = 1
    block = made_block(
        lanes=lanes(forward, backward, width),
        line=straight(length, bend),
        sidewalk_right_m=room,
        speed_limit_mps=limit,
        conflict_areas=tuple(ConflictArea(kind, 0.0, 1.0) for kind in sorted(kinds)),
        permitted=frozenset(words),
    )
    (score,) = score_blocks(event(name), library(block))
    for value in (score.topology, score.interaction, score.constraints, score.total):
        assert 0.0 <= value <= 1.0
    assert score.eligible == (score.reasons == [])
    # The same facts give the same score, whoever stands beside.
    again = score_blocks(event(name), library(made_block("other"), block))
    assert next(s for s in again if s.block == "b") == score


# -- maps -----------------------------------------------------------------------------------------


def town(made: Made, words: Words, sections: str) -> Library:
    """Straights of 60, 140 and 300 m that lie apart, with sidewalks and 25 mph."""
    for i, length in enumerate((60.0, 140.0, 300.0)):
        made.road(
            str(i),
            length,
            geometry=words.at(0, 100.0 * i, 0, length),
            sections=sections,
            head='<type s="0" type="town"><speed max="31" unit="mph"/></type>',
        )
    found: Library = load_library(made.write())
    return found


def test_a_town_of_one_lane_per_direction(made: Made, words: Words) -> None:
    walk = words.section(
        words.lane(2, 2.5, "sidewalk") + words.lane(1, 4.0),
        words.lane(-1, 4.0) + words.lane(-2, 2.5, "sidewalk"),
    )
    found = town(made, words, walk)
    crossing = score_blocks(event("vru_crossing"), found)
    assert [s.block for s in ties(crossing)] == [
        "road 1 backward",
        "road 1 forward",
        "road 2 backward",
        "road 2 forward",
    ]
    for score in score_blocks(event("cut_in"), found):
        assert not score.eligible
        assert score.reasons[0] == (
            "one driving lane per direction: same-direction lanes 1, needs at least 2"
        )


def test_a_town_of_two_lanes_per_direction(made: Made, words: Words) -> None:
    scores = score_blocks(event("cut_in"), town(made, words, words.four_lanes))
    assert [s.block for s in ties(scores)] == ["road 2 backward", "road 2 forward"]
    # Without a sidewalk nobody can wait at the kerb.
    made.parts.clear()
    none = score_blocks(event("vru_crossing"), town(made, words, words.four_lanes))
    assert ties(none) == []
    assert "clearance on the right 0.0 m" in none[0].reasons[-1]
