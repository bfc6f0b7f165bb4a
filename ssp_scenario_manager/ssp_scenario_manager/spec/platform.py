"""What the platforms can do, whatever the event: the limits that C5 holds every quantity against.

They are wide on purpose. What one site allows stands in its file, and what one event allows in its
part C; here stands what no vehicle, dummy, camera or track of a closed-track session goes beyond.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from ssp_scenario_manager.spec.fields import matches
from ssp_scenario_manager.spec.units import Span

# range: both ends; floor: at least min; ceiling: at most max; exact: one value, min = max.
Shape = Literal["range", "floor", "ceiling", "exact"]


@dataclass(frozen=True, slots=True)
class Platform:
    """Limits in SI units (px, Hz and shares as they are)."""

    speed: Span
    acceleration: Span
    separation: Span
    duration: Span
    clip: Span
    lane_width: Span
    curvature: Span
    gap: Span
    trigger_distance: Span
    trigger_time: Span
    threshold: Span
    time_gap: Span
    manoeuvre_time: Span
    manoeuvre_length: Span
    hfov: Span
    width: Span
    camera_rate: Span
    source_rate: Span
    share: Span
    site_length: Span
    lateral_clearance: Span


PLATFORM = Platform(
    speed=Span(0.0, 16.0),
    acceleration=Span(0.1, 5.0),
    separation=Span(0.3, 10.0),
    duration=Span(10.0, 120.0),
    clip=Span(0.0, 120.0),
    lane_width=Span(2.5, 5.0),
    curvature=Span(0.0, 0.1),
    gap=Span(0.0, 200.0),
    trigger_distance=Span(2.0, 100.0),
    trigger_time=Span(0.5, 10.0),
    threshold=Span(0.5, 10.0),
    time_gap=Span(0.0, 20.0),
    manoeuvre_time=Span(0.5, 10.0),
    manoeuvre_length=Span(0.1, 20.0),
    hfov=Span(math.radians(20.0), math.radians(140.0)),
    width=Span(64.0, 4096.0),
    camera_rate=Span(1.0, 60.0),
    source_rate=Span(1.0, 240.0),
    share=Span(0.5, 1.0),
    site_length=Span(20.0, 2000.0),
    lateral_clearance=Span(0.1, 50.0),
)


@dataclass(frozen=True, slots=True)
class Rule:
    """How a quantity is given, and the name of its limit in `Platform`."""

    shape: Shape
    limit: str


RULES: dict[str, Rule] = {
    "source.rate": Rule("exact", "source_rate"),
    "topology.lane_width.*": Rule("range", "lane_width"),
    "topology.curvature.*": Rule("range", "curvature"),
    "participants.*.region.gap": Rule("range", "gap"),
    "events.clip.*": Rule("exact", "clip"),
    "events.*.start": Rule("range", "clip"),
    "constraints.speeds.*.*": Rule("range", "speed"),
    "constraints.time_gap": Rule("range", "time_gap"),
    "constraints.thresholds.*": Rule("exact", "threshold"),
    "constraints.camera.hfov": Rule("range", "hfov"),
    "constraints.camera.width": Rule("floor", "width"),
    "constraints.camera.rate": Rule("range", "camera_rate"),
    "constraints.camera.visible_fraction": Rule("range", "share"),
    "constraints.site.length": Rule("floor", "site_length"),
    "constraints.site.lateral_clearance": Rule("floor", "lateral_clearance"),
    "constraints.safety.speed": Rule("ceiling", "speed"),
    "constraints.safety.acceleration": Rule("ceiling", "acceleration"),
    "constraints.safety.separation": Rule("floor", "separation"),
    "constraints.safety.duration": Rule("ceiling", "duration"),
}
# By dimension, where the field's meaning depends on the event.
_TRIGGER = {"length": Rule("range", "trigger_distance"), "time": Rule("range", "trigger_time")}
_MANOEUVRE = {
    "speed": Rule("range", "speed"),
    "acceleration": Rule("range", "acceleration"),
    "time": Rule("range", "manoeuvre_time"),
    "length": Rule("range", "manoeuvre_length"),
}


def rule_of(path: str, dimension: str) -> Rule | None:
    """How the quantity at a path is to be given; None for a field without a rule."""
    if path == "constraints.trigger.below":
        return _TRIGGER.get(dimension)
    if path.startswith("constraints.manoeuvre."):
        return _MANOEUVRE.get(dimension)
    return next((rule for pattern, rule in RULES.items() if matches(path, pattern)), None)


def limit_of(rule: Rule) -> Span:
    """The platform's limit of a rule."""
    limit = getattr(PLATFORM, rule.limit)
    if not isinstance(limit, Span):
        raise TypeError(f"{rule.limit} is no limit")
    return limit
