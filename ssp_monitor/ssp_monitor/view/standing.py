"""Marks of what stands still: fence, road, routes, start regions, conflict zones, anchors."""

from __future__ import annotations

from collections.abc import Iterator

from ssp_core.geometry import Pose2
from ssp_core.vocabulary import Role
from ssp_monitor.core.drawing import Drawing
from ssp_monitor.view.marks import Colour, Mark, Shape, circle, line, text

FENCE = Colour(0.85, 0.15, 0.15)
EDGE = Colour(0.75, 0.75, 0.75)
DIVIDER = Colour(0.6, 0.6, 0.6, 0.7)
OPPOSED = Colour(0.9, 0.75, 0.2, 0.9)
CENTRE = Colour(0.5, 0.5, 0.5, 0.25)
REFERENCE = Colour(0.3, 0.6, 0.9, 0.4)
CROSSING = Colour(0.9, 0.9, 0.9, 0.8)
VUT_ROUTE = Colour(0.15, 0.45, 0.85, 0.8)
OT_ROUTE = Colour(0.9, 0.5, 0.1, 0.8)
CONFLICT = Colour(0.9, 0.1, 0.5, 0.9)
REGION = Colour(0.6, 0.3, 0.8, 0.7)
_LINES = {"edge": (EDGE, 0.15), "centre": (CENTRE, 0.08), "reference": (REFERENCE, 0.08)}


def standing_marks(drawing: Drawing) -> tuple[Mark, ...]:
    """The marks of a run's drawing."""
    return (
        line("fence", 0, drawing.fence, FENCE, 0.3, closed=True),
        *_road(drawing),
        *_objects(drawing),
        *_event(drawing),
    )


def _road(drawing: Drawing) -> Iterator[Mark]:
    for number, one in enumerate(drawing.road_lines):
        if one.kind == "divider":
            colour, width_m = (OPPOSED if one.opposed else DIVIDER), 0.12
        else:
            colour, width_m = _LINES[one.kind]
        yield line("road", number, one.points, colour, width_m, 0.01)
    if drawing.crossing is not None:
        yield line("crossing", 0, drawing.crossing, CROSSING, 0.2, closed=True)


def _objects(drawing: Drawing) -> Iterator[Mark]:
    for number, route in enumerate(drawing.routes):
        colour = VUT_ROUTE if route.role is Role.VUT else OT_ROUTE
        yield line("route", number, route.points, colour, 0.15, 0.03)
    for number, start in enumerate(drawing.starts):
        colour = VUT_ROUTE if start.role is Role.VUT else OT_ROUTE
        yield line(
            "start", number, circle(start.centre, start.radius_m), colour, 0.1, 0.03, closed=True
        )
        ahead = Pose2(*start.centre, start.yaw_rad).to_parent(start.radius_m, 0.0)
        yield line("start heading", number, (start.centre, ahead), colour, 0.1, 0.03)


def _event(drawing: Drawing) -> Iterator[Mark]:
    for number, zone in enumerate(drawing.conflict_zones):
        yield line("conflict zone", number, zone.outline, CONFLICT, 0.2, 0.04, closed=True)
    for number, region in enumerate(drawing.regions):
        yield line("region", number, region.outline, REGION, 0.15, 0.04, closed=True)
    for number, anchor in enumerate(drawing.anchors):
        at = Pose2(*anchor.at, 0.0)
        yield Mark("anchor", number, Shape.CYLINDER, CONFLICT, at, 0.5, (0.5, 0.5, 1.0))
        yield text("anchor name", number, anchor.name, anchor.at, 1.6, CONFLICT)
