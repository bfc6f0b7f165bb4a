"""Nothing is written that CARLA's ScenarioRunner doesn't play.

The table was taken from ScenarioRunner's sources, as of September 2025: which elements
``srunner/tools/openscenario_parser.py`` and ``srunner/scenarios/open_scenario.py`` turn into
behaviour, and which attributes they need. What the standard allows and ScenarioRunner refuses or
misreads is left out, such as:

- positions on routes, clothoids and NURBS, visibility, and time gaps;
- a lane change to an absolute lane, and one over a time (its time is taken for no limit);
- AssignRouteAction and AcquirePositionAction, which that version ends with an exception
  (``ChangeActorWaypoints`` is made without times);
- FollowTrajectoryAction of a vehicle with invented times, from which it takes the speed;
- vertices without a time; conditions on traffic signals, user-defined values and states other than
  start, end and completion.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

import pytest

from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Where roads cross: test_maps_crossing_car.py.
EVENTS = tuple(sorted(name for name, kind in KINDS.items() if not kind.at_junction))

# Path below the element that holds an action or a condition: attributes and the values they may
# have; None: any.
_ANY: None = None
_RULES = {"lessThan", "greaterThan", "equalTo"}
INIT_ACTIONS = {
    "GlobalAction/EnvironmentAction",
    "PrivateAction/TeleportAction",
    "PrivateAction/LongitudinalAction/SpeedAction",
    "PrivateAction/ControllerAction",
}
STORY_ACTIONS = {
    "LongitudinalAction/SpeedAction",
    "LateralAction/LaneChangeAction",
    "RoutingAction/FollowTrajectoryAction",
    "TeleportAction",
    "ControllerAction",
}
CONDITIONS: dict[str, dict[str, set[str] | None]] = {
    "RelativeDistanceCondition": {
        "entityRef": _ANY,
        "value": _ANY,
        "rule": _RULES,
        "relativeDistanceType": {"longitudinal", "lateral", "cartesianDistance"},
        "freespace": {"true", "false"},
    },
    # With a position, alongRoute goes by the route planner's half metres.
    "TimeToCollisionCondition": {
        "value": _ANY,
        "rule": _RULES,
        "freespace": {"false"},
        "alongRoute": {"false"},
    },
    "TraveledDistanceCondition": {"value": _ANY},
    "SimulationTimeCondition": {"value": _ANY, "rule": _RULES},
}
POSITIONS = {"WorldPosition"}
DYNAMICS = {"SpeedActionDynamics": {"time", "distance"}, "LaneChangeActionDynamics": {"distance"}}


def children(element: ET.Element, path: str = "") -> set[str]:
    """Paths of the elements two levels down, or one where there is nothing below."""
    found = set()
    for child in element:
        below = list(child)
        if child.tag in ("LongitudinalAction", "LateralAction", "RoutingAction"):
            found |= {f"{path}{child.tag}/{grandchild.tag}" for grandchild in below}
        else:
            found.add(path + child.tag)
    return found


def need(element: ET.Element, path: str) -> ET.Element:
    """The element at a path, which must be there."""
    found = element.find(path)
    assert found is not None, path
    return found


@pytest.fixture(scope="module", params=EVENTS)
def roots(request: Any, case_of: Any, tmp_path_factory: pytest.TempPathFactory) -> list[ET.Element]:
    case = case_of(request.param)
    folder = tmp_path_factory.mktemp("scenario")
    files = export_openscenario(case.task, case.block, None, folder)
    return [ET.parse(f).getroot() for f in files[:2]]


def test_actions_are_of_the_subset(roots: list[ET.Element]) -> None:
    for root in roots:
        actions = need(root, "Storyboard/Init/Actions")
        for tag in ("GlobalAction", "PrivateAction"):
            for action in actions.iter(tag):
                assert {f"{tag}/{path}" for path in children(action)} <= INIT_ACTIONS
        found = [children(a) for a in root.iterfind(".//Event/Action/PrivateAction")]
        assert found
        assert set().union(*found) <= STORY_ACTIONS
        for change in root.iter("LaneChangeTarget"):
            assert [e.tag for e in change] == ["RelativeTargetLane"]
        for target in root.iter("SpeedActionTarget"):
            assert [e.tag for e in target] == ["AbsoluteTargetSpeed"]
        for tag, dimensions in DYNAMICS.items():
            assert {e.get("dynamicsDimension") for e in root.iter(tag)} <= dimensions


def test_conditions_are_of_the_subset(roots: list[ET.Element]) -> None:
    for root in roots:
        seen = set()
        for condition in root.iter("Condition"):
            assert condition.get("name")
            (kind,) = condition
            holder = kind.find("EntityCondition") if kind.tag == "ByEntityCondition" else kind
            assert holder is not None
            (leaf,) = holder
            seen.add(leaf.tag)
            assert leaf.tag in CONDITIONS, leaf.tag
            allowed = CONDITIONS[leaf.tag]
            assert set(leaf.attrib) == set(allowed), leaf.tag
            for name, values in allowed.items():
                assert values is None or leaf.get(name) in values, (leaf.tag, name)
        assert "SimulationTimeCondition" in seen


def test_a_delay_stands_only_where_the_wait_is_short(roots: list[ET.Element]) -> None:
    """ScenarioRunner waits for the delay first and then looks at the condition."""
    for root in roots:
        assert all(float(c.get("delay", "")) <= 0.2 for c in root.iter("Condition"))


def test_positions_are_of_the_subset(roots: list[ET.Element]) -> None:
    for root in roots:
        kinds = {child.tag for position in root.iter("Position") for child in position}
        assert kinds == POSITIONS


def test_vertices_have_times(roots: list[ET.Element]) -> None:
    for root in roots:
        for line in root.iter("Polyline"):
            times = [float(v.get("time", "nan")) for v in line.iter("Vertex")]
            assert times[0] == 0.0
            assert times == sorted(set(times))


def test_trajectories_are_a_pedestrians(roots: list[ET.Element]) -> None:
    """ScenarioRunner moves every vertex of a vehicle's trajectory onto the nearest lane."""
    for root in roots:
        for group in root.iter("ManeuverGroup"):
            if group.find(".//FollowTrajectoryAction") is None:
                continue
            names = [e.get("entityRef") for e in group.iterfind("Actors/EntityRef")]
            for name in names:
                path = f"Entities/ScenarioObject[@name='{name}']/Pedestrian"
                assert root.find(path) is not None


def test_the_environment_has_what_scenario_runner_reads(roots: list[ET.Element]) -> None:
    for root in roots:
        environment = need(root, ".//Environment")
        for path, attributes in {
            "Weather/Sun": ("azimuth", "elevation", "intensity"),
            "Weather/Fog": ("visualRange",),
            "Weather/Precipitation": ("precipitationType", "intensity"),
            "TimeOfDay": ("animation", "dateTime"),
            "RoadCondition": ("frictionScaleFactor",),
        }.items():
            element = need(environment, path)
            assert set(attributes) <= set(element.attrib)


def test_one_story_and_names_that_dont_repeat(roots: list[ET.Element]) -> None:
    """ScenarioRunner plays one story, and remembers what is done by names.

    Its ``oneshot_with_check`` warns where two elements have one name on the blackboard, such as
    ``group>manoeuvre`` of a manoeuvre and of an event in it (``open_scenario.py``).
    """
    levels = ("Story", "Act", "ManeuverGroup", "Maneuver", "Event", "Action", "Condition")
    for root in roots:
        assert len(root.findall("Storyboard/Story")) == 1
        names = [e.get("name") for e in need(root, "Storyboard").iter() if e.tag in levels]
        assert sorted(n for n in set(names) if names.count(n) > 1) == []
        assert all(not str(c.get("name")).startswith("criteria_") for c in root.iter("Condition"))
