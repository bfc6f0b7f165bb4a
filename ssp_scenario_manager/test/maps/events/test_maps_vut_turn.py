"""The event vut_turn: over which roads it leads, what it needs, and what decides wait or go."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.geometry import Polyline
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import corridor_half_m, swept_on_way
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TimeToArrival
from ssp_core.vocabulary import Verdict
from ssp_core.world.gap_acceptance import PriorityWatch
from ssp_ot_controller.sil.vut_driver import VutDriver
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.targets.carla import export_carla
from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.site import find_shipped
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.scenarios.base import CannotPlace
from tests.support.events.junctions import LEFT_TURN, STRAIGHT, ground, made, site_without_junction
from tests.support.events.played import shown
from tests.support.simulated_once import run_once

TEE = "junction tee: west_in > west_north lanes[0] > north_out"


def event(object_class: str = "car", **constraints: Any) -> Event:
    """The shipped event, its vehicle of a class, with parts of C changed."""
    value = load_event("vut_turn")[0].model_dump(mode="json", by_alias=True)
    value["participants"]["ot1"]["class"] = object_class
    if constraints:
        value["participants"]["ot1"]["region"]["gap"] = {"min": 5, "max": 200, "unit": "m"}
    for name, given in constraints.items():
        value["constraints"][name] |= given
    return Event.model_validate(value)


def run_on(site: str, name: str = TEE, object_class: str = "car") -> RunSpec:
    task = made(event(object_class), ground(site), name).task
    return task.run.model_copy(update={"camera": None})


@pytest.mark.parametrize(
    ("object_class", "site", "name"),
    [
        ("car", "tee", TEE),
        ("motorcycle", "tee_track", TEE),
        ("car", "crossroads", LEFT_TURN),
        ("truck", "cross_track", LEFT_TURN),
    ],
)
def test_it_runs_valid_and_the_vut_turns_behind_the_vehicle(
    object_class: str, site: str, name: str
) -> None:
    run = run_on(site, name, object_class)
    result, record = run_once(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert result.passing.relation == "crossing"
    assert result.passing.other_first
    # It has turned before the recording ends, so that all is measured from what it drove.
    first, *_, last = record.truths("vut")
    assert abs(last.yaw_rad - first.yaw_rad) > 0.8


def test_a_vut_that_does_not_react_hits_it() -> None:
    run = run_on("tee")
    steady = run.driver.model_copy(update={"reacts": False})
    result, _ = run_in_process(run.model_copy(update={"driver": steady}))
    assert any("collision: ot1" in reason for reason in result.reasons)


def shifted(run: RunSpec, shift_s: float) -> RunSpec:
    """The run with a vehicle that drives off so much later, and no order that is to be kept."""
    (trigger,) = run.triggers
    condition = trigger.condition
    assert isinstance(condition, TimeToArrival)
    condition = condition.model_copy(update={"below_s": condition.below_s - shift_s})
    moved = trigger.model_copy(update={"condition": condition, "not_before_s": 0.0})
    return run.model_copy(update={"triggers": [moved], "passing": None})


@pytest.mark.parametrize(
    ("shift_s", "words", "other_first"),
    [
        (-2.0, ["approach", "go"], True),
        (0.0, ["approach", "wait", "yield", "go"], True),
        (2.0, ["approach", "wait", "go"], True),
        (5.0, ["approach", "go"], False),
    ],
)
def test_a_shift_of_the_vehicle_by_two_seconds_changes_what_the_vut_does(
    shift_s: float, words: list[str], other_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[str] = []
    decide = PriorityWatch.decide

    def noted(self: PriorityWatch, *given: Any) -> Any:
        decision = decide(self, *given)
        heard.extend(w for w in self.words if heard[-1:] != [w])
        return decision

    run = shifted(run_on("tee"), shift_s)
    monkeypatch.setattr(PriorityWatch, "decide", noted)
    result, _ = run_in_process(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert heard[: len(words)] == words
    assert result.passing.other_first is other_first
    assert result.min_distance_m > 0.5


def test_it_gives_way_where_both_corridors_cross() -> None:
    """Each zone is what the other one sweeps of a corridor, by another way around."""
    run = run_on("tee")
    (place,) = run.driver.gives_way
    assert run.vut.approach is not None
    own, other = Polyline(run.vut.approach.path), Polyline(place.priority_path)
    half_m = corridor_half_m(run.vut.size.width_m)
    poses = [other.pose(0.1 * k) for k in range(int(10.0 * other.length_m))]
    assert place.zone_m == pytest.approx(swept_on_way(poses, run.vut.size, own, half_m), abs=0.1)
    assert place.line_m == pytest.approx(place.zone_m[0] - 1.0)
    assert VutDriver(run).priority_words == ("approach",)


@pytest.mark.parametrize(
    ("wanted", "site", "name", "words"),
    [
        (event(), "crossroads", STRAIGHT, "it turns by 0 deg in the junction; the VUT turns left"),
        (
            event(),
            "tee",
            "junction tee: north_in > north_east lanes[0] > east_out",
            "0 routes of its junction come the opposite way and go straight on across it",
        ),
        (
            event(trigger={"below": {"min": 1.0, "max": 2.0, "unit": "s"}}),
            "tee",
            TEE,
            "wouldn't reach the conflict point first",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_what_misses(
    wanted: Event, site: str, name: str, words: str
) -> None:
    with pytest.raises(CannotPlace, match=re.escape(words)):
        made(wanted, ground(site), name)


def tee_with_a_turn_of(radius_m: float, folder: Path) -> str:
    """A site file like tee, whose left turn from the west is straight before and after a bend."""
    value = yaml.safe_load(find_shipped("tee", "site").read_text())
    (turn,) = (block for block in value["blocks"] if block["id"] == "west_north")
    # It ends in the lane 1.75 m to the right of the middle of the arm, which is at x = 0.
    side_m, bent_1pm = 1.75 - turn["origin"]["x_m"] - radius_m, 1.0 / radius_m
    arc = {"start_curvature_1pm": bent_1pm, "end_curvature_1pm": bent_1pm}
    turn["pieces"] = [
        {"length_m": side_m},
        {"length_m": 0.5 * math.pi * radius_m} | arc,
        {"length_m": side_m},
    ]
    path = folder / "town.site.yaml"
    path.write_text(yaml.safe_dump(value))
    return str(path)


def test_it_compiles_on_a_turn_as_tight_as_those_of_towns(tmp_path: Path) -> None:
    """The left turns of esmini's and CARLA's towns have radii of 7.6 to 10 m."""
    site = tee_with_a_turn_of(7.6, tmp_path)
    assert compile_task(Request(event="vut_turn", target="sumo", site=site)).task.block.id == TEE


def test_without_the_junction_nothing_compiles(tmp_path: Path) -> None:
    site = site_without_junction("tee", tmp_path)
    with pytest.raises(NoBlockChosen) as caught:
        compile_task(Request(event="vut_turn", target="sumo", site=str(site)))
    scores = caught.value.scores
    assert all("needs junction" in " ".join(score.reasons) for score in scores)


@pytest.mark.parametrize("site", ["tee", "tee_track"])
def test_openscenario_plays_it(site: str, tmp_path: Path) -> None:
    """The VUT follows its way of the session, whose cut of the turn moves the conflict zone.

    No other route of the site is one that the event can take.
    """
    task = compile_task(Request(event="vut_turn", target="openscenario", site=site)).task
    assert task.block.id == TEE
    found = made(event(), ground(site), TEE)
    export = shown(task, found.block, tmp_path)
    assert export.apart_m() < 0.3
    assert export.gap_differs_s(Corridor.of) == pytest.approx(0.0, abs=0.05)


def test_an_export_leads_the_vut_over_its_turn(tmp_path: Path) -> None:
    """A player drives straight on over a map's junction, unless the scenario has the VUT's way."""
    task = compile_task(Request(event="vut_turn", target="openscenario", site="tee")).task
    block = made(event(), ground("tee"), TEE).block
    files = export_openscenario(task, block, None, tmp_path)
    ways = [
        [
            (float(at.attrib["x"]), float(at.attrib["y"]))
            for group in ET.parse(file).iterfind(".//ManeuverGroup")
            if group.find("Actors/EntityRef[@entityRef='vut']") is not None
            for at in group.iterfind(".//FollowTrajectoryAction//WorldPosition")
        ]
        for file in files[:2]
    ]
    along_m, beside_m = block.line.to_local_many(ways[0]).T
    assert abs(beside_m).max() < 0.1
    assert block.passage is not None
    assert along_m[0] < block.passage.start_s_m < block.passage.end_s_m < along_m[-1]
    # The user drives it in the other file.
    assert ways[1] == []


@pytest.mark.carla
@pytest.mark.parametrize("site", ["tee", "tee_track"])
def test_carla_finds_the_lane_that_the_vehicle_leaves_by(site: str, tmp_path: Path) -> None:
    """The check against CARLA's own reading of the map passes, else the export is refused."""
    found = compile_task(Request(event="vut_turn", target="carla", site=site))
    block, plan = found.realisation.block, found.realisation.plan
    files = export_carla(found.task, block, plan, None, tmp_path)
    names = {road.attrib["name"] for road in ET.parse(files[1]).iterfind("road")}
    # The route, the three connecting roads off it, and the arms.
    assert len(names) == 7
    assert {"tee 6", "tee 7", "tee 8"} <= names
