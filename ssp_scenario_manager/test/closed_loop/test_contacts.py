"""Contacts of a VUT that leaves its lane: with parked participants, and the scenery of the road."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.latency import ZERO_LATENCY
from ssp_core.run_file.road import Building, Lane, Pole, SceneryItem, Tree
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver
from ssp_scenario_manager.closed_loop.campaigns.runs import drive_start
from ssp_scenario_manager.closed_loop.contact import with_vut
from ssp_scenario_manager.closed_loop.outcomes.outcome import (
    DriverRun,
    Outcome,
    outcome_of,
    severity_of,
)
from ssp_scenario_manager.closed_loop.starts.start import Start, make_start
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.run.in_process import Record

# The VUT's lane is the rightmost one of boulevard, which is straight, along x.
EDGE_M = -1.75
ASIDE_MPS = 0.5


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Start:
    folder = tmp_path_factory.mktemp("contacts") / "cut_in"
    compiled = prepare_run("cut_in", "boulevard", folder, seed=1, mode="lockstep")
    return make_start(compiled, load_event("cut_in")[0], 1, latency_max_s=0.0)


@pytest.fixture(scope="module")
def steady(start: Start) -> DriverRun:
    return drive_start(start, CampaignDriver(driver="no_response"), ZERO_LATENCY)


def vut_of(report: StepReport) -> ObjectState:
    return next(state for state in report.truths if state.object_id == "vut")


def aside(steady: DriverRun, start: Start, *others: ObjectState) -> list[StepReport]:
    """Return a drive to the right from the hand-over on, past others that stand."""
    from_ns = seconds_to_ns(start.hand_over_s)

    def moved(report: StepReport) -> StepReport:
        vut = vut_of(report)
        out_m = ASIDE_MPS * max(report.now_ns - from_ns, 0) / 1e9
        here = tuple(replace(other, stamp_ns=report.now_ns) for other in others)
        gone = with_vut(report, replace(vut, y_m=vut.y_m - out_m))
        return replace(gone, truths=(*gone.truths, *here))

    return [moved(report) for report in steady.record.reports]


@pytest.fixture(scope="module")
def leaves(steady: DriverRun, start: Start) -> ObjectState:
    """The VUT at the first step with a corner beside the carriageway."""
    states = [vut_of(report) for report in aside(steady, start)]
    return next(s for s in states if min(y for _, y in s.box.corners()) < EDGE_M - 1e-9)


def outcome_with(
    steady: DriverRun,
    start: Start,
    body: SceneryItem | ObjectState | None,
    **road: Any,
) -> Outcome:
    """Return the outcome of the drive to the right, with a further body."""
    run = steady.run.model_copy(update={"road": steady.run.road.model_copy(update=road)})
    others: list[ObjectState] = []
    if isinstance(body, ObjectState):
        (target,) = run.targets
        further = target.model_copy(update={"id": body.object_id})
        run = run.model_copy(update={"targets": [target, further]})
        others.append(body)
    elif body is not None:
        place = run.road.model_copy(update={"scenery": [body]})
        run = run.model_copy(update={"road": place})
    record = Record(aside(steady, start, *others))
    assert run.driven is not None
    return outcome_of(run, run.driven, steady.result, record, start.twin)


def parked(vut: ObjectState, ahead_m: float, left_m: float) -> ObjectState:
    """Return a further car that stands, with the VUT's size, up to there on its left."""
    y_m = left_m - vut.size.width_m / 2.0
    place = replace(vut, object_id="ot2", x_m=vut.x_m + ahead_m, y_m=y_m)
    return replace(place, speed_mps=0.0, acceleration_mps2=0.0, yaw_rate_radps=0.0)


def pole(vut: ObjectState, ahead_m: float, l_m: float) -> Pole:
    return Pole(type="pole", s_m=vut.x_m + ahead_m, l_m=l_m)


def hall(vut: ObjectState) -> Building:
    size = {"length_m": 60.0, "width_m": 10.0, "height_m": 8.0}
    return Building(type="building", s_m=vut.x_m, l_m=EDGE_M - 5.0, **size)


# Reasons begin with these words.
OFF = "a corner 0."


@pytest.mark.parametrize(
    ("body", "kind", "why"),
    [
        (lambda _: None, "left_road", OFF),
        # Participants: those that stand in the lane, and those that stand beside the road.
        (lambda v: parked(v, 0.0, EDGE_M + 0.02), "collision", "with ot2, flank to flank, "),
        (lambda v: parked(v, -10.0, 0.0), "collision", "with ot2, front to rear, "),
        (lambda v: parked(v, 3.0, EDGE_M - 0.5), "left_road", OFF),
        # Scenery is beside the lanes, so that it is touched first only at the edge.
        (lambda v: pole(v, 1.0, EDGE_M - 0.1), "collision", "with pole road.scenery[0], flank to "),
        (hall, "collision", "with building road.scenery[0], flank to flank, "),
        (lambda v: pole(v, 1.0, EDGE_M - 0.3), "left_road", OFF),
        (lambda v: pole(v, 40.0, EDGE_M - 0.1), "left_road", OFF),
        # What would stand on the lanes isn't drawn.
        (lambda v: pole(v, 0.0, 0.0), "left_road", OFF),
    ],
    ids=[
        *("nothing", "parked at the edge", "parked in the lane", "parked beside the road"),
        *("a pole at the edge", "a wall at the edge", "a pole further out", "a pole later on"),
        "a pole on the lane",
    ],
)
def test_a_vut_that_leaves_its_lane_touches_or_has_left_the_road_whichever_is_first(
    steady: DriverRun,
    start: Start,
    leaves: ObjectState,
    body: Callable[[ObjectState], SceneryItem | ObjectState | None],
    kind: str,
    why: str,
) -> None:
    outcome = outcome_with(steady, start, body(leaves))
    assert (outcome.kind, outcome.why[: len(why)]) == (kind, why), outcome
    if kind == "left_road":
        assert seconds_to_ns(outcome.at_s) == leaves.stamp_ns
        assert outcome.contact is None or outcome.contact.other.startswith("ot")


MEDIAN = {
    "lanes": [
        Lane(y_m=0.0, width_m=3.5, direction="forward"),
        Lane(y_m=-8.0, width_m=3.5, direction="forward"),
    ]
}


def test_a_tree_between_the_carriageways_is_hit_without_having_left_the_road(
    steady: DriverRun, start: Start, leaves: ObjectState
) -> None:
    tree = Tree(type="tree", s_m=leaves.x_m + 20.0, l_m=EDGE_M - 0.4)
    outcome = outcome_with(steady, start, None, **MEDIAN)
    assert outcome.kind == "evaded"
    outcome = outcome_with(steady, start, tree, **MEDIAN)
    assert outcome.kind == "collision"
    assert outcome.contact is not None
    speed = outcome.contact.vut_mps
    assert outcome.contact.relative_mps == speed > 10.0
    assert outcome.why == f"with tree road.scenery[0], front to rear, {speed:.2f} m/s"
    assert severity_of(outcome, 2.0 * speed) == pytest.approx(2.0)
