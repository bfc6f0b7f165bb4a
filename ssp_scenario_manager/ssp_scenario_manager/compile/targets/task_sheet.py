"""The task sheet: one HTML page with a top view and the figures that people on a track need."""

from __future__ import annotations

from pathlib import Path

from ssp_core.files import write_text
from ssp_core.geometry import Box, Polyline
from ssp_core.motion.manoeuvre import lane_change
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import FollowPath, LaneChange, TriggerSpec
from ssp_core.run_file.values import Point
from ssp_core.templates import templates
from ssp_core.world.road_drawing import RoadView, drawing_of
from ssp_scenario_manager.compile.compiler import Compiled
from ssp_scenario_manager.compile.task import Place, Task
from ssp_scenario_manager.dispatch.references import run_out_end_m

SHEET_FILE = "task.html"
Shapes = list[tuple[str, list[Point]]]


def write_sheet(compiled: Compiled, folder: Path) -> Path:
    """Writes task.html into a compiled folder."""
    path = folder / SHEET_FILE
    write_text(path, sheet(compiled.task))
    return path


def sheet(task: Task) -> str:
    """The page of a task."""
    rows = [
        (name, kind, place)
        for name, anchors in sorted(task.anchors.items())
        for kind, place in (("start", anchors.start), ("goal", anchors.goal))
    ]
    rows.append(("all", "conflict point", task.anchors[VUT_ID].conflict))
    rows += [("zone", "corner", corner) for corner in task.conflict_zone]
    areas, lines = _areas(task), _lines(task)
    shown = [place for kind, outline in areas if kind in ("road", "zone") for place in outline]
    marks = [
        ("vut" if name == VUT_ID else "ot", _at(anchors.start), name)
        for name, anchors in sorted(task.anchors.items())
    ]
    page = templates(Path(__file__).parent).get_template("task.html.j2")
    return page.render(
        task=task,
        view=RoadView(task.run.road, [*shown, *task.vut_route]),
        areas=areas,
        lines=lines,
        marks=[*marks, ("fire", _at(task.trigger.expected), "trigger expected")],
        anchors=[(name, kind, p.s_m, p.l_m, p.x_m, p.y_m) for name, kind, p in rows],
        limits=task.limits.model_dump(),
    )


def _at(place: Place) -> Point:
    return place.x_m, place.y_m


def _areas(task: Task) -> Shapes:
    """Outlines by what they are: carriageway, regions, conflict zone and bodies at the start."""
    edges = [line.points for line in drawing_of(task.run).road_lines if line.kind == "edge"]
    areas: Shapes = []
    if len(edges) == 2:  # beyond the centre of a tight bend an edge has no place of its own
        areas.append(("road", [*edges[0], *reversed(edges[1])]))
    areas += [("stop", region) for region in task.safe_stop_zones]
    areas += [("fence", task.geofence), ("zone", [_at(corner) for corner in task.conflict_zone])]
    for spec in (task.run.vut, *task.run.targets):
        body = Box(spec.start.pose, spec.size.front_m, spec.size.rear_m, spec.size.width_m)
        areas.append(("vut" if spec.id == VUT_ID else "ot", list(body.corners())))
    return areas


def _lines(task: Task) -> Shapes:
    """Lane borders, and what everybody drives: before the trigger, and what it sets off."""
    borders = [line for line in drawing_of(task.run).road_lines if line.kind == "divider"]
    lines: Shapes = [("lane", list(line.points)) for line in borders]
    lines.append(("vut", task.vut_route))
    acts = {trigger.object_id: _act(task, trigger) for trigger in task.run.triggers}
    for target in task.run.targets:
        act = acts.get(target.id)
        if target.approach is not None:
            lines.append(("ot", act[0] if act else target.approach.path))
        if act:
            lines.append(("act", act[1]))
    return lines


def _act(task: Task, trigger: TriggerSpec) -> tuple[list[Point], list[Point]] | None:
    """What an object drives before the trigger, and what after, as planned; None: it brakes."""
    manoeuvre = trigger.manoeuvre
    if isinstance(manoeuvre, FollowPath):
        return [], manoeuvre.motion.path
    target = next(spec for spec in task.run.targets if spec.id == trigger.object_id)
    if not isinstance(manoeuvre, LaneChange) or target.approach is None:
        return None
    path = Polyline(target.approach.path)
    expected, _ = path.project(task.trigger.expected.x_m, task.trigger.expected.y_m)
    station = expected + task.run.vut.size.front_m + task.trigger.below + target.size.rear_m
    points = lane_change(
        path,
        station,
        target.approach.cruise_mps,
        manoeuvre.lateral_shift_m,
        manoeuvre.duration_s,
        manoeuvre.cruise_mps,
        manoeuvre.deceleration_mps2,
        end_station_m=run_out_end_m(path, station, target.approach.cruise_mps, manoeuvre),
    )
    pose = path.pose(station)
    cut = [p for p in target.approach.path if path.project(*p)[0] < station]
    return [*cut, (pose.x_m, pose.y_m)], [(p.x_m, p.y_m) for p in points]
