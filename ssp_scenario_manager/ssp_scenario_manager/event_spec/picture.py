"""The interaction graph as a picture: the road from above, the phases as swim lanes, the values."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from ssp_core.templates import templates
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.fields import ROAD_FIELD, get, granules, show
from ssp_scenario_manager.event_spec.load import body, event_version
from ssp_scenario_manager.event_spec.model import UNRESOLVED, CountField, Event, MotionCell

_COLOURS = {"vut": "#1f5fbf", "initiator": "#d9730d", "other": "#7a8591"}
# The sketch isn't to scale: heights of its strips, and where along it somebody stands.
_ROAD_TOP, _LEFT = 92.0, 36.0
_LANE, _SIDE = 46.0, 34.0
_VUT_X, _INITIATOR_X, _OCCLUDER_X, _OTHER_X, _BEHIND_X = (
    _LEFT + x for x in (120.0, 560.0, 480.0, 700.0, 40.0)
)
_WALKERS = ("pedestrian", "cyclist")
_LENGTHS = {"truck": 108.0, "bus": 118.0, "motorcycle": 34.0}
_SIGNS = {
    "left": "↰ to its left",
    "right": "↱ to its right",
    "none": "straight on",
    UNRESOLVED: "sideways: unresolved",
}
_GROUPS = {
    "Manoeuvre": "constraints.manoeuvre",
    "Road": "topology",
    "Safety limits": "constraints.safety",
    "Camera": "constraints.camera",
    "Site": "constraints.site",
}


def picture(event: Event) -> str:
    """Draw an SVG file that shows what a K* says, and nothing else."""
    value, c = body(event), event.constraints
    groups = {title: _values(get(value, path)) for title, path in _GROUPS.items()}
    states = [entry.review for entry in event.uncertainty.values()]
    thresholds = (("TTC", c.thresholds.ttc), ("arrivals", c.thresholds.arrival_gap))
    page = templates(Path(__file__).parent).get_template("picture.svg.j2")
    return page.render(
        event=event,
        version=event_version(event),
        interaction=event.interaction,
        colours=_COLOURS,
        road=_road(event, value),
        phases=[{"name": p, "start": _plain(get(value, f"events.{p}.start"))} for p in PHASES],
        rows=[_row(event, who) for who in _in_rows(event)],
        trigger=c.trigger,
        below=_plain(get(value, "constraints.trigger.below")),
        thresholds=" or ".join(f"{n} < {_plain(t.model_dump())}" for n, t in thresholds if t),
        time_gap=_plain(get(value, "constraints.time_gap")),
        groups=groups,
        most_values=max(map(len, groups.values())),
        reviewed=sum(state in ("accepted", "edited") for state in states),
        entries=len(states),
    )


@dataclass(frozen=True)
class _Strip:
    """A lane or a kerb of the sketch: its place's name, what is written on it, and its height."""

    place: str
    name: str
    top: float

    @property
    def is_lane(self) -> bool:
        return self.place.endswith("lane")

    @property
    def height(self) -> float:
        return _LANE if self.is_lane else _SIDE

    @property
    def middle(self) -> float:
        return self.top + self.height / 2


def _road(event: Event, value: dict[str, Any]) -> dict[str, Any]:
    """Sketch the road: the VUT drives to the right, so its left is up. Distances are written."""
    strips = _strips(event)
    by_place = {strip.place: strip for strip in strips}
    own, start = by_place["vut_lane"], event.participants.get(event.interaction.initiator)
    return {
        "strips": strips,
        "borders": list(pairwise(strips)),
        "bottom": strips[-1].top + strips[-1].height,
        "own": own,
        "vut_x": _VUT_X,
        "initiator_x": _station(event, event.interaction.initiator) if start else _INITIATOR_X,
        "origin": by_place.get(start.region.place, own) if start else own,
        "actors": [_actor(event, value, who, by_place) for who in event.participants],
    }


def _strips(event: Event) -> list[_Strip]:
    """List the strips from the VUT's left to its right."""
    t = event.topology
    starts = {who.region.place for who in event.participants.values()}
    several, vut_lane = _lanes(t.lanes_same_direction) > 1, t.vut_lane.value
    presence = {
        "left_kerb": True,
        "oncoming_lane": _lanes(t.lanes_opposite) > 0,
        "left_lane": "left_lane" in starts or (several and vut_lane in ("rightmost", "middle")),
        "vut_lane": True,
        "right_lane": "right_lane" in starts or (several and vut_lane in ("leftmost", "middle")),
        "right_kerb": True,
    }
    strips: list[_Strip] = []
    for place in (place for place, there in presence.items() if there):
        top = strips[-1].top + strips[-1].height if strips else _ROAD_TOP
        strips.append(_Strip(place, _name(event, place), top))
    return strips


def _lanes(field: CountField) -> int:
    """Return as many lanes as the source shows; where that isn't known, as many as there may be."""
    if field.value != UNRESOLVED:
        return field.value
    return field.varies.max if field.varies else 1


def _name(event: Event, place: str) -> str:
    side = place.removesuffix("_kerb")
    if side != place:
        boundary = getattr(event.topology, f"{side}_boundary").value
        return f"{side} side" + ("" if boundary == UNRESOLVED else f": {boundary}")
    return place.replace("_", " ").replace("vut", "VUT's")


def _station(event: Event, who: str) -> float:
    participant = event.participants[who]
    if participant.region.along == "behind":
        return _BEHIND_X
    if participant.role == "VUT" or participant.region.along in ("at", "beside"):
        return _VUT_X
    if who == event.interaction.initiator:
        return _INITIATOR_X
    return _OCCLUDER_X if who == event.interaction.occluder else _OTHER_X


def _part(event: Event, who: str) -> str:
    """Return the key of a participant's colour."""
    if event.participants[who].role == "VUT":
        return "vut"
    return "initiator" if who == event.interaction.initiator else "other"


def _actor(
    event: Event, value: dict[str, Any], who: str, strips: dict[str, _Strip]
) -> dict[str, Any]:
    """Return body and label of a participant in the sketch."""
    participant, part = event.participants[who], _part(event, who)
    strip = strips.get(participant.region.place, strips["vut_lane"])
    x, walks = _station(event, who), participant.class_ in _WALKERS
    length = _LENGTHS.get(participant.class_, 66.0)
    if part == "other" and not walks:
        # An occluder stands behind whom it hides, seen from the VUT nearer.
        x = min(x, _INITIATOR_X - 20 - length / 2)
    label, anchor = x - 42, "end"
    if part == "other":
        label = x - 8 - length / 2
    elif part == "initiator" and strip.place == "vut_lane":
        # Beyond its manoeuvre: before it runs the VUT's own way.
        label, anchor = x + 192, "start"
    elif part == "initiator" and not strip.is_lane:
        label, anchor = x + (20 if walks else length / 2 + 8), "start"
    gap = show(get(value, f"participants.{who}.region.gap"))
    return {
        "x": x,
        "y": strip.middle,
        "on_road": strip.is_lane,
        "walks": walks,
        # It faces the VUT.
        "comes": participant.region.place == "oncoming_lane",
        "length": length,
        "colour": _COLOURS[part],
        "label_x": label,
        "anchor": anchor,
        "words": who if part == "vut" else f"{who}, {gap} {participant.region.along}",
    }


def _in_rows(event: Event) -> list[str]:
    """Order the rows: the VUT, the conflicting one next to the zone, an occluder between."""
    others = [who for who in event.participants if who != event.vut_id]
    return [event.vut_id, *sorted(others, key=lambda who: who == event.interaction.initiator)]


def _row(event: Event, who: str) -> dict[str, Any]:
    part, cells = _part(event, who), event.motion.get(who, {})
    role = {"vut": "VUT", "initiator": "OT, initiator"}.get(part, "OT")
    return {
        "name": who,
        "role": "OT, occluder" if who == event.interaction.occluder else role,
        "object_class": event.participants[who].class_,
        "colour": _COLOURS[part],
        "cells": [
            _cell(event, who, column, cells[phase])
            for column, phase in enumerate(PHASES)
            if phase in cells
        ],
    }


def _cell(event: Event, who: str, column: int, cell: MotionCell) -> dict[str, Any]:
    """Return motion, position and side, gap and speed of one participant in one phase."""
    speed = event.constraints.speeds.get(who, {}).get(PHASES[column], UNRESOLVED)
    position_words = [cell.position.replace("_", " ")] if cell.position else []
    if cell.speed_trend != "standing":
        sign = _SIGNS[cell.lateral]
        position_words.append(
            sign.replace("its", "the VUT's") if cell.heading == "opposite" else sign
        )
    gap = f"gap {cell.longitudinal} · " if cell.longitudinal != "none" else ""
    return {
        "column": column,
        "motion": (cell.motion or "drives").replace("_", " "),
        "seen": " · ".join(position_words),
        "trend": f"{gap}speed {cell.speed_trend}",
        "speed": UNRESOLVED if isinstance(speed, str) else _plain(speed.model_dump()),
        "is_open": UNRESOLVED in (cell.motion, cell.position, speed),
    }


def _plain(value: Any) -> str:
    """Return a value as it is written in a picture."""
    return show(value).replace("^2", "²").replace("at least", "≥").replace("at most", "≤")


def _values(part: dict[str, Any]) -> list[tuple[str, str]]:
    """Return quantities and words of a part that no lane shows."""
    rows = []
    for name in granules(part):
        item = get(part, name)
        if isinstance(item, dict) and set(item) == ROAD_FIELD:
            item = _of_road(item)
        if not isinstance(item, list):
            rows.append((name, _plain(item)))
    return rows


def _of_road(field: dict[str, Any]) -> Any:
    """Describe a field of T in a few words: what the source shows, and whether it may vary."""
    value, varies = field["value"], field["varies"]
    if isinstance(varies, dict):  # a range says what a place may have, and holds the value
        return varies
    if varies is None or isinstance(value, list):
        return value
    return "may vary" if value == UNRESOLVED else f"{value}, may vary"
