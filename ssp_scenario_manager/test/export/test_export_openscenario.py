"""OpenSCENARIO of the four events: valid, within what players take, and as the task says."""

from __future__ import annotations

import importlib.util
import math
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree  # type: ignore[import-untyped]  # it ships no types

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline
from ssp_core.motion.event import RESOLUTION_CONFIRMATION_S
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.participants import (
    ElapsedTime,
    FollowPath,
    RelativeDistance,
    TimeToArrival,
)
from ssp_core.vocabulary import ObjectClass, Phase
from ssp_scenario_manager.compile.targets.foreseen import PLAYER_LAG_S
from ssp_scenario_manager.compile.targets.openscenario import ACT_DELAY_S, export_openscenario
from ssp_scenario_manager.compile.targets.player import play
from ssp_scenario_manager.compile.targets.ramps import legs, matched
from ssp_scenario_manager.compile.task import PlaceLink, Task, sealed
from ssp_scenario_manager.run.feasibility import driven
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Where roads cross: test_maps_crossing_car.py.
EVENTS = tuple(sorted(name for name, kind in KINDS.items() if not kind.at_junction))
# The others write nothing on a bend that these don't.
ON_A_BEND = ("cut_in", "occluded_crossing")


def package_file(package: str, relative: str) -> Path:
    """A file of an installed package, which need not be importable."""
    spec = importlib.util.find_spec(package)
    assert spec is not None, f"{package} is not installed"
    assert spec.submodule_search_locations is not None
    return Path(next(iter(spec.submodule_search_locations))) / relative


@pytest.fixture(scope="module")
def xsd() -> etree.XMLSchema:
    """The standard's schema of version 1.0."""
    return etree.XMLSchema(
        etree.parse(package_file("qc_openscenario", "schema/1.0.0/OpenSCENARIO.xsd"))
    )


def need(element: ET.Element, path: str) -> ET.Element:
    """The element at a path, which must be there."""
    found = element.find(path)
    assert found is not None, path
    return found


_MADE: dict[str, dict[str, bytes]] = {}


def exported(case: Any, folder: Path) -> dict[str, bytes]:
    """The files of a case by their names; each case is exported once, to a new folder."""
    version = case.task.version
    if version not in _MADE:
        files = export_openscenario(case.task, case.block, None, folder)
        _MADE[version] = {file.name: file.read_bytes() for file in files}
    return _MADE[version]


def written(case: Any, folder: Path, external: bool = False) -> ET.Element:
    """The scenario of a case."""
    return ET.fromstring(list(exported(case, folder).values())[external])


def changed(case: Any, **fields: Any) -> Task:
    """The case's task with fields of its run changed."""
    return sealed(case.task.model_copy(update={"run": case.task.run.model_copy(update=fields)}))


@pytest.mark.parametrize(
    ("name", "bent"),
    [*((name, False) for name in EVENTS), *((name, True) for name in ON_A_BEND)],
)
def test_is_valid_openscenario_1_0(
    name: str, bent: bool, case_of: Any, curved_block: Any, xsd: Any, tmp_path: Path
) -> None:
    case = case_of(name, curved_block if bent else None)
    files = exported(case, tmp_path)
    assert list(files) == [f"{name}.xosc", f"{name}_external.xosc", "made_here.xodr"]
    for data in list(files.values())[:2]:
        document = etree.ElementTree(etree.fromstring(data))
        assert xsd.validate(document), xsd.error_log
        header = document.getroot().find("FileHeader")
        assert (header.get("revMajor"), header.get("revMinor")) == ("1", "0")


def test_the_header_names_event_compiler_and_seed(case_of: Any, tmp_path: Path) -> None:
    case = case_of("cut_in")
    header = need(written(case, tmp_path), "FileHeader")
    text = header.get("description", "")
    for part in (case.task.event.version, case.task.version, "compiler ssp 0.1.0", "seed 7"):
        assert part in text
    # ScenarioRunner takes a description with this prefix for left-handed coordinates.
    assert not text.startswith("CARLA:")
    logic = need(written(case, tmp_path), "RoadNetwork/LogicFile")
    assert logic.get("filepath") == "made_here.xodr"


@pytest.mark.parametrize("name", ON_A_BEND)
def test_participants_stand_where_and_as_what_the_run_says(
    name: str, case_of: Any, curved_block: Any, tmp_path: Path
) -> None:
    case = case_of(name, curved_block)
    root = written(case, tmp_path)
    run = case.task.run
    for who in (run.vut, *run.targets):
        private = need(root, f"Storyboard/Init/Actions/Private[@entityRef='{who.id}']")
        place = need(private, ".//WorldPosition")
        assert float(place.get("x", "")) == who.start.x_m
        assert float(place.get("y", "")) == who.start.y_m
        assert float(place.get("h", "")) == who.start.yaw_rad
        speed = need(private, ".//AbsoluteTargetSpeed")
        assert float(speed.get("value", "")) == 0.0
        thing = need(root, f"Entities/ScenarioObject[@name='{who.id}']")
        box, centre = need(thing, ".//Dimensions"), need(thing, ".//Center")
        size = DEFAULT_SIZES[ObjectClass.from_word(who.object_class)]
        assert float(box.get("length", "")) == size.front_m + size.rear_m
        assert float(box.get("width", "")) == size.width_m
        # The box reaches from rear_m behind the origin to front_m ahead of it.
        reach = float(centre.get("x", "")) + float(box.get("length", "")) / 2
        assert reach == pytest.approx(size.front_m)
        assert float(centre.get("z", "")) == size.height_m / 2
        kind = "Pedestrian" if who.object_class == "pedestrian" else "Vehicle"
        element = need(thing, kind)
        blueprint = element.get("model" if kind == "Pedestrian" else "name", "")
        assert blueprint.startswith("walker." if kind == "Pedestrian" else "vehicle.")
        role = need(thing, ".//Property[@name='type']")
        assert role.get("value") == ("ego_vehicle" if who.id == "vut" else "simulation")


def test_the_occluder_only_stands(case_of: Any, tmp_path: Path) -> None:
    root = written(case_of("occluded_crossing"), tmp_path)
    thing = need(root, "Entities/ScenarioObject[@name='ot2']/Vehicle")
    assert thing.get("vehicleCategory") == "truck"
    actors = {e.get("entityRef") for e in root.iterfind(".//Actors/EntityRef")}
    assert actors == {"vut", "ot1"}


def trigger_of(root: ET.Element) -> ET.Element:
    return need(root, ".//Event[@name='manoeuvre']/StartTrigger/ConditionGroup/Condition")


def test_a_distance_fires_on_the_bumper_gap_to_the_object(case_of: Any, tmp_path: Path) -> None:
    case = case_of("cut_in")
    condition = trigger_of(written(case, tmp_path))
    asked = case.task.run.triggers[0].condition
    assert isinstance(asked, RelativeDistance)
    distance = need(condition, ".//RelativeDistanceCondition")
    assert distance.attrib == {
        "entityRef": "ot1",
        "relativeDistanceType": "longitudinal",
        "freespace": "true",
        "rule": "lessThan",
        "value": str(asked.below_m),
    }
    entity = need(condition, ".//TriggeringEntities/EntityRef")
    assert entity.get("entityRef") == "vut"


def test_an_arrival_fires_when_the_vuts_front_is_that_near(
    case_of: Any, curved_block: Any, tmp_path: Path
) -> None:
    case = case_of("vru_crossing", curved_block)
    condition = trigger_of(written(case, tmp_path))
    asked = case.task.run.triggers[0].condition
    assert isinstance(asked, TimeToArrival)
    arrival = need(condition, ".//TimeToCollisionCondition")
    assert float(arrival.get("value", "")) == asked.below_s
    assert (arrival.get("rule"), arrival.get("freespace")) == ("lessThan", "false")
    place = need(arrival, ".//WorldPosition")
    s, offset = case.block.line.to_local(float(place.get("x", "")), float(place.get("y", "")))
    # The anchor is at s = 110; the reference point is the front overhang behind the front.
    assert s == pytest.approx(110.0 - DEFAULT_SIZES[ObjectClass.CAR].front_m, abs=0.01)
    assert offset == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("name", sorted(set(EVENTS) - {"slow_lead"}))
def test_a_trigger_fires_once_on_no_edge_and_its_act_begins_later(
    name: str, case_of: Any, tmp_path: Path
) -> None:
    case = case_of(name)
    root = written(case, tmp_path)
    condition = trigger_of(root)
    spec = case.task.run.triggers[0]
    # 0.1 s of lead time, and half of what a straight ramp comes before a rounded one.
    assert spec.lead_time_s + 0.1 == ACT_DELAY_S
    has_ramp = name != "cut_out"
    delay_s = ACT_DELAY_S if has_ramp else spec.lead_time_s
    assert float(condition.get("delay", "")) == delay_s
    assert condition.get("conditionEdge") == "none"
    event = need(root, ".//Event[@name='manoeuvre']")
    assert event.get("maximumExecutionCount") == "1"
    act = need(root, ".//Act[@name='act_manoeuvre']/StartTrigger//SimulationTimeCondition")
    assert (float(act.get("value", "")), act.get("rule")) == (spec.not_before_s, "greaterThan")


def test_what_holds_is_sent_nothing_and_drives_beside_the_middle(
    case_of: Any, tmp_path: Path
) -> None:
    case = case_of("slow_lead")
    root = written(case, tmp_path)
    assert [act.get("name") for act in root.iter("Act")] == ["approach"]
    scenario, _, chart = exported(case, tmp_path).values()
    played = play(scenario, chart, case.block.line)
    assert np.ptp(played["ot1"][:, 2]) < 0.01
    assert played["ot1"][-1, 2] == pytest.approx(case.task.run.targets[0].start.y_m, abs=0.01)


def test_what_only_stands_is_told_to_stand_where_the_vut_is_the_users(
    case_of: Any, xsd: Any, tmp_path: Path
) -> None:
    """A story of OpenSCENARIO has an act at least."""
    case = case_of("slow_lead")
    run = case.task.run
    (lead,) = run.targets
    stands = changed(case, targets=[lead.model_copy(update={"approach": None})])
    for file in export_openscenario(stands, case.block, None, tmp_path)[:2]:
        document = etree.parse(file)
        assert xsd.validate(document), xsd.error_log
        acts = [act.get("name") for act in document.iter("Act")]
        assert acts == (["act_stands"] if "external" in file.name else ["approach"])


def test_a_lane_change_goes_one_lane_right_over_the_distance_of_its_time(
    case_of: Any, tmp_path: Path
) -> None:
    root = written(case_of("cut_in"), tmp_path)
    event = need(root, ".//Event[@name='manoeuvre']")
    target = need(event, ".//RelativeTargetLane")
    dynamics = need(event, ".//LaneChangeActionDynamics")
    assert target.attrib == {"value": "-1", "entityRef": "ot1"}
    assert dynamics.get("dynamicsDimension") == "distance"
    # 8.5 to 5.5 m/s at 2 m/s^2 takes 1.5 s, and longer with the lag of a session.
    slower = float(need(event, ".//SpeedActionDynamics").get("value", ""))
    assert 1.5 < slower < 2.4
    way_m = slower * 7.0 + (2.4 - slower) * 5.5
    assert float(dynamics.get("value", "")) == pytest.approx(way_m)


def test_a_braking_lasts_as_long_as_in_a_session(case_of: Any, tmp_path: Path) -> None:
    root = written(case_of("lead_braking"), tmp_path)
    event = need(root, ".//Event[@name='manoeuvre']")
    dynamics, target = need(event, ".//SpeedActionDynamics"), need(event, ".//AbsoluteTargetSpeed")
    assert float(target.get("value", "")) == 2.0
    # 1.75 s by its deceleration, longer with the lag of a session.
    assert 1.75 < float(dynamics.get("value", "")) < 2.25
    assert event.find(".//LateralAction") is None


def test_a_walk_follows_its_path_and_stops_at_its_end(case_of: Any, tmp_path: Path) -> None:
    case = case_of("vru_crossing")
    root = written(case, tmp_path)
    walk = case.task.run.triggers[0].manoeuvre
    assert isinstance(walk, FollowPath)
    vertices = root.findall(".//Event[@name='manoeuvre']//Vertex")
    places = [need(v, ".//WorldPosition") for v in vertices]
    points = [(float(p.get("x", "")), float(p.get("y", ""))) for p in places]
    assert points == walk.motion.path
    length = math.dist(points[0], points[-1])
    # 1 s up to 1.5 m/s and 1 s down, each over 0.75 m.
    times = [float(v.get("time", "")) for v in vertices]
    assert times == pytest.approx([0.0, 2.0 + (length - 1.5) / 1.5])
    speed = need(root, ".//Event[@name='manoeuvre']//AbsoluteTargetSpeed")
    assert float(speed.get("value", "")) == 1.5
    stop = need(root, ".//Event[@name='manoeuvre_stop']")
    begins = need(stop, ".//TraveledDistanceCondition")
    still = need(stop, ".//AbsoluteTargetSpeed")
    assert float(begins.get("value", "")) == pytest.approx(length - 0.75)
    assert float(still.get("value", "")) == 0.0


def test_a_target_speeds_up_as_planned_before_the_trigger(case_of: Any, tmp_path: Path) -> None:
    root = written(case_of("cut_in"), tmp_path)
    event = need(root, ".//Event[@name='ot1_approach']")
    assert float(need(event, ".//AbsoluteTargetSpeed").get("value", "")) == 8.5
    ramp_s = float(need(event, ".//SpeedActionDynamics").get("value", ""))
    assert ramp_s == pytest.approx(4.25, abs=0.05)
    # A target's reference begins 0.5 s after the start; its rounded ramp lags by 0.2 s.
    begins = need(event, ".//SimulationTimeCondition")
    assert float(begins.get("value", "")) == pytest.approx(0.7 - PLAYER_LAG_S)


def vut_speeds(root: ET.Element) -> list[tuple[float, float]]:
    """(t, v) at the ends of the VUT's ramps, which must follow one another without a gap."""
    course = [(0.0, 0.0)]
    for event in root.iterfind(".//Maneuver[@name='maneuver_vut_drive']/Event"):
        start = float(need(event, ".//SimulationTimeCondition").get("value", ""))
        assert start == pytest.approx(max(0.0, course[-1][0] - PLAYER_LAG_S))
        dynamics = need(event, ".//SpeedActionDynamics")
        assert dynamics.get("dynamicsShape") == "linear"
        speed = float(need(event, ".//AbsoluteTargetSpeed").get("value", ""))
        course.append((course[-1][0] + float(dynamics.get("value", "")), speed))
    return course


def speed_at(course: list[tuple[float, float]], t_s: float) -> float:
    for (t0, v0), (t1, v1) in pairwise(course):
        if t0 <= t_s <= t1:
            return v0 + (v1 - v0) * (t_s - t0) / (t1 - t0)
    return course[-1][1]


@pytest.mark.parametrize("name", EVENTS)
def test_the_vut_drives_slows_and_waits_as_in_a_session(
    name: str, case_of: Any, tmp_path: Path
) -> None:
    """So that it passes who crosses as late as a session's does."""
    run = case_of(name).task.run
    course = vut_speeds(written(case_of(name), tmp_path))
    result, record = driven(run)
    assert result.ok
    path = Polyline(run.vut.approach.path)
    station, t_s = 0.0, 0.0
    for state in record.truths("vut"):
        now_s = state.stamp_ns / 1e9
        if now_s > course[-1][0]:
            break
        station += 0.5 * (speed_at(course, t_s) + speed_at(course, now_s)) * (now_s - t_s)
        t_s = now_s
        assert station == pytest.approx(path.project(state.x_m, state.y_m)[0], abs=0.06)
    resolution_s = result.phase_s(Phase.RESOLUTION)
    assert resolution_s is not None
    assert t_s > resolution_s + run.end.after_resolution_s


def test_nothing_is_written_of_a_task_that_never_fires(case_of: Any, tmp_path: Path) -> None:
    case = case_of("cut_in")
    condition = case.task.run.triggers[0].condition.model_copy(update={"below_m": 0.001})
    trigger = case.task.run.triggers[0].model_copy(update={"condition": condition})
    task = changed(case, triggers=[trigger])
    with pytest.raises(InputError, match="never fires"):
        export_openscenario(task, case.block, None, tmp_path)
    assert list(tmp_path.iterdir()) == []


courses = st.lists(st.floats(0.0, 30.0), min_size=2, max_size=60)


@given(courses, st.floats(0.01, 2.0))
def test_legs_leave_a_course_by_at_most_the_error(speeds: list[float], error: float) -> None:
    course = [(0.05 * i, v) for i, v in enumerate(speeds)]
    found = legs(course, error)
    told = [course[0], *((leg.start_s + leg.change.duration_s, leg.change.to_mps) for leg in found)]
    assert [leg.start_s for leg in found] == pytest.approx([t for t, _ in told[:-1]])
    for t, v in course:
        # Speeds are rounded to a millimetre per second.
        assert speed_at(told, t) == pytest.approx(v, abs=error + 0.001)


@given(st.floats(0.5, 3.0), st.floats(8.0, 20.0))
def test_legs_of_a_bending_course_drive_its_distance(rate: float, top: float) -> None:
    """Chords of a rising course lie below it all the while."""
    course = [(0.02 * i, top * (1.0 - math.exp(-rate * 0.02 * i / top))) for i in range(1000)]
    driven_m = [0.0]
    for (_, v0), (_, v1) in pairwise(course):
        driven_m.append(driven_m[-1] + 0.01 * (v0 + v1))
    told, way_m = [course[0]], 0.0
    for leg in matched(legs(course), course, driven_m):
        end = leg.start_s + leg.change.duration_s
        way_m += 0.5 * leg.change.duration_s * (told[-1][1] + leg.change.to_mps)
        told.append((end, leg.change.to_mps))
    assert way_m == pytest.approx(driven_m[-1], abs=0.03)
    assert all(abs(speed_at(told, t) - v) < 0.1 for t, v in course)


@pytest.mark.parametrize("external", [False, True])
def test_everything_ends_as_a_session_does(external: bool, case_of: Any, tmp_path: Path) -> None:
    """The run ends at the VUT's goal, when time is up, or some time after a known resolution."""
    case = case_of("cut_in")
    end = case.task.run.end.model_copy(update={"after_resolution_s": 2.5})
    files = export_openscenario(changed(case, end=end), case.block, None, tmp_path)
    root = ET.parse(files[external]).getroot()
    resolution_s = driven(case.task.run)[0].phase_s(Phase.RESOLUTION)
    assert resolution_s is not None
    over_s = resolution_s + RESOLUTION_CONFIRMATION_S + 2.5
    stops = [need(root, "Storyboard/StopTrigger"), *root.iterfind(".//Act/StopTrigger")]
    assert len(stops) == 3
    for stop in stops:
        # Each condition is a group of its own, of which one suffices.
        (driven_m,) = stop.iterfind("ConditionGroup//TraveledDistanceCondition")
        # 370 m of route less the 42.25 m that it takes to stop from 13 m/s at 2 m/s^2.
        assert float(driven_m.get("value", "")) == pytest.approx(370.0 - 42.25)
        times = stop.findall("ConditionGroup//SimulationTimeCondition")
        told = [float(t.get("value", "")) for t in times]
        assert told == ([40.0] if external else [40.0, pytest.approx(over_s)])
        assert len(stop.findall("ConditionGroup")) == 1 + len(times)


def test_the_vut_is_the_users_in_the_external_file(case_of: Any, tmp_path: Path) -> None:
    root = written(case_of("vru_crossing"), tmp_path, external=True)
    assert "vut" not in {e.get("entityRef") for e in root.iterfind(".//Actors/EntityRef")}
    controller = need(
        root, "Storyboard/Init/Actions/Private[@entityRef='vut']//AssignControllerAction/Controller"
    )
    properties = {p.get("name"): p.get("value") for p in controller.iter("Property")}
    assert properties == {"module": "external_control", "esminiController": "ExternalController"}
    overrides = need(root, ".//OverrideControllerValueAction")
    assert len(overrides) == 6
    assert {o.get("active") for o in overrides} == {"false"}


def test_sun_and_fog_are_those_of_the_run(case_of: Any, tmp_path: Path) -> None:
    case = case_of("cut_in")
    look = case.task.run.look.model_copy(
        update={"sun_azimuth_deg": 90.0, "sun_elevation_deg": 30.0, "fog_per_m": 0.01}
    )
    task = changed(case, look=look)
    files = export_openscenario(task, case.block, None, tmp_path)
    root = ET.parse(files[0]).getroot()
    sun, fog = need(root, ".//Sun"), need(root, ".//Fog")
    # Counter-clockwise from east is north here, and 0 there.
    assert float(sun.get("azimuth", "")) == pytest.approx(0.0)
    assert float(sun.get("elevation", "")) == pytest.approx(math.pi / 6)
    assert float(fog.get("visualRange", "")) == pytest.approx(math.log(20.0) / 0.01)


def test_a_users_map_goes_along_as_it_is(case_of: Any, tmp_path: Path) -> None:
    place = PlaceLink(kind="opendrive", name="maps/Town99.xodr", sha256="sha256:map")
    case = case_of("vru_crossing", None, "openscenario", place)
    text = "<OpenDRIVE>\n  <!-- Ä -->\n</OpenDRIVE>"
    files = export_openscenario(case.task, case.block, text, tmp_path)
    assert files[2].name == "Town99.xodr"
    assert files[2].read_bytes() == text.encode()
    logic = need(ET.parse(files[0]).getroot(), "RoadNetwork/LogicFile")
    assert logic.get("filepath") == "Town99.xodr"
    with pytest.raises(InputError, match="needs the map"):
        export_openscenario(case.task, case.block, None, tmp_path)


@pytest.mark.parametrize(
    "change",
    [
        {"held_for_s": 0.2},
        {"edge": "rising"},
        {"condition": ElapsedTime(type="elapsed_time", after_s=4.5)},
    ],
)
def test_a_trigger_that_no_compiler_makes_is_a_bug(
    change: Any, case_of: Any, tmp_path: Path
) -> None:
    case = case_of("cut_in")
    task = changed(case, triggers=[case.task.run.triggers[0].model_copy(update=change)])
    with pytest.raises(ValueError, match="no compiled trigger"):
        export_openscenario(task, case.block, None, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_same_task_gives_the_same_bytes(case_of: Any, tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    two = ("cut_in", "vru_crossing")
    for folder, order in ((first, two), (second, two[::-1])):
        for name in order:
            case = case_of(name)
            export_openscenario(case.task, case.block, None, folder)
    names = sorted(p.name for p in first.iterdir())
    assert len(names) == 2 * len(two) + 1
    for name in names:
        if name.endswith(".xosc"):
            assert (first / name).read_bytes() == (second / name).read_bytes()
