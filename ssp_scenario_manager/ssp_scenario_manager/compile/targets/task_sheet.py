"""The task sheet, which the person responsible for safety reads and signs: one HTML page."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from ssp_core.files.writing import write_text
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.templates import templates
from ssp_scenario_manager.compile.compiler import CompiledEvent
from ssp_scenario_manager.compile.targets.task_picture import (
    HEIGHT_PX,
    ROW_PX,
    WIDTH_PX,
    speed_chart,
    top_view,
)
from ssp_scenario_manager.compile.task import Task

SHEET_FILE = "task.html"
# Unit of a limit by the end of its name.
_UNITS = {"mps": "m/s", "mps2": "m/s²", "m": "m", "s": "s", "rad": "rad"}
_OF_STARTS = "start_"


@dataclass(frozen=True, slots=True)
class LimitRow:
    """One limit as the sheet shows it.

    Args:
        name: of its field, where it can be changed on site.
    """

    name: str
    words: str
    value: str


@dataclass(frozen=True, slots=True)
class StartRow:
    """The pose in which a participant must stand to be armed; angles in degrees.

    Args:
        heading_deg: from east, counter-clockwise.
        bearing_deg: from north, clockwise.
        body: how far it reaches from its reference point, in words.
    """

    name: str
    what: str
    x_m: float
    y_m: float
    heading_deg: float
    bearing_deg: float
    body: str


def write_sheet(compiled: CompiledEvent, folder: Path) -> Path:
    """Write task.html into a compiled folder."""
    path = folder / SHEET_FILE
    write_text(path, sheet(compiled.task))
    return path


def sheet(task: Task) -> str:
    """Return the page of a task."""
    rows = [
        (name, kind, place)
        for name, anchors in sorted(task.anchors.items())
        for kind, place in (("start", anchors.start), ("goal", anchors.goal))
    ]
    rows.append(("all", "conflict point", task.anchors[VUT_ID].conflict))
    rows += [("zone", f"corner {k}", corner) for k, corner in enumerate(task.conflict_zone, 1)]
    limits = limit_rows(task)
    page = templates(Path(__file__).parent).get_template("task.html.j2")
    return page.render(
        task=task,
        view=top_view(task),
        chart=speed_chart(task),
        chart_size=(WIDTH_PX, HEIGHT_PX),
        row_px=ROW_PX,
        anchors=[(name, kind, p.s_m, p.l_m, p.x_m, p.y_m) for name, kind, p in rows],
        starts=[start_row(spec) for spec in (task.run.vut, *task.run.targets)],
        tolerances=[row for row in limits if row.name.startswith(_OF_STARTS)],
        corners=list(enumerate(task.geofence, 1)),
        limits=limits,
    )


def limit_rows(task: Task) -> list[LimitRow]:
    """Return every field of the limits, with words, the value that counts and its unit."""
    values = {name: getattr(task.limits, name) for name in Limits.model_fields}
    values["trigger_age_s"] = task.run.trigger_age_s
    return [LimitRow(name, _words(name), _value(name, value)) for name, value in values.items()]


def _parts(name: str) -> tuple[str, str]:
    """Return a field's name in words, and its unit."""
    words, _, suffix = name.rpartition("_")
    if suffix not in _UNITS:
        return name.replace("_", " "), ""
    return words.replace("_", " "), _UNITS[suffix]


def _words(name: str) -> str:
    words = _parts(name)[0]
    description = Limits.model_fields[name].description
    return f"{words}: {description}" if description else words


def _value(name: str, value: object) -> str:
    if isinstance(value, list):
        return ", ".join(value) or "none"
    if not isinstance(value, float | int) or isinstance(value, bool):
        return str(value)
    unit = _parts(name)[1]
    degrees = f" ({math.degrees(value):.0f}°)" if unit == "rad" else ""
    return f"{value:g} {unit}".strip() + degrees


def start_row(spec: ParticipantSpec) -> StartRow:
    """Place and heading of a participant's start."""
    heading_deg = math.degrees(spec.start.yaw_rad) % 360.0
    size = spec.size
    return StartRow(
        spec.id,
        spec.object_class,
        spec.start.x_m,
        spec.start.y_m,
        heading_deg,
        (90.0 - heading_deg) % 360.0,
        f"{size.front_m:g} m ahead, {size.rear_m:g} m behind, {size.width_m:g} m wide",
    )
