"""SUMO run files of a task (METHOD 2.5): network, participants, anchors, and a configuration.

``sumo -c run.sumocfg`` plays what SUMO can: everybody at the right place, VUT and OTs at their
cruise speeds, the surroundings. The trigger and what it fires are no words of SUMO's: a session
(`ssp run FOLDER`) evaluates them and moves the participants.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

from ssp_core.errors import InputError
from ssp_core.files.writing import write_bytes
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Point
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.sumo_network import SUMO_CLASSES, SUMO_SEEDS, LanePlace, write_network
from ssp_scenario_manager.compile.task import Task

NET_FILE, ROUTE_FILE = "road.net.xml", "run.rou.xml"
SHAPE_FILE, CONFIG_FILE = "run.add.xml", "run.sumocfg"
# Nobody changes lane by himself.
_STAYS = {"lcStrategic": "-1", "lcCooperative": "-1", "lcSpeedGain": "0", "lcKeepRight": "0"}


def write_sumo(task: Task, folder: Path) -> list[Path]:
    """Write road.net.xml, run.rou.xml, run.add.xml and run.sumocfg.

    Raises:
        HostError: netconvert isn't installed or fails.
        InputError: the user's map has a name that is needed here.
    """
    if task.place.name in (NET_FILE, ROUTE_FILE, SHAPE_FILE, CONFIG_FILE):
        raise InputError(
            "is the name of a file that is written beside it",
            file=task.place.name,
            remedy="rename the map",
        )
    network = write_network(task.run.road, folder)
    # Netconvert writes when and where it ran, and leaves what it was given.
    net = re.sub(rb"<!--.*?-->\s*", b"", network.path.read_bytes(), flags=re.DOTALL)
    for name in ("road.nod.xml", "road.edg.xml"):
        (folder / name).unlink(missing_ok=True)
    head, _, body = net.partition(b"?>")
    write_bytes(network.path, head + b"?>\n" + _comment(task) + body.lstrip())
    files = {
        ROUTE_FILE: _routes(task.run, network.lanes),
        SHAPE_FILE: _shapes(task),
        CONFIG_FILE: _config(task),
    }
    for name, root in files.items():
        ElementTree.indent(root)
        text = ElementTree.tostring(root, encoding="utf-8")
        first = b'<?xml version="1.0" encoding="UTF-8"?>\n'
        write_bytes(folder / name, first + _comment(task) + text + b"\n")
    return [network.path, *(folder / name for name in files)]


def _comment(task: Task) -> bytes:
    text = (
        f"event {task.event.name} {task.event.version}, task {task.version}, {task.compiler}, "
        f"seed {task.seed}"
    )
    # Two hyphens would end the comment.
    return f"<!-- {text.replace('--', '- -')} -->\n".encode()


# -- participants --------------------------------------------------------------------------------


def _routes(run: RunSpec, lanes: Sequence[LanePlace]) -> ElementTree.Element:
    root = ElementTree.Element("routes")
    for spec in (run.vut, *run.targets):
        cruise = spec.approach.cruise_mps if spec.approach is not None else None
        root.append(_type(spec.id, spec.cls, cruise))
    for traffic in run.traffic:
        object_class = ObjectClass.from_word(traffic.object_class)
        root.append(_type(traffic.id, object_class, traffic.speed_mps))
    for edge in sorted({place.edge for place in lanes}):
        ElementTree.SubElement(root, "route", id=edge, edges=edge)
    line = ReferenceLine.of_road(run.road)
    for spec in (run.vut, *run.targets):
        root.extend(_participant(spec, run, lanes, line))
    for traffic in run.traffic:
        place = lanes[traffic.lane]
        front = place.position_m(traffic.x_m)
        root.append(_vehicle(traffic.id, place, front, traffic.speed_mps))
    return root


def _type(name: str, object_class: ObjectClass, cruise_mps: float | None) -> ElementTree.Element:
    """Return the participant's own type, which holds its cruising speed."""
    size = DEFAULT_SIZES[object_class]
    attributes = {
        "id": f"{name}_type",
        "vClass": SUMO_CLASSES[object_class],
        "length": f"{size.length_m:g}",
        "width": f"{size.width_m:g}",
        "height": f"{size.height_m:g}",
    }
    if object_class is not ObjectClass.PEDESTRIAN:
        attributes |= {"sigma": "0", "speedDev": "0", **_STAYS}
        if cruise_mps:
            attributes["maxSpeed"] = f"{cruise_mps:g}"
    return ElementTree.Element("vType", attributes)


def _participant(
    spec: ParticipantSpec, run: RunSpec, lanes: Sequence[LanePlace], line: ReferenceLine
) -> Iterator[ElementTree.Element]:
    s, y = line.to_local(spec.start.x_m, spec.start.y_m)
    if spec.approach is not None:
        place = _lane_at(run, lanes, y)
        front = place.position_m(s + spec.size.front_m)
        yield _vehicle(spec.id, place, front, 0.0)
        return
    if spec.cls is ObjectClass.PEDESTRIAN:
        yield from _stands(spec, run, lanes, s, y)
        return
    # Who only stands is beside the nearest lane, where SUMO parks.
    place = _lane_at(run, lanes, y)
    front = place.position_m(s + spec.size.front_m)
    vehicle = _vehicle(spec.id, place, front, 0.0)
    vehicle.set("departPos", "stop")
    ElementTree.SubElement(
        vehicle,
        "stop",
        lane=f"{place.edge}_{place.index}",
        endPos=f"{front:.3f}",
        duration=f"{run.limits.duration_s:g}",
        parking="true",
    )
    yield vehicle


def _stands(
    spec: ParticipantSpec, run: RunSpec, lanes: Sequence[LanePlace], s: float, y: float
) -> Iterator[ElementTree.Element]:
    """Yield a pedestrian on the sidewalk, if the road has one there."""
    side = "left" if y > run.road.left_edge_m else "right"
    width = run.road.sidewalk_left_m if side == "left" else run.road.sidewalk_right_m
    if width <= 0.0:
        return  # the network has nothing there to stand on
    walk = next(place for place in lanes if not place.backward)
    person = ElementTree.Element("person", id=spec.id, type=f"{spec.id}_type", depart="0")
    at = walk.position_m(s)
    ElementTree.SubElement(
        person,
        "stop",
        lane=f"walk_{side}_0",
        startPos=f"{at - 0.5:.3f}",
        endPos=f"{at:.3f}",
        duration=f"{run.limits.duration_s:g}",
    )
    yield person


def _lane_at(run: RunSpec, lanes: Sequence[LanePlace], y_m: float) -> LanePlace:
    """Return the lane that an offset is in or nearest to."""
    index = min(range(len(lanes)), key=lambda i: abs(run.road.lanes[i].y_m - y_m))
    return lanes[index]


def _vehicle(name: str, place: LanePlace, front_m: float, speed_mps: float) -> ElementTree.Element:
    return ElementTree.Element(
        "vehicle",
        id=name,
        type=f"{name}_type",
        route=place.edge,
        depart="0",
        departLane=str(place.index),
        departPos=f"{front_m:.3f}",
        departSpeed=f"{speed_mps:g}",
    )


# -- anchors and configuration -------------------------------------------------------------------


def _shapes(task: Task) -> ElementTree.Element:
    root = ElementTree.Element("additional")
    layers: list[tuple[str, str, list[Point], str]] = [
        ("geofence", "red", task.geofence, "0"),
        ("conflict_zone", "255,120,0,120", [(p.x_m, p.y_m) for p in task.conflict_zone], "1"),
    ]
    layers += [
        (f"ot_reachable_{i}", "grey", region, "0") for i, region in enumerate(task.ot_reachable)
    ]
    layers += [
        (f"safe_stop_{i}", "0,160,0,60", region, "1")
        for i, region in enumerate(task.safe_stop_zones)
    ]
    for name, colour, outline, fill in layers:
        shape = " ".join(f"{x:.3f},{y:.3f}" for x, y in [*outline, outline[0]])
        ElementTree.SubElement(
            root, "poly", id=name, color=colour, fill=fill, layer="1", shape=shape
        )
    places = {"trigger_expected": task.trigger.expected}
    for name, anchors in sorted(task.anchors.items()):
        places |= {f"{name}_start": anchors.start, f"{name}_goal": anchors.goal}
        places["conflict_point"] = anchors.conflict
    for name, place in places.items():
        ElementTree.SubElement(
            root, "poi", id=name, x=f"{place.x_m:.3f}", y=f"{place.y_m:.3f}", layer="5"
        )
    return root


def _config(task: Task) -> ElementTree.Element:
    root = ElementTree.Element("configuration")

    def section(name: str, **values: str) -> None:
        part = ElementTree.SubElement(root, name)
        for key, value in values.items():
            ElementTree.SubElement(part, key.replace("_", "-"), value=value)

    section("input", net_file=NET_FILE, route_files=ROUTE_FILE, additional_files=SHAPE_FILE)
    section("time", step_length=f"{task.run.step_s:g}", end=f"{task.run.end.at_latest_s:g}")
    processing = {"collision.action": "warn", "collision.mingap-factor": "0"}
    part = ElementTree.SubElement(root, "processing")
    for key, value in {**processing, "time-to-teleport": "-1"}.items():
        ElementTree.SubElement(part, key, value=value)
    section("random_number", seed=str(task.seed % SUMO_SEEDS))
    return root
