"""The shipped K* say of their source clips what the clips' ground truth says."""

from __future__ import annotations

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import encounter
from ssp_core.motion.event import find_event, instants_of
from ssp_core.run_file.model import ConflictThresholds
from ssp_ot_controller.camera.clip import GENERATOR
from ssp_ot_controller.camera.storyboards import INTERACTIONS, Storyboard, storyboard
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Times stand in K* to the millisecond.
ROUNDING_S = 0.0006


def _value(quantity: object) -> float:
    assert isinstance(quantity, Interval)
    assert quantity.min is not None
    assert quantity.min == quantity.max
    return quantity.min


@pytest.fixture(params=INTERACTIONS)
def event(request: pytest.FixtureRequest) -> Event:
    return load_event(request.param)[0]


@pytest.fixture
def board(event: Event) -> Storyboard:
    name, _, seed = event.source.original.partition(" seed ")
    assert (event.source.generator, name) == (GENERATOR, event.name)
    return storyboard(name, int(seed))


def test_clip_and_rate(event: Event, board: Storyboard) -> None:
    assert _value(event.source.rate) == board.fps
    assert _value(event.events.clip.end) == board.duration_s
    frames = event.events.resolution.evidence[-1].frames
    assert frames is not None
    assert frames[1] == len(board.times()) - 1


def test_phases_start_when_the_ground_truth_says(event: Event, board: Storyboard) -> None:
    series = [(t_s, {s.object_id: s for s in board.states(t_s)}) for t_s in board.times()]
    samples = instants_of(series, event.vut_id, event.interaction.initiator)
    ttc, gap = event.constraints.thresholds.ttc, event.constraints.thresholds.arrival_gap
    thresholds = ConflictThresholds(
        ttc_s=_value(ttc) if ttc else None, arrival_gap_s=_value(gap) if gap else None
    )
    road = Polyline(board.vut_path)
    kind = KINDS[event.interaction.type]
    found = find_event(samples, road, thresholds, observable=kind.observable)
    assert found is not None
    for phase, truth_s in (
        ("trigger", found.trigger_s),
        ("conflict", found.conflict_s),
        ("resolution", found.resolution_s),
    ):
        assert _value(getattr(event.events, phase).start) == pytest.approx(truth_s, abs=ROUNDING_S)


def test_participants_and_where_they_start(event: Event, board: Storyboard) -> None:
    states = {state.object_id: state for state in board.states(0.0)}
    vut = states[event.vut_id]
    road = Polyline(board.vut_path)
    for who, participant in event.participants.items():
        assert states[who].object_class.word == participant.class_
        gap = participant.region.gap
        if who != event.vut_id:
            assert isinstance(gap, Interval)
            assert gap.min is not None
            assert gap.max is not None
            assert gap.min <= encounter(vut, states[who], road).gap_m <= gap.max
            offset = road.project_beyond(states[who].x_m, states[who].y_m)[1]
            side = participant.region.place.partition("_")[0]
            sides = {"right": offset < -1.5, "vut": abs(offset) < 0.5}
            assert (sides | dict.fromkeys(("left", "oncoming"), offset > 1.5))[side]


def test_topology_has_the_values_of_the_clip_s_own_road(event: Event, board: Storyboard) -> None:
    topology = event.topology
    same = sum(lane.direction == "forward" for lane in board.road.lanes)
    opposite = len(board.road.lanes) - same
    assert topology.lanes_same_direction.value == same
    assert topology.lanes_opposite.value == opposite
    assert board.vut.state(0.0).y_m == min(lane.y_m for lane in board.road.lanes)
    assert topology.vut_lane.value == "rightmost"
    assert (topology.segment.value == "junction") == bool(board.road.junction)
    assert topology.segment.value in ("straight", "junction")
    assert board.road.sidewalk_left_m > 0.0
    assert board.road.sidewalk_right_m > 0.0
    assert (topology.left_boundary.value, topology.right_boundary.value) == ("sidewalk",) * 2
    assert all(topology.lane_width.admits(lane.width_m) for lane in board.road.lanes)
