"""Parts that road vehicles share: lamps, wheels, panels, and shares of a body's extents.

The origin is the reference point (on the ground under the rear axle), x forward. Shares along the
body are counted from the rear end (0) to the front end (1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.state import Size
from ssp_ot_controller.camera.mesh import Colour, Mesh, Vec, fan, join, quad, tube
from ssp_ot_controller.camera.palettes import rgb
from ssp_ot_controller.camera.surfaces import GLOSSY, LAMP

_TYRE = rgb("1c1c1e")
_RIM = rgb("a9adb1")
PLASTIC = rgb("26282b")
PANE = rgb("1d242b")
PLATE = rgb("e9e6d8")
TAIL = rgb("7d1418")
_TAIL_LIT = rgb("a81c20")
_BRAKE = rgb("ff4a3c")
_HEAD = rgb("dfe6ea")
_HEAD_LIT = rgb("fffbe8")
AMBER = rgb("d98a2b")


@dataclass(frozen=True)
class Lights:
    """What is switched on."""

    brake: bool
    lamps: bool

    @property
    def tail(self) -> tuple[Colour, int]:
        if self.brake:
            return _BRAKE, LAMP
        return (_TAIL_LIT, LAMP) if self.lamps else (TAIL, GLOSSY)

    @property
    def head(self) -> tuple[Colour, int]:
        return (_HEAD_LIT, LAMP) if self.lamps else (_HEAD, GLOSSY)


@dataclass(frozen=True)
class Frame:
    """Turns shares of a body's extents into metres."""

    size: Size

    def x(self, share: float) -> float:
        return -self.size.rear_m + share * self.size.length_m

    def y(self, share: float) -> float:
        return share * self.size.width_m / 2

    def z(self, share: float) -> float:
        return share * self.size.height_m


def on_face(
    face: Sequence[Vec],
    u: tuple[float, float],
    v: tuple[float, float],
    colour: Colour,
    kind: int,
    lift_m: float = 0.012,
) -> Mesh:
    """A panel on a quadrilateral, between shares u along its base and v up, lifted off it."""
    a, b, c, d = (np.asarray(p, dtype=np.float64) for p in face)
    normal = np.cross(b - a, d - a)
    normal *= lift_m / np.linalg.norm(normal)

    def at(i: float, j: float) -> Vec:
        point = (1 - j) * ((1 - i) * a + i * b) + j * ((1 - i) * d + i * c) + normal
        return float(point[0]), float(point[1]), float(point[2])

    return quad(at(u[0], v[0]), at(u[1], v[0]), at(u[1], v[1]), at(u[0], v[1]), colour, kind)


def wheel(x_m: float, y_m: float, radius_m: float, width_m: float, outward: float) -> Mesh:
    """A wheel with tyre and rim; its outer face stands at y_m, on the side ``outward`` (+ left)."""
    inner = y_m - outward * width_m
    tyre = tube((x_m, inner, radius_m), (x_m, y_m, radius_m), radius_m, radius_m, _TYRE, 16)
    angles = outward * 2.0 * math.pi * np.arange(10) / 10
    offset = y_m + outward * 0.008
    parts = [tyre]
    for share, colour in ((0.64, _RIM), (0.2, PLASTIC)):
        circle = [
            (x_m - share * radius_m * math.cos(t), offset, radius_m * (1 + share * math.sin(t)))
            for t in angles
        ]
        parts.append(fan(circle, colour))
        offset += outward * 0.005
    return join(parts)


def arch(x_m: float, y_m: float, radius_m: float, floor_m: float, outward: float) -> Mesh:
    angles = outward * math.pi * np.arange(11) / 10
    rim = [
        (
            x_m - radius_m * math.cos(t),
            y_m,
            max(floor_m, 0.87 * radius_m + radius_m * math.sin(abs(t))),
        )
        for t in angles
    ]
    return fan([*rim, (x_m + radius_m, y_m, floor_m), (x_m - radius_m, y_m, floor_m)], PLASTIC)


def rear_panel(
    x: float, y0: float, y1: float, z0: float, z1: float, colour: Colour, kind: int
) -> Mesh:
    return quad((x, y1, z0), (x, y0, z0), (x, y0, z1), (x, y1, z1), colour, kind)


def front_panel(
    x: float, y0: float, y1: float, z0: float, z1: float, colour: Colour, kind: int
) -> Mesh:
    return quad((x, y0, z0), (x, y1, z0), (x, y1, z1), (x, y0, z1), colour, kind)


def left_panel(
    y: float, x0: float, x1: float, z0: float, z1: float, colour: Colour, kind: int
) -> Mesh:
    return quad((x1, y, z0), (x0, y, z0), (x0, y, z1), (x1, y, z1), colour, kind)


def right_panel(
    y: float, x0: float, x1: float, z0: float, z1: float, colour: Colour, kind: int
) -> Mesh:
    return quad((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1), colour, kind)
