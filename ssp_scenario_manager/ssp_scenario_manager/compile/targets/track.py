"""The task sheet: one HTML page with a top view and the figures that people on a track need."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

from ssp_core.files import write_text
from ssp_core.geometry import Box, Polyline
from ssp_core.motion.manoeuvre import lane_change
from ssp_core.names import VUT_ID
from ssp_core.run_file.participants import FollowPath, LaneChange, TriggerSpec
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.compile.compiler import Compiled
from ssp_scenario_manager.compile.task import Place, Task
from ssp_scenario_manager.dispatch.references import run_out_end_m

SHEET_FILE = "task.html"
_WIDTH = 1100
_MARGIN = 24

_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 1.5rem auto; max-width: 1150px; color: #222 }
h1 { font-size: 1.4rem } h2 { font-size: 1.1rem; margin-top: 1.6rem }
table { border-collapse: collapse } td, th { padding: .2rem .8rem .2rem 0; text-align: left }
td.n { text-align: right; font-variant-numeric: tabular-nums } code { font-size: .85em }
.warn { background: #fff3cd; border-left: 4px solid #e0a800; padding: .5rem .8rem }
svg { width: 100%; height: auto; background: #f7f7f4; border: 1px solid #ddd }
.road { fill: #cfcfcf } .lane { stroke: #fff; stroke-dasharray: 6 6; fill: none }
.fence { fill: none; stroke: #c62828; stroke-width: 1.5 }
.stop { fill: #2e7d32; opacity: .18 } .zone { fill: #ef6c00; opacity: .55 }
.vut { stroke: #1565c0; fill: none; stroke-width: 2 } .ot { stroke: #6a1b9a; fill: none;
stroke-width: 2 } .act { stroke: #6a1b9a; fill: none; stroke-width: 2; stroke-dasharray: 4 3 }
.fire { fill: none; stroke: #1565c0; stroke-width: 2 } text { font: 12px system-ui, sans-serif }
"""


def write_sheet(compiled: Compiled, folder: Path) -> Path:
    """Writes task.html into a compiled folder."""
    path = folder / SHEET_FILE
    write_text(path, sheet(compiled.task))
    return path


def sheet(task: Task) -> str:
    """The page of a task."""
    title = f"{task.event.name} on {task.place.name}, block {task.block.id}"
    parts = [
        f"<h1>{escape(title)}</h1>",
        _warning(task),
        _picture(task),
        _legend(),
        _trigger(task),
        _anchors(task),
        _values(task),
        _limits(task),
        _origin(task),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + "\n</body></html>\n"
    )


def _warning(task: Task) -> str:
    notes = []
    if task.target == "track" and task.validated_by is None:
        notes.append(
            "These anchors are not validated: no simulation run was named with --validated-by."
        )
    if task.run.stand_in:
        notes.append("This site is a software stand-in, not a proving ground.")
    return "".join(f'<p class="warn">{escape(note)}</p>' for note in notes)


# -- tables --------------------------------------------------------------------------------------


def _table(head: Sequence[str], rows: Iterable[Sequence[str | float]]) -> str:
    top = "".join(f"<th>{escape(word)}</th>" for word in head)
    body = "".join("<tr>" + "".join(_cell(value) for value in row) + "</tr>" for row in rows)
    return f"<table><tr>{top}</tr>{body}</table>"


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return f"<td>{escape(value)}</td>"
    return f'<td class="n">{value:.2f}</td>'


def _place(place: Place) -> list[float]:
    return [place.s_m, place.l_m, place.x_m, place.y_m]


def _trigger(task: Task) -> str:
    what = {
        "relative_distance": "Gap of the VUT to",
        "time_to_arrival": "Time of the VUT to the path of",
    }
    t = task.trigger
    return (
        f"<h2>Trigger</h2><p>{escape(what[t.quantity])} {escape(t.object_id)} below "
        f"{t.below:g} {escape(t.unit)}; expected with the VUT at s = {t.expected.s_m:.1f} m.</p>"
    )


def _anchors(task: Task) -> str:
    rows: list[list[str | float]] = []
    for name, anchors in sorted(task.anchors.items()):
        rows.append([name, "start", *_place(anchors.start)])
        rows.append([name, "goal", *_place(anchors.goal)])
    rows.append(["all", "conflict point", *_place(task.anchors[VUT_ID].conflict)])
    rows += [["zone", "corner", *_place(corner)] for corner in task.conflict_zone]
    head = ("participant", "anchor", "s (m)", "l (m)", "x (m)", "y (m)")
    return "<h2>Anchors</h2>" + _table(head, rows)


def _values(task: Task) -> str:
    rows = [
        [t.field, f"{t.value:g} {t.unit}", _interval(t.min, t.max), t.reason] for t in task.tunings
    ]
    return "<h2>Values chosen within K*</h2>" + _table(("field", "value", "K*", "why"), rows)


def _interval(low: float | None, high: float | None) -> str:
    if low is None and high is None:
        return "–"
    return f"{'…' if low is None else f'{low:g}'} to {'…' if high is None else f'{high:g}'}"


def _limits(task: Task) -> str:
    values = task.limits.model_dump()
    shown = {name: "–" if value is None else f"{value:g}" for name, value in values.items()}
    return "<h2>Limits</h2>" + _table(("limit", "value"), [list(pair) for pair in shown.items()])


def _origin(task: Task) -> str:
    rows = [
        ["event", task.event.version],
        ["task", task.version],
        [task.place.kind, task.place.sha256],
        ["compiler", task.compiler],
        ["seed", str(task.seed)],
        ["block chosen by", task.chosen_by],
        ["validated by", task.validated_by.run_id if task.validated_by else "nothing"],
    ]
    return "<h2>Made from</h2>" + _table(("", ""), rows)


# -- picture -------------------------------------------------------------------------------------


class _View:
    """Frame map turned so that the block lies along the page, scaled to fit."""

    def __init__(self, task: Task, outline: Sequence[Point]) -> None:
        origin = task.run.road.origin.pose
        end = ReferenceLine.of_road(task.run.road).pose(task.block.length_m)
        turn = math.atan2(end.y_m - origin.y_m, end.x_m - origin.x_m)
        self._c, self._s = math.cos(turn), math.sin(turn)
        shown = [self._turned(p) for p in [*outline, *task.vut_route]]
        shown += [self._turned((p.x_m, p.y_m)) for p in task.conflict_zone]
        margin = 12.0
        self._left = min(x for x, _ in shown) - margin
        self._top = max(y for _, y in shown) + margin
        wide = max(x for x, _ in shown) + margin - self._left
        high = self._top - (min(y for _, y in shown) - margin)
        self.scale = (_WIDTH - 2 * _MARGIN) / wide
        # A straight is long and narrow: it is drawn three times as wide as it is.
        self.stretch = min(3.0, max(1.0, 0.35 * wide / high))
        self.height = high * self.scale * self.stretch + 2 * _MARGIN

    def _turned(self, point: Point) -> Point:
        x, y = point
        return self._c * x + self._s * y, -self._s * x + self._c * y

    def at(self, point: Point) -> Point:
        """Pixels of a place in frame map."""
        x, y = self._turned(point)
        return (
            _MARGIN + (x - self._left) * self.scale,
            _MARGIN + (self._top - y) * self.scale * self.stretch,
        )

    def path(self, points: Iterable[Point], css: str, closed: bool = False) -> str:
        spots = " ".join(f"{x:.1f},{y:.1f}" for x, y in (self.at(p) for p in points))
        tag = "polygon" if closed else "polyline"
        return f'<{tag} class="{css}" points="{spots}"/>'

    def dot(self, place: Place, css: str, text: str) -> str:
        x, y = self.at((place.x_m, place.y_m))
        return (
            f'<circle class="{css}" cx="{x:.1f}" cy="{y:.1f}" r="2"/>'
            f'<text x="{x + 6:.1f}" y="{y - 6:.1f}">{escape(text)}</text>'
        )


def _edges(task: Task) -> tuple[list[Point], list[list[Point]]]:
    """Outline of the carriageway, and the lines between its lanes."""
    road, line = task.run.road, ReferenceLine.of_road(task.run.road)
    length = task.block.length_m
    try:
        right = line.path(0.0, length, road.right_edge_m, 0.05)
        left = line.path(length, 0.0, road.left_edge_m, 0.05)
        inner = sorted(lane.y_m - lane.width_m / 2 for lane in road.lanes)[1:]
        between = [line.path(0.0, length, y, 0.05) for y in inner]
    except NotOneToOne:
        return line.path(0.0, length, 0.0, 0.05), []
    return [*right, *left], between


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


def _picture(task: Task) -> str:
    outline, between = _edges(task)
    view = _View(task, outline)
    parts = [view.path(outline, "road", closed=True)]
    parts += [view.path(line, "lane") for line in between]
    parts += [view.path(region, "stop", closed=True) for region in task.safe_stop_zones]
    parts.append(view.path(task.geofence, "fence", closed=True))
    corners = [(p.x_m, p.y_m) for p in task.conflict_zone]
    parts.append(view.path(corners, "zone", closed=True))
    parts.append(view.path(task.vut_route, "vut"))
    acts = {trigger.object_id: _act(task, trigger) for trigger in task.run.triggers}
    for target in task.run.targets:
        act = acts.get(target.id)
        if target.approach is not None:
            parts.append(view.path(act[0] if act else target.approach.path, "ot"))
        if act:
            parts.append(view.path(act[1], "act"))
    for spec in (task.run.vut, *task.run.targets):
        box = Box(spec.start.pose, spec.size.front_m, spec.size.rear_m, spec.size.width_m)
        css = "vut" if spec.id == VUT_ID else "ot"
        parts.append(view.path(box.corners(), css, closed=True))
    for name, anchors in sorted(task.anchors.items()):
        parts.append(view.dot(anchors.start, "vut" if name == VUT_ID else "ot", name))
    parts.append(view.dot(task.trigger.expected, "fire", "trigger expected"))
    inner = "\n".join(parts)
    return (
        f'<svg viewBox="0 0 {_WIDTH} {view.height:.0f}" role="img" '
        f'aria-label="top view">\n{inner}\n</svg>'
    )


def _legend() -> str:
    return (
        "<p>Blue: VUT. Violet: object targets, dashed where a trigger sets them off. Orange: "
        "conflict zone. Green: safe-stop zones. Red: geofence. Across the road the picture may be "
        "stretched.</p>"
    )
