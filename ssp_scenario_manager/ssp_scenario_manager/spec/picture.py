"""The interaction graph as a picture: the road from above, the phases as swim lanes, the values."""

from __future__ import annotations

from typing import Any

from ssp_core.vocabulary import PHASES, PhaseWord
from ssp_scenario_manager.spec import drawing as d
from ssp_scenario_manager.spec.checks.base import show
from ssp_scenario_manager.spec.fields import ROAD_FIELD, get, granules
from ssp_scenario_manager.spec.load import event_version
from ssp_scenario_manager.spec.model import UNRESOLVED, Event, MotionCell
from ssp_scenario_manager.spec.scene import road_scene
from ssp_scenario_manager.spec.seal import body

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
    return d.document(_WIDTH, at + 18.0, f"{event.name}: {event.description}", shapes + legend)


def _title(event: Event) -> list[str]:
    version = event_version(event)
    return [
        d.text(_LEFT, 42, event.name, size=26, bold=True),
        d.text(_LEFT, 68, event.description, size=14, colour=d.FAINT),
        d.text(
            _WIDTH - _LEFT, 42, f"{event.interaction.type} · {event.interaction.relation}",
            size=14, bold=True, anchor="end",
        ),
        d.text(_WIDTH - _LEFT, 68, version[:23] + "…", size=12, colour=d.FAINT, anchor="end"),
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
        strong, wash = d.PHASE_COLOURS[phase]
        x = _column(i)
        start = _plain(get(body(event), f"events.{phase}.start"))
        shapes += [
            d.box(x + 3, top + 30, _COLUMN - 6, bottom - top - 30, wash, radius=6),
            d.chevron(x + 2, top, _COLUMN + (6 if i < 3 else -4), 34, strong),
            d.text(x + 24, top + 22, phase, size=14, colour=d.PAPER, bold=True),
            d.text(
                x + _COLUMN - 16, top + 22, f"from {start}", size=12.5, colour=d.PAPER, anchor="end"
            ),
        ]
    for who, y in rows.items():
        shapes += _row(event, who, y)
    shapes += _zone_row(event, zone_y)
    shapes += _edges(event, rows, zone_y)
    return shapes, bottom


def _colour(event: Event, who: str) -> str:
    if event.participants[who].role == "VUT":
        return d.VUT
    return d.OT if who == event.interaction.initiator else d.OCCLUDER


def _row(event: Event, who: str, y: float) -> list[str]:
    colour, participant = _colour(event, who), event.participants[who]
    role = {d.VUT: "VUT", d.OT: "OT, initiator"}.get(colour, "OT")
    if who == event.interaction.occluder:
        role = "OT, occluder"
    shapes = [
        d.box(_LEFT, y, 5, _ROW, colour, radius=2),
        d.text(_LEFT + 14, y + 32, who, size=17, bold=True, colour=colour),
        d.text(_LEFT + 14, y + 52, participant.class_, size=13),
        d.text(_LEFT + 14, y + 70, role, size=12, colour=d.FAINT),
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
        d.box(x, y, width, _ROW, d.PAPER, edge=colour, radius=7, dashed=open_),
        d.text(x + 12, y + 25, first, size=14.5, bold=True),
        d.text(x + 12, y + 49, " · ".join(seen), size=12.5),
        d.text(x + 12, y + 68, f"{gap}speed {cell.speed_trend}", size=12.5, colour=d.FAINT),
        d.text(x + width - 12, y + 84, shown, size=13, bold=True, anchor="end", colour=colour),
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
        d.text(_LEFT + 14, y + 26, "conflict zone", size=14, bold=True, colour=d.CONFLICT),
        d.text(_LEFT + 14, y + 45, event.interaction.zone.replace("_", " "), size=12),
        d.text(_column(1) + 14, y + 26, f"{trigger} to {c.trigger.object}", size=12.5),
        d.text(_column(1) + 14, y + 46, f"below {below}", size=13.5, bold=True),
        d.box(x, y, band, 58, "url(#hatch)", edge=d.CONFLICT, radius=7),
        d.box(x + 8, y + 12, band - 16, 34, d.PAPER, radius=5),
        d.text(
            x + band / 2, y + 34, " or ".join(thresholds), size=13.5, bold=True, anchor="middle",
            colour=d.CONFLICT,
        ),
        d.text(_column(3) + 14, y + 26, f"first {first}, then {second}", size=13.5, bold=True),
        d.text(_column(3) + 14, y + 46, f"time gap {_plain(get(value, 'constraints.time_gap'))}",
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
        d.arrow([(fired, rows[vut] + _ROW / 2), (fired, rows[who] + 20)], d.INK, dashed=True),
        d.arrow([(seen, rows[who] + _ROW / 2), (seen, zone_y + 26)], d.CONFLICT),
        d.arrow([(answered, zone_y + 26), (answered, rows[vut] + _ROW / 2)], d.VUT),
        _tag(fired, rows[vut] + _ROW + _GAP / 2, "triggers", d.INK),
        _tag(seen, zone_y - _GAP / 2, "exposes conflict", d.CONFLICT),
        _tag(answered, rows[vut] + _ROW + _GAP / 2, "responds: " + _answers(event), d.VUT),
    ]


def _answers(event: Event) -> str:
    interaction = event.interaction
    along = " or ".join(interaction.longitudinal_responses)
    return f"{along}, {' or '.join(interaction.lateral_responses)}"


def _tag(x: float, y: float, words: str, colour: str) -> str:
    width = 7.0 * len(words) + 14
    label = d.text(x, y + 4.5, words, size=12, colour=d.PAPER, bold=True, anchor="middle")
    return d.box(x - width / 2, y - 9, width, 19, colour, radius=9) + label


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
            d.text(x, y, title, size=13, bold=True),
            d.line([(x, y + 7), (x + width - 22, y + 7)], d.LINE),
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
                d.text(x, y + 8, label, size=12, colour=d.FAINT),
                d.text(x + width - 22, y + 8, _plain(item), size=12, bold=True, anchor="end"),
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
    shapes = [d.line([(_LEFT, top - 14), (_WIDTH - _LEFT, top - 14)], d.LINE)]
    for colour, words in (
        (d.VUT, "vehicle under test"),
        (d.OT, "initiator"),
        (d.OCCLUDER, "other target"),
        (d.CONFLICT, "conflict"),
    ):
        shapes += [
            d.box(x, top - 1, 14, 14, colour, radius=3),
            d.text(x + 20, top + 11, words, size=12, colour=d.FAINT),
        ]
        x += 40 + 6.6 * len(words)
    shapes += [
        d.box(x, top - 1, 22, 14, d.PAPER, edge=d.OT, radius=3, dashed=True),
        d.text(x + 28, top + 11, "something unresolved", size=12, colour=d.FAINT),
        d.text(x + 190, top + 11, "a–b: any value of the range", size=12, colour=d.FAINT),
        d.text(
            _WIDTH - _LEFT, top + 11, f"{reviewed} of {len(states)} entries of part U reviewed",
            size=12, colour=d.FAINT, anchor="end",
        ),
    ]  # fmt: skip
    return shapes, top + 18
