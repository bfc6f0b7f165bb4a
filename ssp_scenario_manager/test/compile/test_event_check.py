"""Compile means it runs (METHOD 2.2): one predicate for compiler and session."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from typing import Any, Literal

import pytest

from ssp_core import console
from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Polyline
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec, WantedPassing
from ssp_core.run_file.participants import FollowPath, TimeToArrival, TrafficSpec
from ssp_core.vocabulary import Phase, SessionPhase, Verdict
from ssp_core.world.plant import make_plant
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.choose import fitting_trigger
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.compile.place import Order, realise
from ssp_scenario_manager.compile.retrieval import score_blocks
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.site import LIBRARY
from ssp_scenario_manager.run import feasibility
from ssp_scenario_manager.run.feasibility import why_not
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process
from ssp_scenario_manager.run.in_process_session import InProcessSession
from ssp_scenario_manager.run.sweep import warn_of_late_conflict
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.session import outbox
from tests.support.events.junctions import ground
from tests.support.events.places import site_of
from tests.support.events.slow_leads import SPEEDS_MPS, slow_lead
from tests.support.simulated_once import run_once

Simulate = Callable[[RunSpec], tuple[InProcessResult, Record]]
SITES = ("boulevard", "north_track", "south_loop")
# Where roads cross: test_maps_crossing_car.py.
ON_OPEN_ROAD = sorted(name for name, kind in KINDS.items() if not kind.at_junction)
AT_JUNCTION = sorted(set(KINDS) - set(ON_OPEN_ROAD))
_OTHER_SIDE = {"left": "right", "right": "left"}


@cache
def shipped(name: str) -> dict[str, Any]:
    """A shipped event as a mapping; reading one takes a while."""
    event = load_event(name)[0]
    return event.model_dump(mode="json", by_alias=True, exclude={"uncertainty"})


def mirrored(value: Any) -> Any:
    """A K* with left and right exchanged in all that says where the OTs are and how they move."""
    if isinstance(value, dict):
        return {key: mirrored(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [mirrored(inner) for inner in value]
    if isinstance(value, str):
        return re.sub("left|right", lambda found: _OTHER_SIDE[found.group()], value)
    return value


def from_the_other_side(name: str) -> Event:
    """A shipped event whose OTs come from the other side.

    The road stays as it is; a VUT that is cut in on from the right, or whose leader leaves to the
    right, drives in the left lane.
    """
    value = dict(shipped(name))
    for part in ("participants", "motion", "interaction"):
        value[part] = mirrored(value[part])
    if name in ("cut_in", "cut_out"):
        value["topology"] = {
            **value["topology"],
            "vut_lane": {"value": "leftmost", "identity": True},
        }
    return Event.model_validate(value)


@cache
def ground_of(site: str) -> OperatingArea:
    return load_area(site, None)[0]


def compiled(event: Event, area: OperatingArea, block: int = 0) -> RunSpec:
    place = area.library.blocks[block]
    made = realise(Order(event, "sha256:test", area, "sumo", 1, {}), place)
    return made.task.run.model_copy(update={"camera": None})


@pytest.mark.parametrize("site", SITES)
def test_a_crossing_from_the_left_is_refused_where_the_vut_would_be_there_first(site: str) -> None:
    with pytest.raises(CannotPlace) as caught:
        compiled(from_the_other_side("vru_crossing"), ground_of(site))
    said = re.search(
        r"ot1 takes ([\d.]+) s to the VUT's corridor, the VUT at its approach speed ([\d.]+) s",
        str(caught.value),
    )
    assert said is not None, str(caught.value)
    assert float(said[1]) > float(said[2])


def test_a_trigger_that_alone_is_wrong_is_told_with_a_value_that_would_do() -> None:
    event, area = from_the_other_side("vru_crossing"), ground_of("south_loop")
    told = fitting_trigger(event, lambda other: compiled(other, area))
    assert told is not None
    said = re.search(r"trigger\.below of ([\d.]+) s would do, K\* has 3 to 3\.4", told)
    assert said is not None, told
    value = event.model_dump(mode="json", by_alias=True)
    below = {"min": float(said[1]), "max": float(said[1]), "unit": "s"}
    value["constraints"]["trigger"]["below"] = below
    run = compiled(Event.model_validate(value), area)
    assert run_in_process(run)[0].verdict is Verdict.VALID


def test_no_trigger_is_told_where_something_else_is_wrong() -> None:
    """A trigger early enough behind two oncoming lanes needs a start gap beyond K*'s."""
    event, area = from_the_other_side("vru_crossing"), ground_of("boulevard")
    assert fitting_trigger(event, lambda other: compiled(other, area)) is None


# -- the predicate on runs that were changed -------------------------------------------------------


@pytest.fixture(scope="module")
def crossing() -> RunSpec:
    """The shipped crossing on the boulevard."""
    return compiled(Event.model_validate(shipped("vru_crossing")), ground_of("boulevard"))


def with_trigger(run: RunSpec, **changes: Any) -> RunSpec:
    trigger = run.triggers[0].model_copy(update=changes)
    return run.model_copy(update={"triggers": [trigger]})


def test_what_happens_has_no_reason_against_it(crossing: RunSpec) -> None:
    assert why_not(crossing) == []


def test_surroundings_that_the_run_cannot_have_are_said(crossing: RunSpec) -> None:
    """SUMO inserts no vehicle that would have to brake harder than it can."""
    ahead = TrafficSpec(id="slow", object_class="car", lane=3, x_m=300.0, speed_mps=0.0)
    behind = TrafficSpec(id="fast", object_class="car", lane=3, x_m=306.0, speed_mps=13.0)
    (reason,) = why_not(crossing.model_copy(update={"traffic": [ahead, behind]}))
    assert "there is no room for this traffic at its start" in reason
    assert "fast" in reason
    assert reason.endswith("with the surroundings")


def test_a_trigger_that_never_fires_is_said(crossing: RunSpec) -> None:
    (reason,) = why_not(with_trigger(crossing, not_before_s=39.0))
    assert "trigger of ot1 doesn't fire" in reason


def test_an_object_that_stays_beside_the_corridor_is_no_event(
    crossing: RunSpec,
) -> None:
    """It walks towards the VUT's path, so that a conflict is predicted, and stops before it."""
    run = crossing
    path = run.triggers[0].manoeuvre.motion.path  # type: ignore[union-attr]
    motion = run.triggers[0].manoeuvre.motion.model_copy(  # type: ignore[union-attr]
        update={"path": [path[0], (path[0][0], path[0][1] + 0.9)]}
    )
    manoeuvre = run.triggers[0].manoeuvre.model_copy(update={"motion": motion})
    short = with_trigger(run, manoeuvre=manoeuvre, adaptation=None)
    result, _ = run_in_process(short)
    assert result.phase_s(Phase.CONFLICT) is not None
    # Whoever runs it all the same is told that nobody crossed: before, such a run was valid.
    near = short.limits.model_copy(update={"separation_m": 0.1})
    sound, _ = run_in_process(short.model_copy(update={"limits": near}))
    assert sound.verdict is Verdict.OFF_SPEC
    assert sound.reasons[0].startswith("passing order: ot1 never came into the VUT's corridor")
    (reason,) = why_not(short)
    assert "ot1 doesn't come into the VUT's corridor (smallest distance" in reason


def test_a_time_gap_outside_of_k_star_is_said_with_value_and_range(
    crossing: RunSpec,
) -> None:
    wanted = WantedPassing(first="initiator", least_gap_s=3.0, most_gap_s=4.0)
    (reason,) = why_not(crossing.model_copy(update={"passing": wanted}))
    assert re.search(r"time gap .*: 1\.\d\d\d s, K\* wants 3 to 4 s, with the SIL's driver", reason)


def test_a_conflict_too_long_after_its_trigger_is_said(crossing: RunSpec) -> None:
    """Slow walking from far beside the road: the run is valid, its trigger leads to nothing."""
    trigger, walker, x_m = crossing.triggers[0], crossing.targets[0], 230.0
    manoeuvre, condition = trigger.manoeuvre, trigger.condition
    assert isinstance(manoeuvre, FollowPath)
    assert isinstance(condition, TimeToArrival)
    far = walker.start.model_copy(update={"x_m": x_m, "y_m": walker.start.y_m - 3.5})
    path = [(x_m, far.y_m), (x_m, manoeuvre.motion.path[-1][1])]
    motion = manoeuvre.motion.model_copy(update={"path": path, "cruise_mps": 0.35})
    run = with_trigger(
        crossing,
        condition=condition.model_copy(update={"anchor": (x_m, 0.0), "below_s": 16.0}),
        manoeuvre=manoeuvre.model_copy(update={"motion": motion}),
        not_before_s=0.0,
        adaptation=None,
    ).model_copy(
        update={
            "targets": [walker.model_copy(update={"start": far})],
            "passing": None,
            "thresholds": crossing.thresholds.model_copy(update={"arrival_gap_s": None}),
        }
    )
    result, _ = run_in_process(run)
    assert result.verdict is Verdict.VALID
    (reason,) = why_not(run)
    said = re.match(r"the conflict begins ([\d.]+) s after the trigger; .* within 12 s", reason)
    assert said is not None, reason
    assert 12.0 < float(said[1]) < 16.0
    starts = [
        {"phase": phase.phase.name.lower(), "at_s": ns_to_seconds(phase.stamp_ns)}
        for phase in result.phases
    ]
    with console.out.capture() as shown:
        warn_of_late_conflict({"phases": starts})
    assert re.search(r"warning: the conflict begins 1[45]\.\d s after the trigger", shown.get())
    with console.out.capture() as shown:
        warn_of_late_conflict({"phases": starts[:2]})
    assert shown.get() == ""


def test_the_wrong_order_is_said(crossing: RunSpec) -> None:
    wanted = WantedPassing(first="vut", least_gap_s=0.0, most_gap_s=9.0)
    (reason,) = why_not(crossing.model_copy(update={"passing": wanted}))
    assert "ot1 reaches the conflict point first, against K*'s passing order" in reason


def test_a_refused_reference_is_said_as_the_session_says_it(
    crossing: RunSpec,
) -> None:
    limits = crossing.limits.model_copy(update={"speed_mps": 11.0, "acceleration_mps2": 1.0})
    (reason, *_) = why_not(crossing.model_copy(update={"limits": limits}))
    assert reason.startswith(("reference_refused: ot1", "over_acceleration"))


# -- every combination of event, side, object class and place --------------------------------------

MAPS = ("bend", "motorway", "wide_verge", "wide_shoulder", "left_hand")
_LANE = (
    '<lane id="{id}" type="{kind}"><width sOffset="0" a="{width}"/>'
    '<roadMark sOffset="0" type="broken"/></lane>'
)


def opendrive(lanes: int, beside: tuple[tuple[str, float], ...], rule: str = "RHT") -> bytes:
    """A map of one straight road of 600 m, the same to both sides.

    Args:
        lanes: per direction, 3.5 m wide.
        beside: types and widths in m of what lies beyond them, outwards.
        rule: RHT or LHT.
    """
    kinds = [("driving", 3.5)] * lanes + list(beside)
    numbered = list(enumerate(kinds, start=1))
    left = "".join(_LANE.format(id=i, kind=k, width=w) for i, (k, w) in reversed(numbered))
    right = "".join(_LANE.format(id=-i, kind=k, width=w) for i, (k, w) in numbered)
    return (
        '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="7"/>'
        f'<road id="1" length="600" junction="-1" rule="{rule}"><link/>'
        '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
        '<planView><geometry s="0" x="0" y="0" hdg="0.3" length="600"><line/></geometry>'
        f'</planView><lanes><laneSection s="0"><left>{left}</left><center><lane id="0" '
        f'type="none"/></center><right>{right}</right></laneSection></lanes></road></OpenDRIVE>'
    ).encode()


_WRITTEN = {
    # As esmini's maps have it: a shoulder, and then six metres of grass.
    "wide_verge": opendrive(2, (("shoulder", 1.5), ("border", 6.0))),
    # A motorway's, beyond which somebody starts 4.5 m from the lane.
    "wide_shoulder": opendrive(2, (("shoulder", 4.0), ("sidewalk", 2.0))),
    "left_hand": opendrive(2, (("sidewalk", 2.5),), "LHT"),
}


@pytest.fixture(scope="module")
def grounds(tmp_path_factory: pytest.TempPathFactory) -> dict[str, OperatingArea]:
    """The shipped sites and maps, and some that are written here."""
    folder = tmp_path_factory.mktemp("maps")
    found = {site: ground_of(site) for site in SITES}
    for name in MAPS:
        path = LIBRARY / "maps" / f"{name}.xodr"
        if name in _WRITTEN:
            path = folder / f"{name}.xodr"
            path.write_bytes(_WRITTEN[name])
        found[name] = load_area(None, path)[0]
    return found


def with_initiator(event: Event, word: str) -> Event:
    who = event.participants[event.interaction.initiator]
    changed = who.model_copy(update={"class_": word})
    participants = {**event.participants, event.interaction.initiator: changed}
    return event.model_copy(update={"participants": participants})


@cache
def combinations_of(name: str) -> list[Event]:
    """A shipped event from each side with an initiator of each class; neighbours differ in both."""
    kind = KINDS[name]
    words = sorted(kind.initiator_classes)
    if name == "slow_lead":
        # Moving and standing ones by turns; the others of each class are run below.
        return [slow_lead(word, standing=index % 2 == 1) for index, word in enumerate(words)]
    sides = [Event.model_validate(shipped(name)), from_the_other_side(name)]
    sides = [e for e in sides if e.interaction.dominant_motion in kind.dominant_motions]
    # What is ahead in the VUT's lane comes from no side.
    sides = sides[:1] if kind.relation == "following" else sides
    return [
        with_initiator(sides[(index + turn) % len(sides)], word)
        for turn in range(len(sides))
        for index, word in enumerate(words)
    ]


def best_block(event: Event, area: OperatingArea) -> Block | None:
    """The first block that the retrieval would try; those of one map are much alike."""
    scores = score_blocks(event, area.library)
    assert all(score.eligible or score.reasons for score in scores)
    best = next((score.block for score in scores if score.eligible), None)
    return next((block for block in area.library.blocks if block.block_id == best), None)


# The motorway has no opposite lanes, and left-hand traffic is refused for its side.
WITHOUT_BLOCK = {"motorway", "left_hand"}


def turns_of(name: str) -> list[tuple[Event, str]]:
    """The combinations of an event, each at one of the places that have a block for it.

    The turns go on until each combination and each place had one.
    """
    combinations = combinations_of(name)
    places = [place for place in (*SITES, *MAPS) if place not in WITHOUT_BLOCK]
    turns = range(max(len(combinations), len(places)))
    return [(combinations[k % len(combinations)], places[k % len(places)]) for k in turns]


def tried(event: Event, block: Block, area: OperatingArea) -> RunSpec | None:
    """The run whose event would happen; None where it is refused, which says what misses."""
    refused = ""
    try:
        made = realise(Order(event, "sha256:test", area, "sumo", 1, {}), block)
    except CannotPlace as error:
        refused = str(error)
    else:
        return made.task.run.model_copy(update={"camera": None})
    assert re.search(r"-?\d+(\.\d+)? (m|s|m/s|m/s\^2|deg)\b", refused), refused
    return None


@pytest.mark.parametrize("name", ON_OPEN_ROAD)
def test_every_combination_happens_or_is_refused_with_what_misses(
    name: str, grounds: dict[str, OperatingArea]
) -> None:
    kind, found = KINDS[name], set()
    for event, place in turns_of(name):
        block = best_block(event, grounds[place])
        assert block is not None, place
        tried(event, block, grounds[place])
        initiator = event.participants[event.interaction.initiator]
        found.add((initiator.class_, event.interaction.dominant_motion))
    if name == "slow_lead":
        assert {word for word, _ in found} == set(kind.initiator_classes)
        return
    sides = {shipped(name)["interaction"]["dominant_motion"]}
    sides |= {from_the_other_side(name).interaction.dominant_motion} & set(kind.dominant_motions)
    assert found == {(word, side) for word in kind.initiator_classes for side in sides}


@pytest.mark.parametrize("place", sorted(WITHOUT_BLOCK))
def test_a_place_without_a_block_for_an_event_has_one_for_no_combination(
    place: str, grounds: dict[str, OperatingArea]
) -> None:
    for name in ON_OPEN_ROAD:
        assert all(best_block(event, grounds[place]) is None for event in combinations_of(name))


@pytest.mark.parametrize("name", AT_JUNCTION)
@pytest.mark.parametrize(("place", "domain"), [(0, "simulation"), (1, "physical")])
def test_every_route_of_an_approach_happens_or_is_refused_with_what_misses(
    name: str, place: int, domain: Literal["simulation", "physical"]
) -> None:
    """The VUT goes straight on, or turns left; what happens there was run before it is accepted.

    The sites' ramps join from the right.
    """
    area = ground(site_of(name, domain))
    enters = "south_in" if name == "roundabout" else "west_in"
    routes = [one for one in area.library.blocks if one.passage and one.entrances == (enters,)]
    events = combinations_of(name)
    event = events[min(place, len(events) - 1)]
    found = {one.block_id: tried(event, one, area) is not None for one in routes}
    comes = not (name == "merge" and event.interaction.dominant_motion.endswith("left"))
    leads = "> north_out" if name in ("roundabout", "vut_turn") else "> east_out"
    assert found == {one.block_id: comes and leads in one.block_id for one in routes}
    assert comes == any(found.values())


@pytest.fixture
def simulate(monkeypatch: pytest.MonkeyPatch) -> Simulate:
    """Runs a session; one that the compiler has tried, to the byte the same, isn't run again."""
    found: dict[str, tuple[InProcessResult, Record]] = {}

    def once(run: RunSpec) -> tuple[InProcessResult, Record]:
        key = run.model_dump_json()
        if key not in found:
            found[key] = run_in_process(run)
        return found[key]

    monkeypatch.setattr(feasibility, "run_in_process", once)
    return once


@pytest.mark.parametrize("name", ON_OPEN_ROAD)
@pytest.mark.parametrize("side", ["as shipped", "other"])
def test_what_compiles_runs_valid(name: str, side: str, simulate: Simulate) -> None:
    """One run per event and side, with the traffic that the predicate leaves out."""
    shipped_one = Event.model_validate(shipped(name))
    event = shipped_one if side == "as shipped" else from_the_other_side(name)
    area = ground_of("boulevard")
    block = best_block(event, area)
    run = None if block is None else tried(event, block, area)
    if run is None:
        assert event != shipped_one
        return
    assert run.traffic
    result, _ = simulate(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert run.passing is not None
    if event.constraints.time_gap == UNRESOLVED:
        # Nobody passes what stands in the VUT's lane.
        assert result.passing.other_first
        assert result.passing.time_gap_s is None
        return
    assert result.passing.time_gap_s is not None
    gap_s = result.passing.time_gap_s
    first = result.passing.other_first
    assert run.passing.misses("ot1", first, gap_s, vut_arrived=True) == []


@pytest.mark.parametrize(
    ("object_class", "standing"),
    [
        *((word, index % 2 == 0) for index, word in enumerate(sorted(SPEEDS_MPS))),
        ("pedestrian", False),
    ],
)
def test_a_slow_lead_of_any_class_runs_valid(
    object_class: str, standing: bool, simulate: Simulate
) -> None:
    run = compiled(slow_lead(object_class, standing), ground_of("north_track"))
    assert run.triggers[0].manoeuvre.kind == "hold"
    assert (run.targets[0].approach is None) == standing
    result, record = simulate(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert result.passing.other_first
    # It was sent nothing but its approach, and kept its offset.
    assert [len(t.reference_ids) for t in result.triggers] == [0]
    assert run.vut.approach is not None
    path = Polyline(run.vut.approach.path)
    offsets_m = [path.project(s.x_m, s.y_m)[1] for s in record.truths("ot1")]
    assert all(-0.6 < offset_m < -0.1 for offset_m in offsets_m)


@pytest.mark.parametrize(
    ("object_class", "offset_m", "said"),
    [
        ("car", 1.3, "1.30 m beside the middle of its lane of 3.75 m would leave it, at most 0.97"),
        ("pedestrian", -1.3, "would leave the VUT's way free, at most 1.15 m doesn't"),
    ],
)
def test_a_slow_lead_beside_lane_or_corridor_is_refused_with_its_offset(
    object_class: str, offset_m: float, said: str
) -> None:
    offset = {"min": offset_m, "max": offset_m, "unit": "m"}
    with pytest.raises(CannotPlace, match=said):
        compiled(slow_lead(object_class, offset=offset), ground_of("north_track"))


def test_who_waits_on_a_wide_verge_waits_at_its_inner_edge(
    grounds: dict[str, OperatingArea],
) -> None:
    event, area = Event.model_validate(shipped("vru_crossing")), grounds["wide_verge"]
    result, _ = run_once(compiled(event, area))
    assert result.verdict is Verdict.VALID


def test_a_shoulder_too_wide_for_the_trigger_is_refused_with_both_times(
    grounds: dict[str, OperatingArea],
) -> None:
    event, area = Event.model_validate(shipped("vru_crossing")), grounds["wide_shoulder"]
    with pytest.raises(CannotPlace, match=r"ot1 takes \d\.\d s .* approach speed \d\.\d s"):
        compiled(event, area)
    told = fitting_trigger(event, lambda other: compiled(other, area))
    assert told is not None
    assert "K* has 3 to 3.4" in told


def test_left_hand_traffic_is_refused_for_its_side(grounds: dict[str, OperatingArea]) -> None:
    for name in KINDS:
        event = Event.model_validate(shipped(name))
        for score in score_blocks(event, grounds["left_hand"].library):
            assert any("left-hand traffic" in reason for reason in score.reasons)


def test_the_predicate_sees_that_nobody_crosses_in_left_hand_traffic(
    grounds: dict[str, OperatingArea],
) -> None:
    """Someone from the right crosses two oncoming lanes first, whatever the retrieval says."""
    event, area = Event.model_validate(shipped("vru_crossing")), grounds["left_hand"]
    with pytest.raises(CannotPlace, match="wouldn't reach the conflict point first"):
        compiled(event, area)


# -- what an object is told after the event --------------------------------------------------------


@pytest.mark.parametrize("name", ["cut_in", "lead_braking"])
def test_references_end_soon_after_the_event_however_long_the_road_is(
    name: str, grounds: dict[str, OperatingArea]
) -> None:
    event = Event.model_validate(shipped(name))
    run = compiled(event, grounds["wide_verge"])
    session = InProcessSession(run, make_plant(run))
    session.run()
    assert session.session.verdict is Verdict.VALID, session.session.reasons
    (over,) = [
        change
        for change in session.of_kind(outbox.StateChanged)
        if change.state is SessionPhase.STOPPING
    ]
    last = session.of_kind(Reference)[-1]
    ends_s = ns_to_seconds(last.execute_at_ns) + last.points[-1].t_s
    assert 5.0 < ends_s - ns_to_seconds(over.stamp_ns) < 30.0
