"""The road of a K* from above, with who stands where and what the initiator does."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from ssp_scenario_manager.spec import drawing as d
from ssp_scenario_manager.spec.checks.base import show
from ssp_scenario_manager.spec.fields import get
from ssp_scenario_manager.spec.model import UNRESOLVED, CountField, Event
from ssp_scenario_manager.spec.seal import body

_LANE, _SIDE = 46.0, 34.0
_WALKERS = ("pedestrian", "cyclist")
_LENGTHS = {"truck": 108.0, "bus": 118.0, "motorcycle": 34.0}
# Where along the sketch somebody stands; it isn't to scale.
_VUT_X, _INITIATOR_X, _OCCLUDER_X, _OTHER_X = 120.0, 560.0, 480.0, 700.0
_BEHIND_X = 40.0


@dataclass(frozen=True)
class _Strip:
    """A lane or a kerb of the sketch: its place's name, upper edge and height."""

    place: str
    top: float
    height: float

    @property
    def middle(self) -> float:
        return self.top + self.height / 2


def road_scene(event: Event, x: float, top: float, width: float) -> tuple[list[str], float]:
    """The sketch, and where it ends below.

    The VUT drives to the right, so that its left is up. Distances are written, not drawn to scale.
    """
    strips = _strips(event, top)
    shapes = [_ground(strip, x, width) for strip in strips.values()]
    shapes += _markings(list(strips.values()), x, width)
    shapes += [
        d.text(x + width - 10, strip.middle + 4, _name(event, strip.place), size=11,
               colour=d.MARKING if _is_lane(strip.place) else d.INK, anchor="end")
        for strip in strips.values()
    ]  # fmt: skip
    shapes += _manoeuvre(event, strips, x)
    shapes += _participants(event, strips, x)
    last = list(strips.values())[-1]
    return shapes, last.top + last.height


def _is_lane(place: str) -> bool:
    return place.endswith("lane")


def _strips(event: Event, top: float) -> dict[str, _Strip]:
    """From the VUT's left to its right."""
    t = event.topology
    starts = {who.region.place for who in event.participants.values()}
    several, vut_lane = _lanes(t.lanes_same_direction) > 1, t.vut_lane.value
    wanted = {
        "left_kerb": True,
        "oncoming_lane": _lanes(t.lanes_opposite) > 0,
        "left_lane": "left_lane" in starts or (several and vut_lane in ("rightmost", "middle")),
        "vut_lane": True,
        "right_lane": "right_lane" in starts or (several and vut_lane in ("leftmost", "middle")),
        "right_kerb": True,
    }
    strips: dict[str, _Strip] = {}
    for place, there in wanted.items():
        if there:
            height = _LANE if _is_lane(place) else _SIDE
            strips[place] = _Strip(place, top, height)
            top += height
    return strips


def _lanes(field: CountField) -> int:
    """As many as the source shows; where that isn't known, as there may be."""
    if field.value != UNRESOLVED:
        return field.value
    return field.varies.max if field.varies else 1


def _name(event: Event, place: str) -> str:
    side = place.removesuffix("_kerb")
    if side != place:
        boundary = getattr(event.topology, f"{side}_boundary").value
        return f"{side} side" + ("" if boundary == UNRESOLVED else f": {boundary}")
    return place.replace("_", " ").replace("vut", "VUT's")


def _ground(strip: _Strip, x: float, width: float) -> str:
    fill = d.ROAD if _is_lane(strip.place) else d.KERB
    return d.box(x, strip.top, width, strip.height, fill)


def _markings(strips: list[_Strip], x: float, width: float) -> list[str]:
    """Dashed between lanes of one direction, solid before oncoming ones and at the edges."""
    shapes = []
    for above, below in pairwise(strips):
        lanes = _is_lane(above.place) and _is_lane(below.place)
        dashed = lanes and above.place != "oncoming_lane"
        shapes.append(d.line([(x, below.top), (x + width, below.top)], d.MARKING, dashed=dashed))
    return shapes


def _station(event: Event, who: str, x: float) -> float:
    participant = event.participants[who]
    if participant.region.along == "behind":
        return x + _BEHIND_X
    if participant.role == "VUT" or participant.region.along in ("at", "beside"):
        return x + _VUT_X
    if who == event.interaction.initiator:
        return x + _INITIATOR_X
    return x + (_OCCLUDER_X if who == event.interaction.occluder else _OTHER_X)


def _manoeuvre(event: Event, strips: dict[str, _Strip], x: float) -> list[str]:
    """The VUT's way to the conflict zone, the zone, and how the initiator gets there."""
    who, own = event.interaction.initiator, strips["vut_lane"]
    start = event.participants[who].region.place if who in event.participants else "vut_lane"
    at = _station(event, who, x) if who in event.participants else x + _INITIATOR_X
    relation = event.interaction.relation
    spans = {"merge": (110.0, 330.0), "crossing": (-34.0, 34.0), "following": (-40.0, 180.0)}
    left, right = (at + end for end in spans[relation])
    way = [(x + _VUT_X + 40, own.middle), (left - 6, own.middle)]
    shapes = [
        d.box(left, own.top + 3, right - left, own.height - 6, "url(#hatch)", edge=d.CONFLICT),
        d.arrow(way, d.PAPER, dashed=True),
    ]
    origin = strips.get(start, own)
    if relation == "merge":
        shapes.append(d.curve((at + 40, origin.middle), (at + 240, own.middle), d.OT))
    elif relation == "crossing":
        upwards = origin.middle > own.middle
        beyond = own.top - 16 if upwards else own.top + own.height + 16
        shapes.append(d.arrow([(at, origin.middle), (at, beyond)], d.OT, width=3))
    else:
        shapes.append(d.arrow([(at + 40, own.middle), (at + 120, own.middle)], d.OT, width=3))
        shapes += [
            d.line([(at + 134 + 9 * i, own.middle - 11), (at + 134 + 9 * i, own.middle + 11)], d.OT)
            for i in range(3)
        ]
    return shapes


def _participants(event: Event, strips: dict[str, _Strip], x: float) -> list[str]:
    shapes, value = [], body(event)
    for who, participant in event.participants.items():
        place = strips.get(participant.region.place, strips["vut_lane"])
        at = _station(event, who, x)
        colour = d.OCCLUDER
        if participant.role == "VUT":
            colour = d.VUT
        elif who == event.interaction.initiator:
            colour = d.OT
        if participant.class_ in _WALKERS:
            shapes.append(d.person(at, place.middle, colour))
            label = at + 20
        else:
            length = _LENGTHS.get(participant.class_, 66.0)
            # An occluder stands behind whom it hides, seen from the VUT nearer.
            at = min(at, x + _INITIATOR_X - 20 - length / 2) if colour == d.OCCLUDER else at
            shapes.append(d.vehicle(at, place.middle, length, 24.0, colour))
            label = at + length / 2 + 8
        above = place.middle + 4 if _is_lane(place.place) else place.middle + 5
        ink = d.MARKING if _is_lane(place.place) else d.INK
        gap = show(get(value, f"participants.{who}.region.gap"))
        words = who if participant.role == "VUT" else f"{who}, {gap} {participant.region.along}"
        if colour == d.OCCLUDER:
            shapes.append(
                d.text(at - 8 - _LENGTHS.get(participant.class_, 66.0) / 2, above, words, size=12,
                       colour=ink, bold=True, anchor="end")
            )  # fmt: skip
        elif colour == d.OT and place.place == "vut_lane":
            # Beyond its manoeuvre: before it runs the VUT's own way.
            shapes.append(d.text(at + 192, above, words, size=12, colour=ink, bold=True))
        elif colour == d.OT and not _is_lane(place.place):
            shapes.append(d.text(label, above, words, size=12, colour=ink, bold=True))
        else:
            shapes.append(
                d.text(at - 42, above, words, size=12, colour=ink, bold=True, anchor="end")
            )
    return shapes
