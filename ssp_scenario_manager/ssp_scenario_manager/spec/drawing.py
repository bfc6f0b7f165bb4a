"""Shapes for `picture`: a few SVG elements as text, with one style for all."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

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
