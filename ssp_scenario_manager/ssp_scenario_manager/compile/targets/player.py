"""A player of the part of OpenSCENARIO that our exports use, in steps of 10 ms as esmini plays it.

It reads the scenario's text alone, and the map for the lanes of a lane change. Everybody keeps the
offset from the road's line with which they start, as on a road of constant lanes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element

import defusedxml.ElementTree as safe_xml
import numpy as np

from ssp_core.geometry import FloatArray, Polyline, Pose2, wrap_angle
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.targets.goal_lane import lane_beside

STEP_S = 0.01
# The road's line is sampled this densely.
_SAMPLE_M = 0.25
_LONGEST_S = 600.0


class NotOfSubset(Exception):
    """The scenario holds something that none of our exports has."""


def _only(element: Element, path: str = "*") -> Element:
    children = element.findall(path)
    if len(children) != 1:
        raise NotOfSubset(f"{len(children)} × {path} in <{element.tag}>")
    return children[0]


def _number(element: Element, path: str, name: str = "value") -> float:
    return float(_only(element, path).attrib[name])


class _Road:
    """Poses along a line and beside it, by interpolation."""

    def __init__(self, line: ReferenceLine) -> None:
        self.line = line
        self._s = np.linspace(0.0, line.length_m, max(2, math.ceil(line.length_m / _SAMPLE_M) + 1))
        poses = line.poses(self._s.tolist())
        self._yaw = np.unwrap([pose.yaw_rad for pose in poses])
        self._xy = np.array([(pose.x_m, pose.y_m) for pose in poses])
        self._curvature = np.gradient(self._yaw, self._s)

    def pose(self, s_m: float, l_m: float) -> Pose2:
        if not 0.0 <= s_m <= self.line.length_m:
            x, y = self.line.to_map(s_m, l_m)
            return Pose2(x, y, self.line.pose(s_m).yaw_rad)
        yaw = float(np.interp(s_m, self._s, self._yaw))
        x = float(np.interp(s_m, self._s, self._xy[:, 0])) - l_m * math.sin(yaw)
        y = float(np.interp(s_m, self._s, self._xy[:, 1])) + l_m * math.cos(yaw)
        return Pose2(x, y, yaw)

    def curvature(self, s_m: float) -> float:
        return float(np.interp(s_m, self._s, self._curvature))


_NOWHERE = Pose2(0.0, 0.0, 0.0)


@dataclass
class _Body:
    """An entity: where it is, how fast, and what moves it; ``against`` the road's direction."""

    front_m: float
    rear_m: float
    width_m: float
    pose: Pose2 = _NOWHERE
    speed_mps: float = 0.0
    driven_m: float = 0.0
    s_m: float = 0.0
    l_m: float = 0.0
    against: bool = False
    speed: Callable[[float], float] | None = None
    shift: _Shift | None = None
    path: Polyline | None = None
    walked_m: float = 0.0
    track: list[tuple[float, float, float, float]] = field(default_factory=list)


@dataclass
class _Shift:
    """A lane change: a sine over a distance along the lane."""

    from_l: float
    to_l: float
    distance_m: float
    gone_m: float = 0.0

    def rate(self) -> float:
        turn = math.pi * self.gone_m / self.distance_m
        return 0.5 * math.pi * (self.to_l - self.from_l) / self.distance_m * math.sin(turn)

    def offset_m(self) -> float:
        share = 0.5 * (1.0 - math.cos(math.pi * min(1.0, self.gone_m / self.distance_m)))
        return self.from_l + share * (self.to_l - self.from_l)


@dataclass
class _Event:
    body: _Body
    actions: list[Element]
    condition: Element
    true_since_s: float | None = None
    started: bool = False


@dataclass
class _Act:
    start: Element
    events: list[_Event]
    running: bool = False


def play(scenario: bytes, map_data: bytes, line: ReferenceLine) -> Mapping[str, FloatArray]:
    """Play a scenario until its end.

    Args:
        scenario: an export.
        map_data: the map beside it.
        line: of the road that it takes place on.

    Returns:
        Per entity rows (t in s, x, y in m, yaw in rad), frame map.

    Raises:
        NotOfSubset: it holds something else than our exports do.
    """
    return _Player(safe_xml.fromstring(scenario), map_data, _Road(line)).run()


class _Player:
    def __init__(self, root: Element, map_data: bytes, road: _Road) -> None:
        self._map, self._road = map_data, road
        self._bodies = {e.attrib["name"]: _body(e) for e in root.iterfind(".//ScenarioObject")}
        self._t = 0.0
        for private in root.iterfind("Storyboard/Init/Actions/Private"):
            body = self._bodies[private.attrib["entityRef"]]
            at = _only(private, ".//TeleportAction//WorldPosition").attrib
            body.pose = Pose2(float(at["x"]), float(at["y"]), float(at["h"]))
            body.s_m, body.l_m = road.line.to_local(body.pose.x_m, body.pose.y_m)
            turned = body.pose.yaw_rad - road.pose(body.s_m, body.l_m).yaw_rad
            body.against = math.cos(turned) < 0.0
        self._acts = [self._act(act) for act in root.iterfind("Storyboard/Story/Act")]
        self._stop = _only(root, "Storyboard/StopTrigger")

    def _act(self, act: Element) -> _Act:
        events = []
        for group in act.iterfind("ManeuverGroup"):
            body = self._bodies[_only(group, "Actors/EntityRef").attrib["entityRef"]]
            for event in group.iterfind("Maneuver/Event"):
                actions = [_only(a) for a in event.iterfind("Action/PrivateAction")]
                condition = _only(event, "StartTrigger/ConditionGroup/Condition")
                events.append(_Event(body, actions, condition))
        return _Act(_only(act, "StartTrigger/ConditionGroup/Condition"), events)

    def run(self) -> Mapping[str, FloatArray]:
        while not any(self._holds(c) for c in self._stop.iterfind(".//Condition")):
            if self._t > _LONGEST_S:
                raise NotOfSubset(f"it doesn't end within {_LONGEST_S:g} s")
            for body in self._bodies.values():
                if self._t > 0.0:
                    self._move(body)
                body.track.append((self._t, body.pose.x_m, body.pose.y_m, body.pose.yaw_rad))
            for act in self._acts:
                act.running = act.running or self._holds(act.start)
                for event in act.events if act.running else ():
                    self._look_at(event)
            self._t = round(self._t + STEP_S, 6)
        return {name: np.array(body.track) for name, body in self._bodies.items()}

    # -- conditions ----------------------------------------------------------------------------

    def _look_at(self, event: _Event) -> None:
        if event.started:
            return
        if event.true_since_s is None and self._holds(event.condition):
            event.true_since_s = self._t
        delay_s = float(event.condition.attrib["delay"])
        if event.true_since_s is not None and self._t >= event.true_since_s + delay_s - 1e-9:
            event.started = True
            for action in event.actions:
                self._start(event.body, action)

    def _holds(self, condition: Element) -> bool:
        kind = _only(condition)
        if kind.tag == "ByValueCondition":
            return self._t > _number(kind, "SimulationTimeCondition")
        body = self._bodies[_only(kind, "TriggeringEntities/EntityRef").attrib["entityRef"]]
        entity_condition = _only(kind, "EntityCondition/*")
        value = float(entity_condition.attrib["value"])
        if entity_condition.tag == "TraveledDistanceCondition":
            return body.driven_m > value
        if entity_condition.tag == "RelativeDistanceCondition":
            return self._ahead_m(body, self._bodies[entity_condition.attrib["entityRef"]]) < value
        if entity_condition.tag == "TimeToCollisionCondition":
            place = _only(entity_condition, ".//WorldPosition").attrib
            away = math.dist((body.pose.x_m, body.pose.y_m), (float(place["x"]), float(place["y"])))
            return body.speed_mps > 1e-6 and away / body.speed_mps < value
        raise NotOfSubset(entity_condition.tag)

    @staticmethod
    def _ahead_m(body: _Body, other: _Body) -> float:
        """Free space along the body's heading."""
        corners = [
            body.pose.to_local(*other.pose.to_parent(x, side * other.width_m / 2))[0]
            for x in (other.front_m, -other.rear_m)
            for side in (-1, 1)
        ]
        return min(corners) - body.front_m

    # -- actions -------------------------------------------------------------------------------

    def _start(self, body: _Body, action: Element) -> None:
        element = _only(action)
        if element.tag == "SpeedAction":
            self._start_speed(body, element)
        elif element.tag == "LaneChangeAction":
            target = _only(element, "LaneChangeTarget/RelativeTargetLane")
            shift_m = lane_beside(self._map, body.pose, int(target.attrib["value"]))
            # The offset is to the left of the map's road, as is the goal lane's middle.
            offset_m = float(element.attrib.get("targetLaneOffset", 0.0)) * shift_m.along
            distance_m = _number(element, "LaneChangeActionDynamics")
            goal = body.l_m + shift_m.shift_m + offset_m
            body.shift = _Shift(body.l_m, goal, distance_m)
        elif element.tag == "FollowTrajectoryAction":
            places = [e.attrib for e in element.iterfind(".//Vertex//WorldPosition")]
            body.path = Polyline([(float(at["x"]), float(at["y"])) for at in places])
        else:
            raise NotOfSubset(element.tag)

    def _start_speed(self, body: _Body, action: Element) -> None:
        begin_s, from_mps = self._t, body.speed_mps
        duration_s = _number(action, "SpeedActionDynamics")
        to_mps = _number(action, ".//AbsoluteTargetSpeed")

        def speed(t_s: float) -> float:
            share = 1.0 if duration_s <= 0.0 else min(1.0, (t_s - begin_s) / duration_s)
            return from_mps + share * (to_mps - from_mps)

        body.speed = speed

    # -- motion --------------------------------------------------------------------------------

    def _move(self, body: _Body) -> None:
        if body.speed is not None:
            body.speed_mps = body.speed(self._t)
        way_m = body.speed_mps * STEP_S
        body.driven_m += way_m
        if body.path is not None:
            self._walk(body, way_m)
            return
        if way_m == 0.0:
            return
        heading = 0.0
        if body.shift is not None:
            rate = body.shift.rate()
            body.shift.gone_m += way_m / math.hypot(1.0, rate)
            body.l_m, heading = body.shift.offset_m(), math.atan(rate)
            if body.shift.gone_m >= body.shift.distance_m:
                body.shift = None
        ahead_m = way_m * math.cos(heading) * (-1.0 if body.against else 1.0)
        heading += math.pi if body.against else 0.0
        body.s_m += ahead_m / (1.0 - self._road.curvature(body.s_m) * body.l_m)
        pose = self._road.pose(body.s_m, body.l_m)
        body.pose = Pose2(pose.x_m, pose.y_m, wrap_angle(pose.yaw_rad + heading))

    @staticmethod
    def _walk(body: _Body, way_m: float) -> None:
        if body.path is None:
            raise ValueError("it has no path")
        body.walked_m = min(body.path.length_m, body.walked_m + way_m)
        body.pose = body.path.pose(body.walked_m)


def _body(element: Element) -> _Body:
    box = _only(_only(element), "BoundingBox")
    length = _number(box, "Dimensions", "length")
    middle = _number(box, "Center", "x")
    width = _number(box, "Dimensions", "width")
    return _Body(middle + length / 2, length / 2 - middle, width)
