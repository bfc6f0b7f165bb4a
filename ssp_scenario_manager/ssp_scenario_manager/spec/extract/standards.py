"""What a candidate says where a video can't: the needs of part C, by documented defaults.

They are a platform's ordinary needs, wide enough for the kinds of interaction that come with the
project, and marked ``standard`` and unreviewed in part U: a person confirms or edits each
(METHOD 1, review). `docs/extraction-and-review.md` lists them.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import get_args

from ssp_scenario_manager.interactions.base import Kind
from ssp_scenario_manager.spec.model import (
    BoundaryWord,
    CameraNeed,
    Interval,
    ManoeuvreWord,
    RoadTypeWord,
    SafetyNeed,
    SiteNeed,
    Thresholds,
)

SOURCE = "default of `ssp spec extract`"


def _interval(low: float | None, high: float | None, unit: str) -> Interval:
    return Interval(min=low, max=high, unit=unit)


# A camera that shows neighbouring lanes and kerbs, at a rate that METHOD 6.1 can match.
CAMERA = CameraNeed(
    hfov=_interval(60, 100, "deg"),
    width=_interval(640, None, "px"),
    rate=_interval(10, 60, "Hz"),
    visible_fraction=_interval(0.8, 1, "1"),
)
# Where a place may differ from the source in T, as long as the event takes place there.
ROAD_WORDS: dict[str, tuple[str, ...]] = {
    "road_type": get_args(RoadTypeWord),
    "left_boundary": get_args(BoundaryWord),
    "right_boundary": get_args(BoundaryWord),
    "permitted_manoeuvres": get_args(ManoeuvreWord),
}
ROAD_RANGES = {
    "lane_width": _interval(3, 4.2, "m"),
    "curvature": _interval(0, 0.001, "1/m"),
}


def road_words(name: str, shown: Collection[str]) -> dict[str, object]:
    """How a field of words may differ: any word; of manoeuvres, what the source doesn't show."""
    words = ROAD_WORDS[name]
    if name == "permitted_manoeuvres":
        words = tuple(word for word in words if word not in shown)
    return {"varies": words} if words else {"identity": True}


# Room to reach city speed, for the event, and to stop from it.
SITE = SiteNeed(
    length=_interval(250, None, "m"),
    lateral_clearance=_interval(1.5, None, "m"),
)
# Ω_safe of closed-track sessions with soft targets.
SAFETY = SafetyNeed(
    speed=_interval(None, 15, "m/s"),
    acceleration=_interval(None, 4.5, "m/s^2"),
    separation=_interval(0.5, None, "m"),
    duration=_interval(None, 60, "s"),
)


def thresholds(kind: Kind) -> Thresholds:
    """When a conflict begins: METHOD 1's defaults, the arrival gap where the kind compares one."""
    default = Thresholds()
    return default if kind.uses_arrival_gap else default.model_copy(update={"arrival_gap": None})
