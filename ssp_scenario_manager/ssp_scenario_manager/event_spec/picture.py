"""The interaction graph as a picture: the road from above, the phases as swim lanes, the values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Any

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.event_spec.fields import ROAD_FIELD, get, granules, show
from ssp_scenario_manager.event_spec.load import body, event_version
from ssp_scenario_manager.event_spec.model import UNRESOLVED, CountField, Event, MotionCell

INK, FAINT, PAPER, LINE = "#1d2733", "#64727f", "#ffffff", "#d5dce3"
VUT, OT, OCCLUDER, CONFLICT = "#1f5fbf", "#d9730d", "#7a8591", "#c0392b"
ROAD, MARKING, KERB = "#596673", "#eef1f4", "#b9c4a9"
# Phase colours: header, and the wash behind its column.
PHASE_COLOURS = {
    "approach": ("#7c8a99", "#f6f8fa"),
    "trigger": ("#d9a30d", "#fdf8e8"),
    "conflict": ("#c0392b", "#fcefed"),
    "resolution": ("#2e8b57", "#eef8f2"),
}
_FONT = "font-family='Inter, Segoe UI, Helvetica, Arial, sans-serif'"


def document(width: float, height: float, title: str, shapes: Sequence[str]) -> str:
    """A whole SVG file."""
    heads = "".join(
        f"<marker id='head{i}' viewBox='0 0 8 8' refX='7' refY='4' markerWidth='7' "
        f"markerHeight='7' orient='auto-start-reverse'><path d='M0,0 L8,4 L0,8 z' "
        f"fill='{colour}'/></marker>"
        for i, colour in enumerate(_ARROWS)
    )
    hatch = (
        "<pattern id='hatch' width='8' height='8' patternUnits='userSpaceOnUse' "
        f"patternTransform='rotate(45)'><rect width='8' height='8' fill='{CONFLICT}' "
        f"fill-opacity='0.18'/><rect width='3' height='8' fill='{CONFLICT}' "
        "fill-opacity='0.55'/></pattern>"
    )
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{width:g}' height='{height:g}' "
        f"viewBox='0 0 {width:g} {height:g}' role='img' {_FONT}>"
        f"<title>{escape(title)}</title><defs>{heads}{hatch}</defs>"
        f"<rect width='{width:g}' height='{height:g}' fill='{PAPER}'/>" + "\n".join(shapes)
    ) + "</svg>\n"


_ARROWS = (INK, VUT, OT, CONFLICT, PAPER, FAINT)


def text(
    x: float,
    y: float,
    words: str,
    *,
    size: float = 13,
    colour: str = INK,
    bold: bool = False,
    anchor: str = "start",
) -> str:
    """One line of text."""
    weight = " font-weight='600'" if bold else ""
    return (
        f"<text x='{x:g}' y='{y:g}' font-size='{size:g}' fill='{colour}' "
        f"text-anchor='{anchor}'{weight}>{escape(words)}</text>"
    )


def box(
    x: float,
    y: float,
    width: float,
    height: float,
    fill: str,
    *,
    edge: str = "none",
    radius: float = 0,
    dashed: bool = False,
) -> str:
    """A rectangle."""
    dash = " stroke-dasharray='5 4'" if dashed else ""
    return (
        f"<rect x='{x:g}' y='{y:g}' width='{width:g}' height='{height:g}' rx='{radius:g}' "
        f"fill='{fill}' stroke='{edge}'{dash}/>"
    )


def line(points: Sequence[tuple[float, float]], colour: str, *, dashed: bool = False) -> str:
    """A polyline without an arrow head."""
    return _path("M" + " L".join(f"{x:g},{y:g}" for x, y in points), colour, dashed, "")


def arrow(
    points: Sequence[tuple[float, float]],
    colour: str,
    *,
    dashed: bool = False,
    both: bool = False,
    width: float = 2,
) -> str:
    """A polyline with an arrow head at its end, or at both."""
    path = "M" + " L".join(f"{x:g},{y:g}" for x, y in points)
    return _path(path, colour, dashed, _heads(colour, both), width)


def curve(start: tuple[float, float], end: tuple[float, float], colour: str) -> str:
    """An S from one lane into another, with an arrow head."""
    (x0, y0), (x1, y1) = start, end
    middle = 0.5 * (x0 + x1)
    path = f"M{x0:g},{y0:g} C{middle:g},{y0:g} {middle:g},{y1:g} {x1:g},{y1:g}"
    return _path(path, colour, False, _heads(colour, False), 3)


def chevron(x: float, y: float, width: float, height: float, fill: str) -> str:
    """A box that points to the right, into which the next one fits."""
    tip = height / 3
    points = (
        (x, y), (x + width - tip, y), (x + width, y + height / 2), (x + width - tip, y + height),
        (x, y + height), (x + tip, y + height / 2),
    )  # fmt: skip
    return f"<polygon points='{' '.join(f'{a:g},{b:g}' for a, b in points)}' fill='{fill}'/>"


def vehicle(x: float, y: float, length: float, width: float, colour: str) -> str:
    """A vehicle from above, heading right; x, y is its centre."""
    left, top = x - length / 2, y - width / 2
    return (
        box(left, top, length, width, colour, edge=PAPER, radius=5)
        + box(left + 0.62 * length, top + 3, 0.14 * length, width - 6, PAPER, radius=2)
        + box(left + 0.12 * length, top + 4, 0.10 * length, width - 8, PAPER, radius=2)
    )


def person(x: float, y: float, colour: str) -> str:
    """A pedestrian or cyclist from above."""
    return (
        f"<ellipse cx='{x:g}' cy='{y:g}' rx='11' ry='7' fill='{colour}' stroke='{PAPER}'/>"
        f"<circle cx='{x:g}' cy='{y:g}' r='4.5' fill='{PAPER}'/>"
    )


def _heads(colour: str, both: bool) -> str:
    name = f"url(#head{_ARROWS.index(colour)})"
    return f" marker-end='{name}'" + (f" marker-start='{name}'" if both else "")


def _path(path: str, colour: str, dashed: bool, heads: str, width: float = 2) -> str:
    dash = " stroke-dasharray='6 5'" if dashed else ""
    return f"<path d='{path}' fill='none' stroke='{colour}' stroke-width='{width:g}'{dash}{heads}/>"


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
        text(x + width - 10, strip.middle + 4, _name(event, strip.place), size=11,
               colour=MARKING if _is_lane(strip.place) else INK, anchor="end")
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
    fill = ROAD if _is_lane(strip.place) else KERB
    return box(x, strip.top, width, strip.height, fill)


def _markings(strips: list[_Strip], x: float, width: float) -> list[str]:
    """Dashed between lanes of one direction, solid before oncoming ones and at the edges."""
    shapes = []
    for above, below in pairwise(strips):
        lanes = _is_lane(above.place) and _is_lane(below.place)
        dashed = lanes and above.place != "oncoming_lane"
        shapes.append(line([(x, below.top), (x + width, below.top)], MARKING, dashed=dashed))
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
        box(left, own.top + 3, right - left, own.height - 6, "url(#hatch)", edge=CONFLICT),
        arrow(way, PAPER, dashed=True),
    ]
    origin = strips.get(start, own)
    if relation == "merge":
        shapes.append(curve((at + 40, origin.middle), (at + 240, own.middle), OT))
    elif relation == "crossing":
        upwards = origin.middle > own.middle
        beyond = own.top - 16 if upwards else own.top + own.height + 16
        shapes.append(arrow([(at, origin.middle), (at, beyond)], OT, width=3))
    else:
        shapes.append(arrow([(at + 40, own.middle), (at + 120, own.middle)], OT, width=3))
        shapes += [
            line([(at + 134 + 9 * i, own.middle - 11), (at + 134 + 9 * i, own.middle + 11)], OT)
            for i in range(3)
        ]
    return shapes


def _participants(event: Event, strips: dict[str, _Strip], x: float) -> list[str]:
    shapes, value = [], body(event)
    for who, participant in event.participants.items():
        place = strips.get(participant.region.place, strips["vut_lane"])
        at = _station(event, who, x)
        colour = OCCLUDER
        if participant.role == "VUT":
            colour = VUT
        elif who == event.interaction.initiator:
            colour = OT
        if participant.class_ in _WALKERS:
            shapes.append(person(at, place.middle, colour))
            label = at + 20
        else:
            length = _LENGTHS.get(participant.class_, 66.0)
            # An occluder stands behind whom it hides, seen from the VUT nearer.
            at = min(at, x + _INITIATOR_X - 20 - length / 2) if colour == OCCLUDER else at
            shapes.append(vehicle(at, place.middle, length, 24.0, colour))
            label = at + length / 2 + 8
        above = place.middle + 4 if _is_lane(place.place) else place.middle + 5
        ink = MARKING if _is_lane(place.place) else INK
        gap = show(get(value, f"participants.{who}.region.gap"))
        words = who if participant.role == "VUT" else f"{who}, {gap} {participant.region.along}"
        if colour == OCCLUDER:
            shapes.append(
                text(at - 8 - _LENGTHS.get(participant.class_, 66.0) / 2, above, words, size=12,
                       colour=ink, bold=True, anchor="end")
            )  # fmt: skip
        elif colour == OT and place.place == "vut_lane":
            # Beyond its manoeuvre: before it runs the VUT's own way.
            shapes.append(text(at + 192, above, words, size=12, colour=ink, bold=True))
        elif colour == OT and not _is_lane(place.place):
            shapes.append(text(label, above, words, size=12, colour=ink, bold=True))
        else:
            shapes.append(text(at - 42, above, words, size=12, colour=ink, bold=True, anchor="end"))
    return shapes


_WIDTH = 1240.0
_LEFT, _LABELS, _ROW, _GAP = 36.0, 128.0, 92.0, 14.0
_COLUMN = (_WIDTH - 2 * _LEFT - _LABELS) / 4
_SIGNS = {
    "left": "↰ to its left",
    "right": "↱ to its right",
    "none": "straight on",
    UNRESOLVED: "sideways: unresolved",
}


def picture(event: Event) -> str:
    """An SVG file that shows what a K* says, and nothing else."""
    shapes = _title(event)
    scene, at = road_scene(event, _LEFT, 92.0, _WIDTH - 2 * _LEFT)
    shapes += scene
    lanes, at = _swim_lanes(event, at + 30.0)
    shapes += lanes
    values, at = _values(event, at + 34.0)
    shapes += values
    legend, at = _legend(event, at + 26.0)
    return document(_WIDTH, at + 18.0, f"{event.name}: {event.description}", shapes + legend)


def _title(event: Event) -> list[str]:
    version = event_version(event)
    return [
        text(_LEFT, 42, event.name, size=26, bold=True),
        text(_LEFT, 68, event.description, size=14, colour=FAINT),
        text(
            _WIDTH - _LEFT, 42, f"{event.interaction.type} · {event.interaction.relation}",
            size=14, bold=True, anchor="end",
        ),
        text(_WIDTH - _LEFT, 68, version[:23] + "…", size=12, colour=FAINT, anchor="end"),
    ]  # fmt: skip


def _plain(value: Any) -> str:
    """A value as it is written in a picture."""
    return show(value).replace("^2", "²").replace("at least", "≥").replace("at most", "≤")


def _column(index: int) -> float:
    return _LEFT + _LABELS + index * _COLUMN


def _swim_lanes(event: Event, top: float) -> tuple[list[str], float]:
    """Header, one lane per participant, the conflict zone, and the edges of the interaction."""
    others = [who for who in event.participants if who != event.vut_id]
    # Who conflicts stands next to the zone; who hides it between.
    others.sort(key=lambda who: who == event.interaction.initiator)
    rows = {who: top + 48 + i * (_ROW + _GAP) for i, who in enumerate([event.vut_id, *others])}
    zone_y = top + 48 + len(rows) * (_ROW + _GAP)
    bottom = zone_y + 74
    shapes = []
    for i, phase in enumerate(PHASES):
        strong, wash = PHASE_COLOURS[phase]
        x = _column(i)
        start = _plain(get(body(event), f"events.{phase}.start"))
        shapes += [
            box(x + 3, top + 30, _COLUMN - 6, bottom - top - 30, wash, radius=6),
            chevron(x + 2, top, _COLUMN + (6 if i < 3 else -4), 34, strong),
            text(x + 24, top + 22, phase, size=14, colour=PAPER, bold=True),
            text(
                x + _COLUMN - 16, top + 22, f"from {start}", size=12.5, colour=PAPER, anchor="end"
            ),
        ]
    for who, y in rows.items():
        shapes += _row(event, who, y)
    shapes += _zone_row(event, zone_y)
    shapes += _edges(event, rows, zone_y)
    return shapes, bottom


def _colour(event: Event, who: str) -> str:
    if event.participants[who].role == "VUT":
        return VUT
    return OT if who == event.interaction.initiator else OCCLUDER


def _row(event: Event, who: str, y: float) -> list[str]:
    colour, participant = _colour(event, who), event.participants[who]
    role = {VUT: "VUT", OT: "OT, initiator"}.get(colour, "OT")
    if who == event.interaction.occluder:
        role = "OT, occluder"
    shapes = [
        box(_LEFT, y, 5, _ROW, colour, radius=2),
        text(_LEFT + 14, y + 32, who, size=17, bold=True, colour=colour),
        text(_LEFT + 14, y + 52, participant.class_, size=13),
        text(_LEFT + 14, y + 70, role, size=12, colour=FAINT),
    ]
    for i, phase in enumerate(PHASES):
        cell = event.motion.get(who, {}).get(phase)
        if cell is not None:
            shapes += _cell(event, who, phase, cell, _column(i) + 14, y, colour)
    return shapes


def _cell(
    event: Event, who: str, phase: PhaseWord, cell: MotionCell, x: float, y: float, colour: str
) -> list[str]:
    """Motion, position and side, gap and speed of one participant in one phase."""
    speed = event.constraints.speeds.get(who, {}).get(phase, UNRESOLVED)
    shown = UNRESOLVED if isinstance(speed, str) else _plain(speed.model_dump())
    first = (cell.motion or "drives").replace("_", " ")
    seen = [cell.position.replace("_", " ")] if cell.position else []
    if cell.speed_trend != "standing":
        seen.append(_SIGNS[cell.lateral])
    gap = f"gap {cell.longitudinal} · " if cell.longitudinal != "none" else ""
    open_ = UNRESOLVED in (cell.motion, cell.position, speed)
    width = _COLUMN - 28
    return [
        box(x, y, width, _ROW, PAPER, edge=colour, radius=7, dashed=open_),
        text(x + 12, y + 25, first, size=14.5, bold=True),
        text(x + 12, y + 49, " · ".join(seen), size=12.5),
        text(x + 12, y + 68, f"{gap}speed {cell.speed_trend}", size=12.5, colour=FAINT),
        text(x + width - 12, y + 84, shown, size=13, bold=True, anchor="end", colour=colour),
    ]


def _zone_row(event: Event, y: float) -> list[str]:
    c, value = event.constraints, body(event)
    below = _plain(get(value, "constraints.trigger.below"))
    trigger = c.trigger.quantity.replace("_", " ")
    thresholds = [
        f"{name} < {_plain(item.model_dump())}"
        for name, item in (("TTC", c.thresholds.ttc), ("arrivals", c.thresholds.arrival_gap))
        if item is not None
    ]
    x, band = _column(2) + 14, _COLUMN - 28
    first, second = event.interaction.passing_order
    return [
        text(_LEFT + 14, y + 26, "conflict zone", size=14, bold=True, colour=CONFLICT),
        text(_LEFT + 14, y + 45, event.interaction.zone.replace("_", " "), size=12),
        text(_column(1) + 14, y + 26, f"{trigger} to {c.trigger.object}", size=12.5),
        text(_column(1) + 14, y + 46, f"below {below}", size=13.5, bold=True),
        box(x, y, band, 58, "url(#hatch)", edge=CONFLICT, radius=7),
        box(x + 8, y + 12, band - 16, 34, PAPER, radius=5),
        text(
            x + band / 2, y + 34, " or ".join(thresholds), size=13.5, bold=True, anchor="middle",
            colour=CONFLICT,
        ),
        text(_column(3) + 14, y + 26, f"first {first}, then {second}", size=13.5, bold=True),
        text(_column(3) + 14, y + 46, f"time gap {_plain(get(value, 'constraints.time_gap'))}",
               size=12.5),
    ]  # fmt: skip


def _edges(event: Event, rows: dict[str, float], zone_y: float) -> list[str]:
    """Triggers, exposes-conflict and responds, in the gutters between the columns."""
    vut, who = event.vut_id, event.interaction.initiator
    if who not in rows:
        return []
    fired, seen = _column(1) + 4, _column(2) + 4
    answered = _column(3) - 4
    return [
        arrow([(fired, rows[vut] + _ROW / 2), (fired, rows[who] + 20)], INK, dashed=True),
        arrow([(seen, rows[who] + _ROW / 2), (seen, zone_y + 26)], CONFLICT),
        arrow([(answered, zone_y + 26), (answered, rows[vut] + _ROW / 2)], VUT),
        _tag(fired, rows[vut] + _ROW + _GAP / 2, "triggers", INK),
        _tag(seen, zone_y - _GAP / 2, "exposes conflict", CONFLICT),
        _tag(answered, rows[vut] + _ROW + _GAP / 2, "responds: " + _answers(event), VUT),
    ]


def _answers(event: Event) -> str:
    interaction = event.interaction
    along = " or ".join(interaction.longitudinal_responses)
    return f"{along}, {' or '.join(interaction.lateral_responses)}"


def _tag(x: float, y: float, words: str, colour: str) -> str:
    width = 7.0 * len(words) + 14
    label = text(x, y + 4.5, words, size=12, colour=PAPER, bold=True, anchor="middle")
    return box(x - width / 2, y - 9, width, 19, colour, radius=9) + label


def _values(event: Event, top: float) -> tuple[list[str], float]:
    """Quantities of part C and T that no lane shows, in columns."""
    value = body(event)
    groups = {
        "Manoeuvre": "constraints.manoeuvre",
        "Road": "topology",
        "Safety limits": "constraints.safety",
        "Camera": "constraints.camera",
        "Site": "constraints.site",
    }
    width = (_WIDTH - 2 * _LEFT) / len(groups)
    shapes, deepest = [], top
    for i, (title, path) in enumerate(groups.items()):
        x, y = _LEFT + i * width, top
        shapes += [
            text(x, y, title, size=13, bold=True),
            line([(x, y + 7), (x + width - 22, y + 7)], LINE),
        ]
        here = get(value, path)
        for name in granules(here):
            item = get(here, name)
            if isinstance(item, dict) and set(item) == ROAD_FIELD:
                item = _of_road(item)
            if isinstance(item, list):
                continue
            y += 19
            label = name.replace("_", " ")
            shapes += [
                text(x, y + 8, label, size=12, colour=FAINT),
                text(x + width - 22, y + 8, _plain(item), size=12, bold=True, anchor="end"),
            ]
        deepest = max(deepest, y + 8)
    return shapes, deepest


def _of_road(field: dict[str, Any]) -> Any:
    """A field of T in a few words: what the source shows, and whether it may vary."""
    value, varies = field["value"], field["varies"]
    if isinstance(varies, dict):  # a range says what a place may have, and holds the value
        return varies
    if varies is None or isinstance(value, list):
        return value
    return "may vary" if value == UNRESOLVED else f"{value}, may vary"


def _legend(event: Event, top: float) -> tuple[list[str], float]:
    states = [entry.review for entry in event.uncertainty.values()]
    reviewed = sum(state in ("accepted", "edited") for state in states)
    x = _LEFT
    shapes = [line([(_LEFT, top - 14), (_WIDTH - _LEFT, top - 14)], LINE)]
    for colour, words in (
        (VUT, "vehicle under test"),
        (OT, "initiator"),
        (OCCLUDER, "other target"),
        (CONFLICT, "conflict"),
    ):
        shapes += [
            box(x, top - 1, 14, 14, colour, radius=3),
            text(x + 20, top + 11, words, size=12, colour=FAINT),
        ]
        x += 40 + 6.6 * len(words)
    shapes += [
        box(x, top - 1, 22, 14, PAPER, edge=OT, radius=3, dashed=True),
        text(x + 28, top + 11, "something unresolved", size=12, colour=FAINT),
        text(x + 190, top + 11, "a–b: any value of the range", size=12, colour=FAINT),
        text(
            _WIDTH - _LEFT, top + 11, f"{reviewed} of {len(states)} entries of part U reviewed",
            size=12, colour=FAINT, anchor="end",
        ),
    ]  # fmt: skip
    return shapes, top + 18
