"""A small plan of a trajectory: ego frame, forward is up, left is left, equal scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from ssp_eval.report import svg
from ssp_vla_bridge.trajectory import Trajectory

WIDTH, HEIGHT = 170, 250
_MARGIN = 14
_BEHIND_M = 8.0
_LEAST_AHEAD_M = 16.0
_LANE_M = 3.5


def top_view(trajectory: Trajectory | None, history: Sequence[dict[str, Any]]) -> str:
    """The plan as SVG.

    Args:
        trajectory: a valid one, None: there is none to draw.
        history: ego samples (x_m, y_m in the same frame), may be empty.
    """
    far_m = max([_LEAST_AHEAD_M, *(trajectory.x_m if trajectory else ())])
    wide_m = max([_LANE_M * 1.5, *(abs(y) for y in (trajectory.y_m if trajectory else ()))])
    scale = min((HEIGHT - 2 * _MARGIN) / (far_m + _BEHIND_M), (WIDTH - 2 * _MARGIN) / (2 * wide_m))
    base = HEIGHT - _MARGIN - _BEHIND_M * scale

    def place(x_m: float, y_m: float) -> tuple[float, float]:
        return WIDTH / 2 - y_m * scale, base - x_m * scale

    parts = []
    step_m = 5 if far_m <= 30 else 10
    for k in range(-1, math.floor(far_m / step_m) + 1):
        y = place(k * step_m, 0.0)[1]
        parts.append(svg.element("line", x1=0, x2=WIDTH, y1=y, y2=y, class_="grid"))
        if k > 0:
            parts.append(svg.text(3, y - 2, f"{k * step_m} m", class_="tick"))
    for side in (-0.5, 0.5):
        x = place(0.0, side * _LANE_M)[0]
        parts.append(svg.element("line", x1=x, x2=x, y1=0, y2=HEIGHT, class_="lane"))
    past = [place(s["x_m"], s["y_m"]) for s in history if s["x_m"] > -_BEHIND_M]
    if len(past) > 1:
        parts.append(svg.element("polyline", points=svg.points(past), class_="past"))
    corner = place(3.6, 0.9)
    parts.append(
        svg.element(
            "rect", x=corner[0], y=corner[1], width=1.8 * scale, height=4.5 * scale, rx=2,
            class_="ego",
        )
    )  # fmt: skip
    if trajectory is None:
        parts.append(svg.text(WIDTH / 2, 40, "no valid trajectory", class_="none"))
    else:
        spots = [place(x, y) for x, y in zip(trajectory.x_m, trajectory.y_m, strict=True)]
        parts.append(svg.element("polyline", points=svg.points(spots), class_="path"))
        for t_s, (x, y) in zip(trajectory.t_s, spots, strict=True):
            kind = "dot scored" if t_s <= 1.0 + 1e-9 else "dot"
            mark = svg.title(f"{t_s:g} s")
            parts.append(svg.element("circle", mark, cx=x, cy=y, r=3, class_=kind))
    return svg.element(
        "svg", "".join(parts), class_="topview", viewBox=f"0 0 {WIDTH} {HEIGHT}", width=WIDTH,
        height=HEIGHT, role="img",
    )  # fmt: skip
