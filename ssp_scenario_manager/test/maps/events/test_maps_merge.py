"""The event merge: over which roads it leads, what it needs, and that it happens."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.vocabulary import Verdict
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.compile.task import sealed
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.events.merge import ramps
from tests.support.events.junctions import ground, made, route, site_without_junction
from tests.support.simulated_once import run_once

MAIN = "junction entry: west_in > west_east lanes[0] > east_out"


def event(object_class: str = "car", **constraints: Any) -> Event:
    """The shipped event, with an object of a class and parts of C changed."""
    value = load_event("merge")[0].model_dump(mode="json", by_alias=True)
    value["participants"]["ot1"]["class"] = object_class
    if "trigger" in constraints:
        value["participants"]["ot1"]["region"]["gap"] = {"min": 5, "max": 200, "unit": "m"}
    for name, given in constraints.items():
        value["constraints"][name] |= given
    return Event.model_validate(value)


def test_the_vut_doesnt_come_over_the_ramp_itself() -> None:
    area = ground("entry")
    ramp = route(area, "junction entry: ramp_in > ramp_east lanes[0] > east_out")
    shipped = event()
    from_left = {"dominant_motion": "cutting_in_from_left"}
    interaction = shipped.interaction.model_copy(update=from_left)
    left = shipped.model_copy(update={"interaction": interaction})
    said = "turns by 0 deg, and the VUT by 20 deg: the VUT would come over the ramp"
    with pytest.raises(CannotPlace, match=said):
        ramps(left, ramp, area.routes_with(ramp))


@pytest.mark.parametrize(
    ("object_class", "site"),
    [("car", "entry"), ("truck", "entry_track"), ("motorcycle", "entry_track")],
)
def test_it_runs_valid_over_the_ramp_into_the_lane(object_class: str, site: str) -> None:
    area = ground(site)
    run = made(event(object_class), area, MAIN).task.run.model_copy(update={"camera": None})
    result, record = run_once(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert (result.passing.relation, result.passing.other_first) == ("merge", True)
    known = {block.block_id: block for block in area.library.blocks}
    track = np.array([(s.x_m, s.y_m) for s in record.truths("ot1")])
    (lane,) = known["east_out"].forward_lanes
    for name, lane_m in (("ramp_east", 0.0), ("east_out", lane.y_m)):
        local = known[name].line.to_local_many(track)
        there = local[(local[:, 0] > 0.0) & (local[:, 0] < known[name].length_m)]
        assert len(there) > 20
        assert np.abs(there[:, 1] - lane_m).max() < 0.2
    # A VUT that keeps its speed drives into it.
    steady = run.driver.model_copy(update={"reacts": False})
    result, _ = run_once(run.model_copy(update={"driver": steady}))
    assert any("collision: ot1" in reason for reason in result.reasons)


def test_it_waits_before_the_junction_on_the_ramp() -> None:
    area = ground("entry")
    found = made(event(), area, MAIN)
    (car,) = found.task.run.targets
    ramp = {block.block_id: block for block in area.library.blocks}["ramp_in"]
    s_m, l_m = ramp.line.to_local(car.start.x_m, car.start.y_m)
    assert car.approach is None
    assert l_m == pytest.approx(0.0, abs=1e-3)
    chosen = {tuning.field: tuning.value for tuning in found.task.tunings}
    front_m = ramp.length_m - s_m - car.size.front_m
    assert front_m == pytest.approx(chosen["constraints.manoeuvre.line_distance"], abs=0.01)
    assert car.start.yaw_rad == pytest.approx(math.radians(20.0), abs=1e-6)
    # The gap at the start is up to its rear.
    assert chosen["participants.ot1.region.gap"] == pytest.approx(
        car.start.x_m
        - car.size.rear_m
        - found.task.run.vut.start.x_m
        - found.task.run.vut.size.front_m,
        abs=2.0,
    )


@pytest.mark.parametrize(
    ("wanted", "site", "name", "said"),
    [
        (
            event(),
            "crossroads",
            "junction market: west_in > west_east lanes[0] > east_out",
            r"0 of 1 routes that join it from the right .*; one comes at 8\d deg, limit 45 deg",
        ),
        (
            event(),
            "entry",
            "junction entry: east_in > east_west lanes[0] > west_out",
            "0 of 0 routes that join it from the right",
        ),
        (event(), "entry", "west_in", "it leads over no connecting road of a junction"),
        (
            event(trigger={"below": {"min": 2, "max": 2, "unit": "s"}}),
            "entry",
            MAIN,
            r"ot1 wouldn't reach the conflict point first: after the trigger ot1 takes [\d.]+ s",
        ),
        (
            event(
                manoeuvre={"merging_speed": {"min": 12, "max": 14, "unit": "m/s"}},
                speeds={
                    "ot1": {
                        phase: {"min": 0, "max": 14, "unit": "m/s"}
                        for phase in ("trigger", "conflict", "resolution")
                    }
                },
            ),
            "entry",
            MAIN,
            "merging_speed must be within 12 and 14 m/s; the place allows 0 to 8.9 m/s",
        ),
    ],
)
def test_what_doesnt_fit_is_refused_with_its_quantity(
    wanted: Event, site: str, name: str, said: str
) -> None:
    with pytest.raises(CannotPlace, match=said):
        made(wanted, ground(site), name)


def test_deleting_the_junction_refuses_it(tmp_path: Path) -> None:
    path = site_without_junction("entry", tmp_path)
    with pytest.raises(NoBlockChosen, match="segment straight, needs junction"):
        compile_task(Request(event="merge", target="sumo", site=str(path)))


def test_openscenario_plays_it_on_a_map_that_has_the_ramp(tmp_path: Path) -> None:
    """The export plays itself: the gap to the car is the session's to 0.3 m, else it refuses."""
    found = made(event(), ground("entry_track"), MAIN)
    task = sealed(found.task.model_copy(update={"target": "openscenario", "chosen_by": "score"}))
    export_openscenario(task, found.block, None, tmp_path)
    library = load_library(tmp_path / "entry_track.xodr")
    (car,) = task.run.targets
    found_lanes = []
    for block in library.blocks:
        s_m, l_m = block.line.to_local_many(np.array([(car.start.x_m, car.start.y_m)]))[0]
        if 0.0 <= s_m <= block.length_m:
            found_lanes += [x for x in block.forward_lanes if abs(x.y_m - l_m) < 0.01]
    assert found_lanes
