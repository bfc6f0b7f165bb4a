"""Draws the native frames beside ours: ``python docs/native_frames.py``.

One left turn, 10 m/s on a circle of 25 m for 3 s, is written down as each system would and read by
its adapter; what is drawn are the points that came out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.messages import NativeArray, Response
from ssp_vla_bridge.trajectory import Trajectory

PICTURE = Path(__file__).resolve().parent / "images" / "native-frames.svg"

SPEED_MPS, RADIUS_M, STEP_S, STEPS = 10.0, 25.0, 0.5, 6
_WIDTH, _HEIGHT, _PANEL = 1200, 420, 240
_SCALE = 8.5  # px per m
_INK, _FAINT, _OURS, _NATIVE = "#1f2933", "#9aa5b1", "#1c64b4", "#c2410c"

Point = tuple[float, float]


@dataclass(frozen=True)
class Panel:
    """One system's part of the picture.

    Args:
        title: its name.
        form: of its output, with the first values of the turn.
        axes: names of the axes forward and to one side; empty where it has none.
        side: of the second axis, +1 to the left, -1 to the right.
        points: that the adapter gives, in our frame, m.
        other: of another mode, m; may be empty.
        words: below the drawing.
    """

    title: str
    form: str
    axes: tuple[str, str]
    side: int
    points: Sequence[Point]
    other: Sequence[Point]
    words: tuple[str, ...]


def panels() -> tuple[Panel, ...]:
    """The picture's parts, ours first."""
    turn = [_on_circle(k * STEP_S) for k in range(STEPS + 1)]
    step_m, curvature_pm = SPEED_MPS * STEP_S, 1 / RADIUS_M
    pairs = ", ".join([f"[{step_m:.1f}, {100 * curvature_pm:.1f}]"] * STEPS)
    commands = "[" + ", ".join([f"({SPEED_MPS:.1f}, {curvature_pm:.2f})"] * STEPS) + "]"
    rows = ", ".join(f"({-y:.2f}, {x:.2f})" for x, y in turn[1:])
    first = turn[1]
    return (
        Panel(
            "ours (METHOD 5.4)", f"({first[0]:.2f}, {first[1]:.2f}) at 0.5 s", ("x", "y"), 1,
            turn, (), ("x forward, y left, m", "t = 0 is the record's time", ""),
        ),
        Panel(
            "OpenEMMA", f"[v, k] = [{step_m:.1f}, {100 * curvature_pm:.1f}]", ("", ""), 1,
            _points("openemma:corrected", pairs), _points("openemma:native", pairs),
            ("v in m per 0.5 s, k in 0.01/m, + left", "blue: corrected", "orange: native"),
        ),
        Panel(
            "LightEMMA", f"(v, c) = ({SPEED_MPS:.1f}, {curvature_pm:.2f})", ("", ""), 1,
            _points("lightemma:corrected", commands), _points("lightemma:native", commands),
            ("v in m/s, c in 1/m, + left", "blue: corrected", "orange: native"),
        ),
        Panel(
            "LLaViDA", f"({-first[1]:.2f}, {first[0]:.2f}) at 0.5 s", ("y", "x"), -1,
            _points("llavida", f"3-second trajectory: [{rows}]"), (),
            ("x to the right, y forward, m", "ours = (y, −x)", "origin added"),
        ),
        Panel(
            "Alpamayo", "({:.2f}, {:.2f}, 0) at 0.1 s".format(*_on_circle(0.1)), ("x", "y"), 1,
            _points("alpamayo", "", _pred_xyz()), (),
            ("x forward, y left, z up, m, 10 Hz", "z is not used", "origin added"),
        ),
    )  # fmt: skip


def _on_circle(t_s: float) -> Point:
    angle = SPEED_MPS * t_s / RADIUS_M
    return RADIUS_M * math.sin(angle), RADIUS_M * (1 - math.cos(angle))


def _pred_xyz() -> NativeArray:
    points = [(*_on_circle(0.1 * k), 0.0) for k in range(1, 31)]
    data = tuple(value for point in points for value in point)
    return NativeArray("pred_xyz", (1, 1, 1, len(points), 3), data, "ego_xyz", "m", 0.1, 0.1)


def _points(adapter: str, text: str, *arrays: NativeArray) -> list[Point]:
    adapted = adapt(adapter, Response("picture", 0, "", "", text, arrays))
    if adapted.trajectory is None:
        raise ValueError(f"{adapter}: {adapted.invalid} {adapted.info.notes}")
    return _rows(adapted.trajectory)


def _rows(trajectory: Trajectory) -> list[Point]:
    return list(zip(trajectory.x_m, trajectory.y_m, strict=True))


def draw() -> str:
    """The picture, SVG."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'font-family="sans-serif" font-size="13" fill="{_INK}">',
        "<title>One left turn in each system's native frame, and its points in ours</title>",
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="#ffffff"/>',
    ]
    for i, panel in enumerate(panels()):
        parts.extend(_panel(panel, i * _PANEL))
    return "\n".join([*parts, "</svg>", ""])


def _panel(panel: Panel, left: int) -> list[str]:
    centre, x0, y0 = left + _PANEL // 2, left + 172, 302
    parts = [
        _text(centre, 26, panel.title, 'font-size="16" font-weight="bold" text-anchor="middle"'),
        _text(centre, 48, panel.form, f'fill="{_NATIVE}" text-anchor="middle"'),
    ]
    if left:
        parts.append(_line(left, 12, left, _HEIGHT - 12, _FAINT, 1))
    parts.append(  # the vehicle, front upwards
        f'<path d="M{x0 - 8},{y0 + 19} v-30 q8,-10 16,0 v30 z" fill="#e4e7eb" stroke="{_INK}"/>'
    )
    parts.extend(_axes(panel, x0, y0))
    parts.extend(_path(panel.points, x0, y0, _OURS, 3.5 if len(panel.points) < 15 else 1.8))
    if panel.other:
        parts.extend(_path(panel.other, x0, y0, _NATIVE, 5.5, hollow=True))
    for i, words in enumerate(panel.words):
        parts.append(_text(centre, 356 + 19 * i, words, 'text-anchor="middle"'))
    return parts


def _axes(panel: Panel, x0: int, y0: int) -> list[str]:
    forward, sideways = panel.axes
    if not forward:
        # No frame: a positive curvature turns to the left.
        arc = f'<path d="M{x0 + 50},{y0 + 6} q0,-40 -30,-52" fill="none" stroke="{_NATIVE}"'
        return [
            f'{arc} stroke-width="2"/>',
            _head(x0 + 15, y0 - 48, -0.93, -0.37),
            _text(x0 + 48, y0 - 30, "+", f'fill="{_NATIVE}" font-size="17"'),
        ]
    end = x0 - panel.side * (110 if panel.side > 0 else 44)
    return [
        _line(x0, y0, x0, y0 - 222, _NATIVE, 2),
        _head(x0, y0 - 226, 0.0, -1.0),
        _text(x0 + 9, y0 - 216, forward, f'fill="{_NATIVE}" font-size="16" font-style="italic"'),
        _line(x0, y0, end, y0, _NATIVE, 2),
        _head(end - 4 * panel.side, y0, -float(panel.side), 0.0),
        _text(
            end - 4 * panel.side - 4, y0 - 10, sideways,
            f'fill="{_NATIVE}" font-size="16" font-style="italic"',
        ),
    ]  # fmt: skip


def _path(
    points: Sequence[Point], x0: int, y0: int, colour: str, radius: float, hollow: bool = False
) -> list[str]:
    pixels = [(x0 - _SCALE * y_m, y0 - _SCALE * x_m) for x_m, y_m in points]
    line = " ".join(f"{u:.1f},{v:.1f}" for u, v in pixels)
    dot = f'r="{radius}" ' + (f'fill="none" stroke="{colour}"' if hollow else f'fill="{colour}"')
    return [
        f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="1.5"/>',
        *(f'<circle cx="{u:.1f}" cy="{v:.1f}" {dot}/>' for u, v in pixels),
    ]


def _line(u0: float, v0: float, u1: float, v1: float, colour: str, width: float) -> str:
    ends = f'x1="{u0}" y1="{v0}" x2="{u1}" y2="{v1}"'
    return f'<line {ends} stroke="{colour}" stroke-width="{width}"/>'


def _head(u: float, v: float, along: float, down: float) -> str:
    """The head of an arrow whose tip is at (u, v)."""
    back = (u - 9 * along, v - 9 * down)
    across = (-4 * down, 4 * along)
    corners = [
        (u, v),
        (back[0] + across[0], back[1] + across[1]),
        (back[0] - across[0], back[1] - across[1]),
    ]
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in corners)
    return f'<polygon points="{points}" fill="{_NATIVE}"/>'


def _text(u: float, v: float, words: str, style: str) -> str:
    return f'<text x="{u}" y="{v}" {style}>{words}</text>'


if __name__ == "__main__":
    PICTURE.write_text(draw())
