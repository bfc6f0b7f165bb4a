"""A planned trajectory on the forward picture and from above, drawn after the fact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

from ssp_core.geometry import Pose2
from ssp_core.world import camera
from ssp_eval import pages
from ssp_vla_bridge.trajectory import Trajectory, interpolate

_NEAREST_M = 1.0
_HALF_WIDTH_M = 0.9
_STEP_S = 0.1


def project(
    points_m: Sequence[tuple[float, float]],
    geometry: dict[str, Any],
    mount_forward_m: float,
    mount_turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[tuple[float, float] | None]:
    """Return pixels (u, v) of points on the ground, None for one that isn't ahead of the camera.

    Args:
        points_m: forward of the VUT's reference point, and to its left.
        geometry: fields of CameraGeometry, with height_m and pitch_down_rad known.
        mount_forward_m: of the camera, ahead of the reference point.
        mount_turn: how far it sits to the left (m), and is turned left and leans right (rad).
    """
    names = (field.name for field in fields(camera.Intrinsics))
    view = camera.mounted_view(
        Pose2(0.0, 0.0, 0.0),
        camera.Intrinsics(**{name: geometry[name] for name in names}),
        camera.Mounting(
            mount_forward_m,
            float(geometry["height_m"]),
            float(geometry["pitch_down_rad"]),
            *mount_turn,
        ),
    )
    pixels = camera.project(view, [(x_m, y_m, 0.0) for x_m, y_m in points_m])
    return [
        None if depth_m < _NEAREST_M else (float(u_px), float(v_px))
        for u_px, v_px, depth_m in zip(pixels.u_px, pixels.v_px, pixels.depth_m, strict=True)
    ]


@dataclass(frozen=True)
class Ribbon:
    """A path on the ground as the picture shows it, in px; only what lies ahead of the camera.

    Args:
        left, right: borders of what the VUT would cover.
        middle: between them, where its reference point goes.
    """

    left: tuple[tuple[float, float], ...]
    right: tuple[tuple[float, float], ...]
    middle: tuple[tuple[float, float], ...]
    dots: tuple[tuple[float, float], ...]

    @property
    def outline(self) -> tuple[tuple[float, float], ...]:
        """Return the outline of the area that the VUT would cover."""
        return self.left + self.right[::-1]


def ribbon(
    trajectory: Trajectory,
    geometry: dict[str, Any] | None,
    mount_forward_m: float | None,
    mount_turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Ribbon | None:
    """Return the ribbon that the VUT would cover.

    Args:
        trajectory: in the ego frame.
        geometry: of the camera, None: not known.
        mount_forward_m: of the camera, None: not known.
        mount_turn: how far the camera sits to the left (m), is turned left and leans right (rad).

    Returns:
        None where the camera's pose isn't known or nothing of the path lies in front of it.
    """
    if geometry is None or mount_forward_m is None:
        return None
    if geometry.get("height_m") is None or geometry.get("pitch_down_rad") is None:
        return None
    start_s, end_s = trajectory.t_s[0], trajectory.t_s[-1]
    count = max(2, math.ceil((end_s - start_s) / _STEP_S))
    times = [start_s + (end_s - start_s) * k / count for k in range(count + 1)]
    path = [interpolate(trajectory, t_s) for t_s in times]
    points_m: list[tuple[float, float]] = []
    for k, (x_m, y_m) in enumerate(path):
        ahead = path[min(k + 1, count)], path[max(k - 1, 0)]
        heading = math.atan2(ahead[0][1] - ahead[1][1], ahead[0][0] - ahead[1][0])
        dx_m, dy_m = -math.sin(heading) * _HALF_WIDTH_M, math.cos(heading) * _HALF_WIDTH_M
        points_m += [(x_m + dx_m, y_m + dy_m), (x_m - dx_m, y_m - dy_m), (x_m, y_m)]
    halves = (0.5 * k for k in range(1, int(2 * end_s + 1e-6) + 1))
    points_m += [interpolate(trajectory, min(t_s, end_s)) for t_s in halves if t_s >= start_s]
    # All at once: the camera is the same for all of them.
    pixels = project(points_m, geometry, mount_forward_m, mount_turn)
    borders, spots = pixels[: 3 * len(path)], pixels[3 * len(path) :]
    left, right, middle = [], [], []
    for one, other, between in zip(borders[::3], borders[1::3], borders[2::3], strict=True):
        if one and other and between:
            left.append(one)
            right.append(other)
            middle.append(between)
    dots = [spot for spot in spots if spot]
    if len(middle) < 2 and not dots:
        return None
    return Ribbon(tuple(left), tuple(right), tuple(middle), tuple(dots))


def overlay(
    trajectory: Trajectory,
    geometry: dict[str, Any] | None,
    mount_forward_m: float | None,
    mount_turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> str:
    """Return SVG over the picture: a ribbon with a dot every half second; empty without one.

    Args: see ribbon.
    """
    path_ribbon = ribbon(trajectory, geometry, mount_forward_m, mount_turn)
    if path_ribbon is None or geometry is None:
        return ""
    radius = geometry["width_px"] / 160
    dots = [pages.element("circle", cx=x, cy=y, r=radius) for x, y in path_ribbon.dots]
    surface = pages.element(
        "polygon", points=pages.points(list(path_ribbon.outline)), class_="ribbon"
    )
    line = pages.element("polyline", points=pages.points(list(path_ribbon.middle)), class_="path")
    body = (surface + line if len(path_ribbon.middle) >= 2 else "") + "".join(dots)
    box = f"0 0 {geometry['width_px']} {geometry['height_px']}"
    # The view from above says the same to those who don't see it.
    return pages.element(
        "svg",
        body,
        class_="overlay",
        viewBox=box,
        preserveAspectRatio="none",
        aria_hidden="true",
    )


WIDTH, HEIGHT = 170, 250
_MARGIN = 14
_BEHIND_M = 8.0
_LEAST_AHEAD_M = 16.0
_LANE_M = 3.5


def top_view(trajectory: Trajectory | None, history: Sequence[dict[str, Any]]) -> str:
    """Return the plan as SVG.

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
        parts.append(pages.element("line", x1=0, x2=WIDTH, y1=y, y2=y, class_="grid"))
        if k > 0:
            parts.append(pages.text(3, y - 2, f"{k * step_m} m", class_="tick"))
    for side in (-0.5, 0.5):
        x = place(0.0, side * _LANE_M)[0]
        parts.append(pages.element("line", x1=x, x2=x, y1=0, y2=HEIGHT, class_="lane"))
    past = [place(s["x_m"], s["y_m"]) for s in history if s["x_m"] > -_BEHIND_M]
    if len(past) > 1:
        parts.append(pages.element("polyline", points=pages.points(past), class_="past"))
    corner = place(3.6, 0.9)
    parts.append(
        pages.element(
            "rect",
            x=corner[0],
            y=corner[1],
            width=1.8 * scale,
            height=4.5 * scale,
            rx=2,
            class_="ego",
        )
    )
    if trajectory is None:
        parts.append(pages.text(WIDTH / 2, 40, "no valid trajectory", class_="none"))
    else:
        spots = [place(x, y) for x, y in zip(trajectory.x_m, trajectory.y_m, strict=True)]
        parts.append(pages.element("polyline", points=pages.points(spots), class_="path"))
        for t_s, (x, y) in zip(trajectory.t_s, spots, strict=True):
            kind = "dot scored" if t_s <= 1.0 + 1e-9 else "dot"
            mark = pages.title(f"{t_s:g} s")
            parts.append(pages.element("circle", mark, cx=x, cy=y, r=3, class_=kind))
    return pages.element(
        "svg",
        "".join(parts),
        class_="topview",
        viewBox=f"0 0 {WIDTH} {HEIGHT}",
        width=WIDTH,
        height=HEIGHT,
        role="img",
        aria_label=_described(trajectory),
    )


def _described(trajectory: Trajectory | None) -> str:
    if trajectory is None:
        return "No valid trajectory"
    x_m, y_m, t_s = trajectory.x_m[-1], trajectory.y_m[-1], trajectory.t_s[-1]
    side = "left" if y_m >= 0.0 else "right"
    return f"Plan from above: {x_m:.1f} m ahead, {abs(y_m):.1f} m to the {side} at {t_s:g} s"
