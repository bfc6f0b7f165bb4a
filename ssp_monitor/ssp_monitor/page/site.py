"""The part of the map that stands still, as the page gets it: once, in JSON values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.values import Point
from ssp_monitor.core.drawing import Drawing, drawing_of

# A line of more points is thinned: on a screen nobody would see the difference.
MOST_POINTS = 600


def site_message(run: RunSpec | None) -> dict[str, Any]:
    """The drawing of a run; ``known`` is false, and nothing is drawn, without a run file."""
    if run is None:
        return {"known": False}
    drawing = drawing_of(run)
    return {
        "known": True,
        "name": run.site,
        "scenario": run.scenario,
        "camera": run.camera is not None,
        "bounds": list(drawing.bounds_m),
        "fence": _line(drawing.fence),
        "lines": [
            {"kind": one.kind, "opposed": one.opposed, "points": _line(one.points)}
            for one in drawing.road_lines
        ],
        "crossing": _line(drawing.crossing or ()),
        "routes": _routes(drawing),
        "starts": [
            {
                "id": one.object_id,
                "role": one.role.name,
                "at": [round(c, 3) for c in one.centre],
                "yaw": round(one.yaw_rad, 4),
                "radius": one.radius_m,
            }
            for one in drawing.starts
        ],
        "zones": [{"name": z.name, "points": _line(z.outline)} for z in drawing.conflict_zones],
        "anchors": [{"name": a.name, "at": [round(c, 3) for c in a.at]} for a in drawing.anchors],
        "regions": [{"name": r.name, "points": _line(r.outline)} for r in drawing.regions],
    }


def _routes(drawing: Drawing) -> list[dict[str, Any]]:
    return [
        {
            "id": one.object_id,
            "role": one.role.name,
            "purpose": one.purpose,
            "points": _line(one.points),
        }
        for one in drawing.routes
    ]


def _line(points: Sequence[Point]) -> list[list[float]]:
    step = max(1, -(-len(points) // MOST_POINTS))
    kept = [*points[:-1:step], *points[-1:]]
    return [[round(x, 3), round(y, 3)] for x, y in kept]
