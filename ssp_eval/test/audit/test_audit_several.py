"""Further participants in the audit: presence, class and place of each are entries of KPR."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache

import pytest

from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import PHASES, ObjectClass
from ssp_core.world.camera import Intrinsics, Mounting
from ssp_eval.audit.checks import further_findings, property_findings
from ssp_eval.audit.evidence.evidence import expected_properties, varying_parts
from ssp_eval.audit.evidence.further import departures
from ssp_eval.audit.evidence.measure import Measurements, RoadFacts, Scene, measure
from ssp_eval.audit.evidence.reasons import explain
from ssp_eval.data.audit import ROLES, TOPOLOGY, property_retention
from ssp_eval.labels.propose import propose_by_plan
from ssp_eval.labels.truth import Truth
from ssp_eval.recordings.event import rules_of
from ssp_eval.recordings.sight import Moment, Optics, object_sight
from ssp_eval.recordings.source_clip import board_of, measure_clip
from ssp_ot_controller.camera.storyboards import storyboard
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.compile.place import Order, realise
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.feasibility import driven
from ssp_scenario_manager.scenarios.further import further_ids
from tests.support.events.junctions import ground, made
from tests.support.events.several import (
    EXAMPLES,
    LEAD,
    behind_a_parked_truck,
    several,
    with_further,
)

States = dict[str, ObjectState]
# The lead's state at a clip time beside the VUT's; None: it isn't there.
Altered = Callable[[float, ObjectState, ObjectState], ObjectState | None]
STEP = 5
CUT_IN = "lead_ahead_of_a_cut_in"


@cache
def recorded(example: str, site: str = "boulevard") -> tuple[Event, Scene]:
    """A session of an example, as its recording is read."""
    event, area = several(example), load_area(site, None)[0]
    run = realise(Order(event, "sha256:test", area, "sumo", 1, {}), area.library.blocks[0]).task.run
    return event, as_read(event, run)


def as_read(event: Event, run: RunSpec) -> Scene:
    _, record = driven(run)
    states = zip(*(record.truths(name)[::STEP] for name in run.object_ids), strict=True)
    series = [(ns_to_seconds(now[0].stamp_ns), {s.object_id: s for s in now}) for now in states]
    rules = rules_of(event, run)
    targets = tuple(target.id for target in run.targets)
    road = RoadFacts(run.road)
    ends = series[0][0], series[-1][0]
    return Scene(series, "vut", targets, road, *ends, rules, further_ids(event))


def changed(scene: Scene, change: dict[str, dict[str, object] | None]) -> Scene:
    """A scene in which some objects have other fields, or are missing."""

    def states(now: Mapping[str, ObjectState]) -> States:
        found: States = {}
        for name, state in now.items():
            fields = change.get(name, {})
            if fields is not None:
                one = replace(state, **fields)  # type: ignore[arg-type]  # fields of a state
                found[one.object_id] = one
        return found

    return replace(scene, series=[(t_s, states(now)) for t_s, now in scene.series])


def retention_of(event: Event, found: Measurements) -> tuple[float, dict[str, str]]:
    """KPR against K*, and what differs in the roles, by code."""
    varying = varying_parts(event)
    mine = {k: q.without(varying) for k, q in found.properties.items()}
    # The road of a run doesn't say its type and what lies beside it.
    wanted = {
        k: q.without(set(q.words or {}) - set(mine[k].words or {}) | varying)
        if k == TOPOLOGY
        else q
        for k, q in expected_properties(event).items()
    }
    told = property_findings(mine, wanted, found.phases, found.first_arrival_s)
    details = {one.finding.code: one.finding.detail for one in explain(told)}
    return property_retention(mine, wanted), details


@pytest.mark.parametrize("example", EXAMPLES)
def test_presence_class_and_place_of_each_are_entries_of_kpr(example: str) -> None:
    event, scene = recorded(example)
    found = measure(scene)
    assert retention_of(event, found) == (1.0, {})
    assert (found.initiator, found.affected, found.intrusions) == ("ot1", "vut", ())
    words = found.properties[ROLES].words or {}
    for name in further_ids(event):
        who = event.participants[name]
        assert words[name] == (f"OT, {who.class_}",)
        assert words[f"{name} starts in"] == (who.region.place,)


NEGATIVES = {
    "missing": ({"ot2": None}, "roles_differ", "ot2: OT, never there instead of OT, car"),
    "another class": (
        {"ot2": {"object_class": ObjectClass.TRUCK, "size": DEFAULT_SIZES[ObjectClass.TRUCK]}},
        "roles_differ",
        "ot2: OT, truck instead of OT, car",
    ),
    "another place": (
        {"ot2": {"y_m": 3.5}},
        "place_differs",
        "ot2 starts in left_lane instead of vut_lane",
    ),
    "exchanged with the initiator": (
        {"ot1": {"object_id": "ot2"}, "ot2": {"object_id": "ot1"}},
        "roles_differ",
        "initiator: ot2 instead of ot1",
    ),
}


@pytest.mark.parametrize("what", NEGATIVES)
def test_another_further_participant_is_refused_with_what_differs(what: str) -> None:
    change, code, detail = NEGATIVES[what]
    event, scene = recorded(CUT_IN)
    retention, differing = retention_of(event, measure(changed(scene, change)))
    assert retention < 1.0
    assert detail in differing[code]


@pytest.mark.parametrize("site", ["boulevard", "north_track"])
@pytest.mark.parametrize("example", EXAMPLES)
def test_a_session_keeps_the_scripts_of_its_further_participants(example: str, site: str) -> None:
    event, scene = recorded(example, site)
    found = measure(scene)
    assert [course.object_id for course in found.courses] == list(further_ids(event))
    assert all(course.instants > 10 for course in found.courses)
    assert list(departures(event, found.courses)) == []


def _only(when: Callable[[float], bool]) -> Altered:
    return lambda t_s, ot2, _vut: ot2 if when(t_s) else None


# Alterations of the lead by clip time, with what the audit says.
DEPARTURES: dict[str, tuple[Altered, str]] = {
    "gone after the first state": (_only(lambda t_s: t_s < 0.05), "is there at 0 of"),
    "there at the end only": (_only(lambda t_s: t_s > 18.4), "is there at 0 of"),
    "stands": (
        lambda _, ot2, __: replace(ot2, speed_mps=0.0),
        "drives 0.0 to 0.0 m/s in the trigger, K* has 12 to 14 m/s",
    ),
    "in the left lane after 2 s": (
        lambda t_s, ot2, _: replace(ot2, y_m=ot2.y_m + (3.5 if t_s > 2.0 else 0.0)),
        "else left_lane; K* has vut_lane",
    ),
    "backwards": (
        lambda _, ot2, __: replace(ot2, yaw_rad=ot2.yaw_rad + math.pi),
        "else opposite; K* has same",
    ),
    "behind the VUT": (
        lambda _, ot2, vut: replace(ot2, x_m=vut.x_m - 20.0),
        "starts behind the VUT by",
    ),
    "60 m further ahead": (
        lambda _, ot2, __: replace(ot2, x_m=ot2.x_m + 60.0),
        "m ahead of the VUT, K* has 95 to 125 m",
    ),
}


@pytest.mark.parametrize("what", DEPARTURES)
def test_a_further_participant_off_its_script_is_a_finding(what: str) -> None:
    alter, wanted = DEPARTURES[what]
    event, scene = recorded(CUT_IN)
    series: list[tuple[float, States]] = []
    for t_s, now in scene.series:
        other = alter(t_s, now["ot2"], now["vut"])
        rest = {name: state for name, state in now.items() if name != "ot2"}
        series.append((t_s, rest if other is None else rest | {"ot2": other}))
    measured = measure(replace(scene, series=series))
    found = [one.entry for one in further_findings(event, measured, scene.rules.thresholds)]
    assert {one["code"] for one in found} == {"off_spec"}
    assert any(one["detail"].startswith("ot2 ") and wanted in one["detail"] for one in found), found


def test_the_gap_counts_where_the_session_begins_not_where_its_clip_does() -> None:
    event, scene = recorded("oncoming_while_a_pedestrian_crosses")
    clip = replace(scene, series=[one for one in scene.series if one[0] > 6.7])
    assert any("starts" in text for text in departures(event, measure(clip).courses))
    begun = replace(clip, begin=scene.series[0][1])
    assert list(departures(event, measure(begun).courses)) == []


def test_a_further_participant_in_conflict_first_is_told_with_its_quantity() -> None:
    """It is in the VUT's lane from the first, so that nothing of it becomes observable."""
    _, scene = recorded(CUT_IN)
    near = {
        name: replace(state, x_m=state.x_m + 60.0) if name == "vut" else state
        for name, state in scene.series[40][1].items()
    }
    slow = near | {"ot2": replace(near["ot2"], x_m=near["vut"].x_m + 20.0, speed_mps=0.0)}
    (one,) = measure(
        replace(scene, series=[*scene.series[:40], (scene.series[40][0], slow)])
    ).intrusions
    assert one.object_id == "ot2"
    assert "TTC" in one.text(scene.rules.thresholds)


def truth_of(scenario: str, scene: Scene) -> Truth:
    return Truth(
        scenario=scenario,
        domain="simulation",
        event_version="sha256:test",
        start_s=scene.start_s,
        end_s=scene.end_s,
        vut_id="vut",
        target_ids=scene.target_ids,
        series=[(t_s, list(now.values())) for t_s, now in scene.series],
        source="a session",
        frames_s=[t_s for t_s, _ in scene.series],
        rules=scene.rules,
    )


@pytest.mark.parametrize("example", EXAMPLES)
def test_labels_go_by_the_initiator_and_are_as_many_in_each_domain(example: str) -> None:
    truths = []
    for site in ("boulevard", "north_track"):
        event, scene = recorded(example, site)
        truths.append(truth_of(example, scene))
    proposals, why_no_plan = propose_by_plan(truths)
    assert why_no_plan == ""
    counts = []
    for proposal in proposals:
        assert proposal.event.object_id == event.interaction.initiator
        labels = proposal.labels.labels
        counts.append([sum(label.phase == phase for label in labels) for phase in PHASES])
    assert counts[0] == counts[1]
    assert 0 not in counts[0]


def test_a_car_behind_a_parked_truck_is_labelled_and_counted_as_hidden() -> None:
    """The trigger comes while the car is hidden; the labels name the car once it is visible."""
    event = behind_a_parked_truck()
    scene = as_read(event, made(event, ground("crossroads")).task.run)
    found = measure(scene)
    assert retention_of(event, found) == (1.0, {})
    assert list(departures(event, found.courses)) == []
    assert found.intrusions == ()
    span = found.phases.critical_s
    assert span is not None
    optics = Optics(Intrinsics(960, 540, 480.0, 480.0, 480.0, 270.0), Mounting(1.5, 1.4, 0.0))
    moments = [Moment(t_s, states) for t_s, states in scene.series]
    seen = object_sight(moments, span, 0.1, optics, "vut", "ot1").fraction
    least = event.constraints.camera.visible_fraction.min
    assert seen is not None
    assert least is not None
    assert least < seen < 0.8
    (proposal,), why_no_plan = propose_by_plan([truth_of("crossing_car", scene)])
    assert why_no_plan == ""
    shown = [(label.phase, label.objects) for label in proposal.labels.labels]
    assert ("trigger", ("car",)) not in shown
    assert ("conflict", ("car",)) in shown
    assert proposal.event.object_id == "ot1"


# -- the source clip -------------------------------------------------------------------------------


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_clip_shows_each_in_its_place_and_the_phases_of_the_initiator(example: str) -> None:
    event = several(example)
    board = board_of(event, 1)
    bare = storyboard(event.interaction.type, 1)
    names = {state.object_id: state for state in board.states(0.0)}
    vut = names["vut"]
    for name in further_ids(event):
        who, state = event.participants[name], names[name]
        assert state.object_class.word == who.class_
        gap = who.region.gap
        assert not isinstance(gap, str)
        nearest_m = min(x for x, _ in state.box.corners())
        assert nearest_m - vut.x_m - vut.size.front_m == pytest.approx(gap.si.mid)
    alone = event.model_copy(
        update={
            "participants": {
                name: who
                for name, who in event.participants.items()
                if name not in further_ids(event)
            }
        }
    )
    assert measure_clip(event, board) == measure_clip(alone, bare)


def test_a_clip_in_which_another_is_in_conflict_is_not_drawn() -> None:
    standing = LEAD[4] | {"motion": "stationary", "speed_trend": "standing"}
    event = with_further("cut_in", {"ot2": (*LEAD[:2], (60.0, 60.0), (0.0, 0.0), standing)})
    with pytest.raises(InputError, match="would show another conflict: ot2 is in conflict"):
        measure_clip(event, board_of(event, 1))


def test_a_clip_in_which_two_are_in_one_place_is_not_drawn() -> None:
    inside = ("car", ("left_lane", "ahead"), (25.0, 25.0), *LEAD[3:])
    event = with_further("cut_in", {"ot2": inside})
    wanted = r"would show ot2 0\.00 m from ot1 at \d+\.\d\d s, 0\.5 m keep them clear"
    with pytest.raises(InputError, match=wanted) as refused:
        measure_clip(event, board_of(event, 1))
    assert "participants.ot2.region.gap" in str(refused.value)


def test_a_place_that_the_clip_has_not_is_refused() -> None:
    event = with_further("cut_in", {"ot2": ("car", ("right_lane", "ahead"), *LEAD[2:])})
    with pytest.raises(InputError, match="can't be drawn on the clip's road"):
        board_of(event, 1)
