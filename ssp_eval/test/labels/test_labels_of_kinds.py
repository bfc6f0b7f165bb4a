"""Labels of an event's source clip and of a session by one plan, kind by kind (METHOD 5.2b)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, replace
from functools import cache

import pytest

from ssp_core.clock import ns_to_seconds
from ssp_core.world.driver import history_of
from ssp_eval.data.labels import Labels, compare_labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_eval.extract.engine import extract
from ssp_eval.labels.propose import Proposal, propose_by_plan
from ssp_eval.labels.truth import Truth
from ssp_eval.recordings.event import rules_of
from ssp_eval.recordings.source_clip import board_of
from ssp_eval.score.engine import score_cells
from ssp_eval.statistics.best_constant import Plan, best_constant
from ssp_scenario_manager.compile.place import Order, realise
from ssp_scenario_manager.compile.retrieval import score_blocks
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.feasibility import driven
from ssp_vla_bridge.backends.baselines import CopyHistory
from ssp_vla_bridge.backends.phrases import point_times
from ssp_vla_bridge.messages import EgoSample, Request
from ssp_vla_bridge.trajectory import Trajectory
from tests.support.events.junctions import ground
from tests.support.events.places import site_of

# The demonstration has cut_in and vru_crossing in all three domains.
KINDS = (
    "crossing_car",
    "cut_out",
    "merge",
    "oncoming_turn",
    "roundabout",
    "slow_lead",
    "vut_turn",
)
# Steps of a session from one frame to the next.
STEP = 5
# Of the VUT's past, what a model is shown.
HISTORY_S = 2.0


def of_clip(event: Event) -> Truth:
    board = board_of(event, 1)
    times = board.times()
    return Truth(
        scenario=event.name,
        domain="synthetic",
        event_version="sha256:test",
        start_s=times[0],
        end_s=times[-1],
        vut_id=event.vut_id,
        target_ids=tuple(sorted({*event.participants} - {event.vut_id})),
        series=[(t_s, list(board.states(t_s))) for t_s in times],
        source="the source clip",
        rules=rules_of(event, None),
        frames_s=times,
    )


def of_session(event: Event) -> Truth:
    area = ground(site_of(event.name))
    best = next(one.block for one in score_blocks(event, area.library) if one.eligible)
    block = next(one for one in area.library.blocks if one.block_id == best)
    run = realise(Order(event, "sha256:test", area, "sumo", 1, {}), block).task.run
    _, record = driven(run)
    states = zip(*(record.truths(name)[::STEP] for name in run.object_ids), strict=True)
    series = [(ns_to_seconds(now[0].stamp_ns), list(now)) for now in states]
    return replace(
        of_clip(event),
        domain="simulation",
        start_s=series[0][0],
        end_s=series[-1][0],
        series=series,
        source="a session",
        rules=rules_of(event, run),
        frames_s=[t_s for t_s, _ in series],
    )


@cache
def proposed(name: str) -> list[Proposal]:
    """Labels of an event's clip and of a session by one plan."""
    event = load_event(name)[0]
    proposals, why_no_plan = propose_by_plan([of_clip(event), of_session(event)])
    assert why_no_plan == ""
    return proposals


def blind_scores(recordings: Iterable[Labels], text: str, lateral: str) -> list[float]:
    """IVCS of a model that says the same everywhere, names nothing, and keeps its speed."""
    whole = ((0, len(text)),)
    slots = Slots(None, None, None, None, Slot("maintain", whole), Slot(lateral, whole))
    trajectory = Plan("maintain", "straight").trajectory
    cells = [
        (one, [BehaviourRecord(label.t_s, text, slots, trajectory) for label in one.labels])
        for one in recordings
    ]
    return [found.ivcs for found in score_cells(cells)]


def past_of(truth: Truth, t_s: float) -> tuple[EgoSample, ...]:
    """Return the VUT's motion as a model is shown it; an imported clip declares its speed."""
    vut = [one for _, states in truth.series for one in states if one.object_id == truth.vut_id]
    if truth.domain == "synthetic":
        speed = vut[0].speed_mps
        span_s = min(HISTORY_S, t_s - truth.start_s)
        times = (-span_s * k / 20 for k in range(20, -1, -1))
        return tuple(EgoSample(back_s, speed * back_s, 0.0, 0.0, speed, 0.0) for back_s in times)
    spans = (t_s - ns_to_seconds(one.stamp_ns) for one in vut)
    past = [one for one, ago_s in zip(vut, spans, strict=True) if -1e-6 <= ago_s <= HISTORY_S + 0.1]
    return tuple(EgoSample(*astuple(one)) for one in history_of(past))


def copied(labels: Labels, truth: Truth) -> float:
    """IVCS of copy_history."""
    records = []
    for label in labels.labels:
        past = past_of(truth, label.t_s)
        asked = Request("", 0, (), history=past, ego_provenance="measured")
        answer = CopyHistory().answer(asked)
        points = answer.arrays[0].data if answer.arrays else ()
        plan = Trajectory(point_times(asked.task), points[::2], points[1::2]) if points else None
        records.append(BehaviourRecord(label.t_s, answer.text, extract(answer.text), plan))
    return score_cells([(labels, records)])[0].ivcs


@pytest.mark.parametrize("name", KINDS)
def test_clip_and_session_have_as_many_labels_per_phase_and_a_blind_model_the_same_score(
    name: str,
) -> None:
    labels = {one.labels.domain: one.labels for one in proposed(name)}
    compared = compare_labels(labels)
    assert (compared.comparable, compared.aligned) == (True, True)
    text = "I keep my speed and my lane."
    synthetic, simulation = blind_scores(labels.values(), text, "straight")
    assert synthetic == pytest.approx(simulation, abs=0.02)
    assert synthetic > 0.1


@pytest.mark.parametrize("name", KINDS)
def test_what_a_session_shows_of_the_vut_s_past_gives_no_answer_away(name: str) -> None:
    """A model that copies a constant gains and loses nothing beyond what the labels give to it."""
    event = load_event(name)[0]
    clip, session = (one.labels for one in proposed(name))
    copies = copied(clip, of_clip(event)), copied(session, of_session(event))
    constants = [one.ivcs for one in best_constant((clip, session)).scores]
    beyond = abs(copies[0] - copies[1]) - abs(constants[0] - constants[1])
    assert beyond <= 0.02


def test_a_vut_that_turns_left_has_the_oncoming_vehicle_ahead_on_its_left() -> None:
    """The vehicle comes in the next lane to the left, until it passes beside the waiting VUT."""
    for proposal in proposed("vut_turn"):
        before, *critical, passed = proposal.labels.labels
        assert (before.phase, before.position, before.motion) == (
            "approach",
            "front_left",
            "stationary",
        )
        assert {label.phase for label in critical} == {"trigger", "conflict"}
        assert {(label.position, label.motion) for label in critical} == {
            ("front_left", "oncoming")
        }
        assert (passed.phase, passed.position, passed.motion) == ("resolution", "left", "oncoming")


def test_to_turn_left_is_as_right_as_to_keep_the_lane_where_the_vut_means_to_turn() -> None:
    recordings = [proposal.labels for proposal in proposed("vut_turn")]
    turns = blind_scores(recordings, "I turn left at constant speed.", "left")
    keeps = blind_scores(recordings, "I keep my speed and my lane.", "straight")
    assert turns == keeps
    admitted = {label.lat_actions for one in recordings for label in one.labels}
    assert admitted == {("straight", "left")}


@pytest.mark.parametrize("name", [kind for kind in KINDS if kind != "vut_turn"])
def test_no_turn_is_right_where_the_vut_means_to_keep_its_lane(name: str) -> None:
    recordings = [proposal.labels for proposal in proposed(name)]
    assert {label.lat_actions for one in recordings for label in one.labels} == {("straight",)}
