"""The pictures of a task sheet: the top view with labels, scale and north, and the speeds.

Labels stand in a band of their own above the view, each with a thin line to its mark, and corners
of the fence beside their marks where that is free: none lies on a route.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ssp_core.geometry import Box, Polyline
from ssp_core.motion.manoeuvre import brake_along, drive_along, lane_change
from ssp_core.motion.reference import Points
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import Brake, FollowPath, Hold, LaneChange, Motion, TriggerSpec
from ssp_core.run_file.values import Point
from ssp_core.world.road_drawing import RoadView, drawing_of
from ssp_scenario_manager.compile.task import Place, Task
from ssp_scenario_manager.dispatch.references import run_out_end_m

Shapes = list[tuple[str, list[Point]]]
# Of a label's text, px, at the size that the sheet's style gives it.
CHARACTER_PX = 7.5
ROW_PX = 16.0
_GAP_PX = 14.0
_BASE_PX = 46.0  # below the view, for scale and north
_SCALES_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
_SCALE_PX = 160.0
_ACROSS_PX = 34.0
_ARROW_PX = 16.0


@dataclass(frozen=True, slots=True)
class Label:
    """A text, and the mark that it belongs to; px. What stands in the band above is above 0.

    Args:
        at: left end of the text's base line.
        mark: what it names.
    """

    kind: str
    text: str
    at: Point
    mark: Point

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom of the text."""
        x, y = self.at
        return x, y - ROW_PX + 4.0, x + CHARACTER_PX * len(self.text), y + 4.0


@dataclass(frozen=True, slots=True)
class TopView:
    """The view from above; px of the page, y downwards.

    Args:
        box: left, top, width and height of the whole picture.
        areas: outlines by what they are.
        lines: borders of lanes, and routes.
        scale: length along the road: m, and px from the left end; then the same across.
        north: ends of the arrow, foot first.
    """

    box: tuple[float, float, float, float]
    areas: Shapes
    lines: Shapes
    labels: list[Label]
    scale: tuple[float, float, float, float]
    north: tuple[Point, Point]


def top_view(task: Task) -> TopView:
    """Draw a task from above."""
    areas, lines = _areas(task), _lines(task)
    points = [place for kind, outline in areas if kind != "fence" for place in outline]
    points += [place for _, line in lines for place in line]
    view = RoadView(task.run.road, points + list(task.geofence))
    marks = [
        ("vut" if name == VUT_ID else "ot", f"{name} starts", _at(anchors.start))
        for name, anchors in sorted(task.anchors.items())
    ]
    marks += [
        ("fire", "VUT when the trigger fires", _at(task.trigger.expected)),
        ("zone", "conflict point", _at(task.anchors[VUT_ID].conflict)),
    ]
    lines_px = [(kind, view.points(line)) for kind, line in lines]
    placed = [(kind, text, view.points([place])[0]) for kind, text, place in marks]
    beside: list[Label] = []
    for k, corner in enumerate(view.points(task.geofence), 1):
        label = _beside(Label("fence", f"F{k}", (0.0, 0.0), corner), lines_px, beside)
        if label is None:
            placed.append(("fence", f"F{k}", corner))
        else:
            beside.append(label)
    labels, band_px = _labelled(placed)
    return TopView(
        (0.0, -band_px, view.width_px, band_px + view.height_px + _BASE_PX),
        [(kind, view.points(outline)) for kind, outline in areas],
        lines_px,
        [*labels, *beside],
        _scale(task, view),
        _north(task, view),
    )


def _at(place: Place) -> Point:
    return place.x_m, place.y_m


def _beside(label: Label, lines: Shapes, others: Sequence[Label]) -> Label | None:
    """Place the label beside its mark, on no route and no other label; None: there is no room."""
    x, y = label.mark
    width = CHARACTER_PX * len(label.text)
    for at in (
        (x + 5.0, y - 6.0),
        (x - 5.0 - width, y - 6.0),
        (x + 5.0, y + 16.0),
        (x - 5.0 - width, y + 16.0),
    ):
        tried = replace(label, at=at)
        box = tried.box
        on_page = box[0] >= 0.0 and box[1] >= 0.0 and box[2] <= RoadView.width_px
        free = not any(_overlap(box, other.box) for other in others)
        if on_page and free and not lies_on(box, lines):
            return tried
    return None


def _overlap(
    one: tuple[float, float, float, float], other: tuple[float, float, float, float]
) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def lies_on(box: tuple[float, float, float, float], lines: Shapes) -> bool:
    """Tell whether a box touches a path that is driven."""
    left, top, right, bottom = box
    for kind, line in lines:
        if kind == "lane":
            continue
        for (ax, ay), (bx, by) in pairwise(line):
            # Liang and Barsky: the part of the segment that lies within all four sides.
            low, high = 0.0, 1.0
            for p, q in (
                (ax - bx, ax - left),
                (bx - ax, right - ax),
                (ay - by, ay - top),
                (by - ay, bottom - ay),
            ):
                if p == 0.0:
                    low = low if q >= 0.0 else 2.0
                elif p < 0.0:
                    low = max(low, q / p)
                else:
                    high = min(high, q / p)
            if low <= high:
                return True
    return False


def _labelled(marks: Sequence[tuple[str, str, Point]]) -> tuple[list[Label], float]:
    """Return the labels in rows from the view upwards, none over another, and the band's height."""
    labels: list[Label] = []
    ends: list[float] = []
    for kind, text, mark in sorted(marks, key=lambda one: one[2]):
        width = CHARACTER_PX * len(text)
        x = min(max(mark[0] - width / 2.0, 0.0), RoadView.width_px - width)
        free = (row for row, end in enumerate(ends) if x >= end + _GAP_PX)
        row = next(free, len(ends))
        ends[row : row + 1] = [x + width]
        labels.append(Label(kind, text, (x, -6.0 - ROW_PX * row), mark))
    return labels, ROW_PX * len(ends) + 8.0


def _scale(task: Task, view: RoadView) -> tuple[float, float, float, float]:
    """Round lengths along and across the road, each as m and px."""
    start = task.run.road.origin
    c, s = math.cos(start.yaw_rad), math.sin(start.yaw_rad)
    here, along, across = view.points(
        [
            (start.x_m, start.y_m),
            (start.x_m + c, start.y_m + s),
            (start.x_m - s, start.y_m + c),
        ]
    )
    along_px, across_px = math.dist(here, along), math.dist(here, across)
    long_m = max((m for m in _SCALES_M if m * along_px <= _SCALE_PX), default=_SCALES_M[0])
    wide_m = max((m for m in _SCALES_M if m * across_px <= _ACROSS_PX), default=_SCALES_M[0])
    return long_m, long_m * along_px, wide_m, wide_m * across_px


def _north(task: Task, view: RoadView) -> tuple[Point, Point]:
    """Return an arrow in the base of the picture that points to the north."""
    start = task.run.road.origin
    here, there = view.points([(start.x_m, start.y_m), (start.x_m, start.y_m + 1.0)])
    dx, dy = np.subtract(there, here) / math.dist(here, there) * _ARROW_PX
    x, y = view.width_px - 50.0, view.height_px + _BASE_PX / 2.0
    return (x - dx, y - dy), (x + dx, y + dy)


def _areas(task: Task) -> Shapes:
    """Return outlines by kind: carriageway, regions, conflict zone and bodies at the start."""
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
    """Return lane borders, and all routes: before the trigger, and what it sets off."""
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
    return [(kind, line) for kind, line in lines if line]


def _act(task: Task, trigger: TriggerSpec) -> tuple[list[Point], list[Point]] | None:
    """Give the planned paths of an object before and after the trigger; None: it brakes."""
    manoeuvre = trigger.manoeuvre
    if isinstance(manoeuvre, FollowPath):
        return [], manoeuvre.motion.path
    changed = _changed_lane(task, trigger)
    target = next(spec for spec in task.run.targets if spec.id == trigger.object_id)
    if changed is None or target.approach is None:
        return None
    path, station = Polyline(target.approach.path), _acts_at_m(task, trigger)
    pose = path.pose(station)
    cut = [p for p in target.approach.path if path.project(*p)[0] < station]
    return [*cut, (pose.x_m, pose.y_m)], [(p.x_m, p.y_m) for p in changed]


def _acts_at_m(task: Task, trigger: TriggerSpec) -> float:
    """Return the station of an object's approach at which its gap to the VUT is the trigger's."""
    target = next(spec for spec in task.run.targets if spec.id == trigger.object_id)
    if target.approach is None:
        return 0.0
    path = Polyline(target.approach.path)
    expected, _ = path.project(task.trigger.expected.x_m, task.trigger.expected.y_m)
    return expected + task.run.vut.size.front_m + task.trigger.below + target.size.rear_m


def _changed_lane(task: Task, trigger: TriggerSpec) -> Points | None:
    """Return the planned lane change of an object; None for one with another manoeuvre."""
    manoeuvre = trigger.manoeuvre
    target = next(spec for spec in task.run.targets if spec.id == trigger.object_id)
    if not isinstance(manoeuvre, LaneChange) or target.approach is None:
        return None
    path, station = Polyline(target.approach.path), _acts_at_m(task, trigger)
    return lane_change(
        path,
        station,
        target.approach.cruise_mps,
        manoeuvre.lateral_shift_m,
        manoeuvre.duration_s,
        manoeuvre.cruise_mps,
        manoeuvre.deceleration_mps2,
        end_station_m=run_out_end_m(path, station, target.approach.cruise_mps, manoeuvre),
    )


# -- speeds ----------------------------------------------------------------------------------------

WIDTH_PX, HEIGHT_PX = 1100.0, 240.0
_LEFT_PX, _TOP_PX, _RIGHT_PX, _FOOT_PX = 46.0, 12.0, 12.0, 40.0
_STEP_S = 0.25


@dataclass(frozen=True, slots=True)
class SpeedLine:
    """Planned speed of one participant.

    Args:
        points: time since the start of the run in s, and speed in m/s.
    """

    kind: str
    name: str
    points: list[Point]


@dataclass(frozen=True, slots=True)
class SpeedChart:
    """Speeds over time on one pair of axes; px.

    Args:
        lines: by participant.
        ticks_s: times with their x.
        ticks_mps: speeds with their y.
        trigger_px: x of the trigger as planned.
        limit_px: y of the site's speed limit.
    """

    lines: list[SpeedLine]
    ticks_s: list[Point]
    ticks_mps: list[Point]
    trigger_px: float
    limit_px: float


def speed_lines(task: Task) -> tuple[list[SpeedLine], float]:
    """Return planned speeds of VUT and objects, and the trigger's expected time, s.

    The VUT's driver and the adaptation may deviate from them within the limits.
    """
    approach = task.run.vut.approach
    if approach is None:
        return [], 0.0
    vut = _driven(approach)
    x, y = vut.columns[1] - task.trigger.expected.x_m, vut.columns[2] - task.trigger.expected.y_m
    fires_s = float(vut.columns[0][int(np.argmin(np.hypot(x, y)))])
    lines = [SpeedLine("vut", VUT_ID, _sampled(vut))]
    triggers = {trigger.object_id: trigger for trigger in task.run.triggers}
    for target in task.run.targets:
        before = [] if target.approach is None else _sampled(_driven(target.approach))
        trigger = triggers.get(target.id)
        if trigger is None or isinstance(trigger.manoeuvre, Hold):
            lines.append(SpeedLine("ot", target.id, before))
            continue
        begins_s = fires_s + trigger.lead_time_s
        points_before = [(t, v) for t, v in before if t < begins_s] or [(0.0, 0.0), (begins_s, 0.0)]
        after = _after(task, trigger, points_before[-1][1])
        lines.append(
            SpeedLine(
                "ot", target.id, [*points_before, *((begins_s + t, v) for t, v in _sampled(after))]
            )
        )
    return lines, fires_s


def _driven(motion: Motion) -> Points:
    return drive_along(
        Polyline(motion.path),
        0.0,
        0.0,
        motion.cruise_mps,
        motion.acceleration_mps2,
        motion.deceleration_mps2,
    )


def _after(task: Task, trigger: TriggerSpec, speed_mps: float) -> Points:
    """Return points of what a trigger sets off, from its own beginning."""
    manoeuvre = trigger.manoeuvre
    if isinstance(manoeuvre, FollowPath):
        return _driven(manoeuvre.motion)
    changed = _changed_lane(task, trigger)
    if changed is not None:
        return changed
    target = next(spec for spec in task.run.targets if spec.id == trigger.object_id)
    if not isinstance(manoeuvre, Brake) or target.approach is None:
        return Points(np.zeros((7, 0)))
    path, station = Polyline(target.approach.path), _acts_at_m(task, trigger)
    return brake_along(path, station, speed_mps, manoeuvre.to_mps, manoeuvre.deceleration_mps2)


def _sampled(points: Points) -> list[Point]:
    """Return speeds at even times, and at the end."""
    times, speeds = points.columns[0], points.columns[4]
    if len(times) == 0:
        return []
    at = np.append(np.arange(0.0, times[-1], _STEP_S), times[-1])
    samples_mps = np.interp(at, times, speeds)
    return list(zip(at.tolist(), samples_mps.tolist(), strict=True))


def speed_chart(task: Task) -> SpeedChart:
    """Draw the speeds."""
    lines, fires_s = speed_lines(task)
    last_s = max((t for line in lines for t, _ in line.points), default=1.0)
    top_mps = max(task.limits.speed_mps, *(v for line in lines for _, v in line.points)) * 1.05
    step_s = next(s for s in (1, 2, 5, 10, 20, 50, 100, 1000) if last_s / s <= 15)
    step_mps = next(s for s in (1, 2, 5, 10, 20, 50) if top_mps / s <= 8)

    def place(t_s: float, v_mps: float) -> Point:
        return (
            _LEFT_PX + t_s / last_s * (WIDTH_PX - _LEFT_PX - _RIGHT_PX),
            HEIGHT_PX - _FOOT_PX - v_mps / top_mps * (HEIGHT_PX - _TOP_PX - _FOOT_PX),
        )

    return SpeedChart(
        [SpeedLine(one.kind, one.name, [place(*p) for p in one.points]) for one in lines],
        [(t, place(t, 0.0)[0]) for t in np.arange(0.0, last_s, step_s).tolist()],
        [(v, place(0.0, v)[1]) for v in np.arange(0.0, top_mps, step_mps).tolist()],
        place(fires_s, 0.0)[0],
        place(0.0, task.limits.speed_mps)[1],
    )
