"""A route that turns: its junction's roads are carriageway, and the grass between arms isn't."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.latency import ZERO_LATENCY, Latency
from ssp_core.world.plant import StepReport
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.closed_loop.campaigns.plan_file import CampaignDriver
from ssp_scenario_manager.closed_loop.campaigns.runs import drive_start
from ssp_scenario_manager.closed_loop.contact import until
from ssp_scenario_manager.closed_loop.outcomes.outcome import DriverRun, left_road
from ssp_scenario_manager.closed_loop.single_run.single import next_start
from ssp_scenario_manager.closed_loop.starts.start import Start
from ssp_scenario_manager.event_spec.load import load_event
from tests.support.events.junctions import LEFT_TURN, ground, made

LEFT_TURNS = {
    "crossroads": LEFT_TURN,
    "tee": "junction tee: west_in > west_north lanes[0] > north_out",
}
# Of the corner of grass in the north-west: how far west and north of the junction's middle the
# mouths of the arms are, and the radius of the grass in the bend of the road around it.
CORNER_M = {"crossroads": (9.75, 6.25), "tee": (15.99, 12.49)}


def vut_of(report: StepReport) -> ObjectState:
    return next(state for state in report.truths if state.object_id == "vut")


@pytest.fixture(scope="module")
def start_of() -> Callable[[str], Start]:
    @cache
    def make(site: str) -> Start:
        event = load_event("vut_turn")[0]
        run = made(event, ground(site), LEFT_TURNS[site]).task.run
        return next_start(run, event, 1, 1.0, lambda _: None)

    return make


@pytest.fixture(scope="module")
def turned_on(start_of: Callable[[str], Start]) -> Callable[[str], DriverRun]:
    """Turns at a site by the built-in driver, once for all tests, which only read it."""
    built_in = CampaignDriver(driver="built_in")
    return cache(lambda site: drive_start(start_of(site), built_in, ZERO_LATENCY, event=False))


@pytest.mark.parametrize("site", LEFT_TURNS)
@pytest.mark.parametrize(
    ("driver", "latency"),
    [
        ("built_in", ZERO_LATENCY),
        ("constant_velocity", ZERO_LATENCY),
        ("constant_velocity", Latency(0.5)),
    ],
)
def test_a_vut_that_turns_as_its_lane_does_stays_in_it(
    start_of: Callable[[str], Start],
    turned_on: Callable[[str], DriverRun],
    site: str,
    driver: str,
    latency: Latency,
) -> None:
    start = start_of(site)
    if driver == "built_in":
        drove = turned_on(site)
    else:
        drove = drive_start(start, CampaignDriver(driver=driver), latency, event=False)
    assert drove.outcome.kind == "avoided", drove.outcome.why
    led = until(drove.record.reports, start.hand_over_s, start.end_s)
    assert outside_m(start, led) < 0.0


def outside_m(start: Start, led: Sequence[StepReport]) -> float:
    """Return how far a corner of the VUT comes out of its lane at the most."""
    corners = [corner for report in led for corner in vut_of(report).box.corners()]
    line = ReferenceLine.of_road(start.run.road)
    (lane,) = start.run.road.lanes
    offsets = line.to_local_many(np.array(corners))[:, 1] - lane.y_m
    return float(np.abs(offsets).max()) - lane.width_m / 2.0


@pytest.mark.parametrize("site", LEFT_TURNS)
def test_a_swing_out_of_the_lane_within_the_junction_stays_on_the_road(
    start_of: Callable[[str], Start], turned_on: Callable[[str], DriverRun], site: str
) -> None:
    """The way leads over connecting roads and the ground that the roads of a junction enclose."""
    start = start_of(site)
    led = until(turned_on(site).record.reports, start.hand_over_s, start.end_s)

    def swung(report: StepReport) -> StepReport:
        vut = vut_of(report)
        out_m = 0.6 * math.sin(2.0 * min(max(vut.yaw_rad, 0.0), math.pi / 2.0))
        x_m, y_m = vut.pose.to_parent(0.0, -out_m)
        return replace(report, truths=(replace(vut, x_m=x_m, y_m=y_m),))

    way = [swung(report) for report in led]
    assert outside_m(start, way) > 0.1
    assert left_road(start.run, way) is None


@pytest.mark.parametrize("site", LEFT_TURNS)
@pytest.mark.parametrize(("inside_m", "leaves"), [(0.5, False), (-0.9, True)])
def test_a_corner_that_is_cut_over_the_grass_is_off_the_road(
    start_of: Callable[[str], Start],
    turned_on: Callable[[str], DriverRun],
    site: str,
    inside_m: float,
    leaves: bool,
) -> None:
    """Past the corner of grass to the north-east, on the road that turns around it or beside."""
    start = start_of(site)
    led = until(turned_on(site).record.reports, start.hand_over_s, start.end_s)[:51]
    mouth_m, edge_m = CORNER_M[site]

    def on_the_way(report: StepReport, along_m: float) -> StepReport:
        vut = vut_of(report)
        right_m = edge_m + inside_m + vut.size.width_m / 2.0
        x_m = -mouth_m + (along_m + right_m) * math.sqrt(0.5)
        y_m = mouth_m + (along_m - right_m) * math.sqrt(0.5)
        moved = replace(vut, x_m=x_m, y_m=y_m, yaw_rad=math.radians(45.0))
        return replace(report, truths=(moved,))

    way = [on_the_way(report, -4.0 + 0.1 * k) for k, report in enumerate(led)]
    fact = left_road(start.run, way)
    if not leaves:
        assert fact is None
        return
    assert fact is not None
    assert fact[1] == "left_road"
    assert fact[2].endswith("beside the carriageway")


def test_a_vut_where_the_road_has_no_coordinates_is_off_the_road(
    start_of: Callable[[str], Start], turned_on: Callable[[str], DriverRun]
) -> None:
    """The VUT is on the grass beyond the middle of the bend, equally far from both arms."""
    start = start_of("crossroads")
    led = until(turned_on("crossroads").record.reports, start.hand_over_s, start.end_s)[:1]
    vut = vut_of(led[0])
    away = replace(vut, x_m=-28.4 - vut.size.front_m, y_m=28.4 - vut.size.width_m / 2, yaw_rad=0.0)
    line = ReferenceLine.of_road(start.run.road)
    assert np.isnan(line.to_local_many(np.array(away.box.corners()))).any()
    fact = left_road(start.run, [replace(led[0], truths=(away,))])
    assert fact is not None
    assert fact[1:] == ("left_road", "a corner where the road has no coordinates")
