"""Checks a CARLA configuration against CARLA's own reading of the map, without a server."""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

Place = dict[str, float]

# A route and a start are on a lane's centre line within this, and along it within that.
LATERAL_M = 0.5
YAW_DEG = 5.0
HEIGHT_M = 0.5
# A route is looked at this often, and may leave the lane's own length by this share and distance.
_STEP_M = 5.0
_REACH_M = 1.0


def is_installed() -> bool:
    """Tell whether the package ``carla`` is there."""
    return importlib.util.find_spec("carla") is not None


def check_against_map(config: dict[str, Any], xodr: str) -> list[str]:
    """List the parts of a configuration that don't lie where CARLA's map has a place for them.

    A participant that drives starts on the centre of a driving lane, along it, and its route is
    connected. One that stands or walks has ground below it, and a pedestrian waits on no driving
    lane. Heights agree.

    Raises:
        ModuleNotFoundError: ``carla`` isn't installed.
    """
    carla = importlib.import_module("carla")
    chart = carla.Map(config["map"]["name"], xodr)
    problems: list[str] = []
    for actor in config["actors"]:
        if actor["drive"] is None:
            problems += _stands(carla, chart, actor)
        else:
            problems += _starts(carla, chart, actor)
            problems += _is_connected(carla, chart, actor["id"], actor["drive"]["route"])
    for trigger in config["triggers"]:
        if trigger["act"]["kind"] == "follow_path":
            route = trigger["act"]["drive"]["route"]
            for end in (route[0], route[-1]):
                if _ground(carla, chart, end) is None:
                    who = trigger["actor"]
                    problems.append(f"{who} walks from or to {_text(end)}, off the map")
    return problems


def _text(place: Place) -> str:
    return f"({place['x']:.1f}, {place['y']:.1f})"


def _under(carla: Any, chart: Any, place: Place, lane_type: Any) -> Any:
    """Return the waypoint of the lane that a place lies in, or None."""
    return chart.get_waypoint(
        carla.Location(**place),
        project_to_road=False,
        lane_type=lane_type,
    )


def _ground(carla: Any, chart: Any, place: Place) -> Any:
    """Return the waypoint of the strip of any kind that a place lies in, or None.

    CARLA makes ground of strips of type ``none`` too, but finds them only as neighbours.
    """
    waypoint = _under(carla, chart, place, carla.LaneType.Any)
    if waypoint is not None:
        return waypoint
    nearest = chart.get_waypoint(
        carla.Location(**place),
        project_to_road=True,
        lane_type=carla.LaneType.Any,
    )
    for beside in (nearest.get_left_lane(), nearest.get_right_lane()):
        if beside is not None and _off_m(beside, place) <= beside.lane_width / 2:
            return beside
    return None


def _off_m(waypoint: Any, place: Place) -> float:
    location = waypoint.transform.location
    return math.hypot(location.x - place["x"], location.y - place["y"])


def _stands(carla: Any, chart: Any, actor: dict[str, Any]) -> list[str]:
    place = actor["reference"]["location"]
    waypoint = _ground(carla, chart, place)
    if waypoint is None:
        return [f"{actor['id']} stands at {_text(place)}, where the map has no lane of any kind"]
    if actor["object_class"] == "pedestrian" and waypoint.lane_type == carla.LaneType.Driving:
        return [f"{actor['id']} waits at {_text(place)}, on driving lane {waypoint.lane_id}"]
    return _height(waypoint, actor)


def _height(waypoint: Any, actor: dict[str, Any]) -> list[str]:
    ground, z_m = waypoint.transform.location.z, actor["reference"]["location"]["z"]
    if abs(ground - z_m) <= HEIGHT_M:
        return []
    who = actor["id"]
    return [f"{who} stands at a height of {z_m:g} m, where the ground is {ground:.2f} m"]


def _starts(carla: Any, chart: Any, actor: dict[str, Any]) -> list[str]:
    place = actor["reference"]["location"]
    waypoint = _under(carla, chart, place, carla.LaneType.Driving)
    if waypoint is None:
        return [f"{actor['id']} starts at {_text(place)}, which is on no driving lane"]
    problems = _height(waypoint, actor)
    off = _off_m(waypoint, place)
    if off > LATERAL_M:
        problems.append(f"{actor['id']} starts {off:.2f} m beside its lane's centre")
    turn = math.remainder(
        waypoint.transform.rotation.yaw - actor["reference"]["rotation"]["yaw"], 360.0
    )
    if abs(turn) > YAW_DEG:
        problems.append(f"{actor['id']} starts {abs(turn):.1f} deg off its lane's direction")
    return problems


def _every(route: Sequence[Place]) -> Iterator[Place]:
    """Yield a route's points, and more between those that are far from each other."""
    yield route[0]
    for a, b in itertools.pairwise(route):
        parts = max(1, math.ceil(math.hypot(b["x"] - a["x"], b["y"] - a["y"]) / _STEP_M))
        for i in range(1, parts + 1):
            share = i / parts
            yield {axis: a[axis] + share * (b[axis] - a[axis]) for axis in a}


def _is_connected(carla: Any, chart: Any, name: str, route: Sequence[Place]) -> list[str]:
    """Check that each point of a route is on a driving lane, reached from the one before."""
    before: Any = None
    last: Place | None = None
    for place in _every(route):
        here = _under(carla, chart, place, carla.LaneType.Driving)
        if here is None:
            return [f"the route of {name} leaves the driving lanes at {_text(place)}"]
        if _off_m(here, place) > LATERAL_M:
            return [f"the route of {name} leaves its lane's centre at {_text(place)}"]
        if before is not None and last is not None:
            ahead = math.hypot(place["x"] - last["x"], place["y"] - last["y"])
            reached = min(
                (_off_m(w, place) for w in before.next(max(ahead, 0.01))), default=math.inf
            )
            if reached > _REACH_M:
                return [f"the route of {name} isn't connected at {_text(place)}"]
        before, last = here, place
    return []
