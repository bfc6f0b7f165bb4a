"""Parts that road vehicles share: lamps, wheels, panels, and shares of a body's extents.

The origin is the reference point (on the ground under the rear axle), x forward. Shares along the
body are counted from the rear end (0) to the front end (1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssp_core.motion.state import Size
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
_TURN = rgb("8a4f1a")
_TURN_LIT = rgb("ffae1c")
_SPOKES = 5
WHEEL_STEPS = 8  # poses of a wheel between two spokes, so that bodies can be kept


@dataclass(frozen=True)
class Lights:
    """What is switched on."""

    brake: bool
    lamps: bool
    left: bool = False  # indicators: shining at this instant, not only blinking
    right: bool = False

    @property
    def tail(self) -> tuple[Colour, int]:
        if self.brake:
            return _BRAKE, LAMP
        return (_TAIL_LIT, LAMP) if self.lamps else (TAIL, GLOSSY)

    @property
    def head(self) -> tuple[Colour, int]:
        return (_HEAD_LIT, LAMP) if self.lamps else (_HEAD, GLOSSY)

    def turn(self, side: float) -> tuple[Colour, int]:
        """Of the indicators of one side, + is left."""
        lit = self.left if side > 0.0 else self.right
        return (_TURN_LIT, LAMP) if lit else (_TURN, GLOSSY)


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


def wheel_step(travelled_m: float, radius_m: float) -> int:
    """Pose of wheels with this way behind them, 0 to WHEEL_STEPS - 1."""
    between = 2.0 * math.pi / _SPOKES * radius_m
    return round(travelled_m / between * WHEEL_STEPS) % WHEEL_STEPS


@lru_cache(maxsize=64)
def wheel(
    x_m: float, y_m: float, radius_m: float, width_m: float, outward: float, step: int = 0
) -> Mesh:
    """A wheel with tyre and rim; its outer face stands at y_m, on the side ``outward`` (+ left).

    ``step`` turns its spokes: as the vehicle rolls forward, the upper ones move forward.
    """
    inner = y_m - outward * width_m
    tyre = tube((x_m, inner, radius_m), (x_m, y_m, radius_m), radius_m, radius_m, _TYRE, 16)
    offset = y_m + outward * 0.008
    turned = 2.0 * math.pi / _SPOKES * step / WHEEL_STEPS

    def place(share: float, angle: float, y: float) -> Vec:
        # From straight up, forward.
        x = x_m + share * radius_m * math.sin(angle)
        return x, y, radius_m * (1.0 + share * math.cos(angle))

    def disc(share: float, y: float, colour: Colour) -> Mesh:
        angles = outward * 2.0 * math.pi * np.arange(12) / 12
        return fan([place(share, float(t), y) for t in angles], colour)

    parts = [tyre, disc(0.66, offset, _RIM)]
    for i in range(_SPOKES):
        middle = turned + 2.0 * math.pi * (i + 0.5) / _SPOKES
        gap = [
            place(share, middle + outward * half, offset + outward * 0.004)
            for share, half in ((0.24, -0.3), (0.24, 0.3), (0.56, 0.42), (0.56, -0.42))
        ]
        parts.append(quad(gap[3], gap[2], gap[1], gap[0], _TYRE))
    parts.append(disc(0.16, offset + outward * 0.008, PLASTIC))
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
