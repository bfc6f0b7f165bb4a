"""Bodies of cars, trucks and buses, fitted to the extents of an ObjectState.

The origin is the reference point (on the ground under the rear axle), x forward. Shares along the
body are counted from the rear end (0) to the front end (1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from ssp_core.motion.state import Size
from ssp_ot_controller.camera.kernels.palettes import rgb
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP, MATTE
from ssp_ot_controller.camera.meshes.mesh import (
    Colour,
    Mesh,
    Vec,
    box,
    fan,
    hexahedron,
    join,
    loft,
    quad,
    tube,
)

Surface = tuple[Colour, int]  # colour and kind
Range = tuple[float, float]

_TYRE, _RIM, _ARCH, _DARK = rgb("1c1c1e"), rgb("a9adb1"), rgb("26282b"), rgb("0c0c0d")
_PLASTIC: Surface = (rgb("26282b"), MATTE)
_PANE: Surface = (rgb("1d242b"), GLASS)
_PLATE: Surface = (rgb("e9e6d8"), MATTE)
_SIGN: Surface = (rgb("d98a2b"), LAMP)
_TAIL: Surface = (rgb("7d1418"), GLOSSY)


@dataclass(frozen=True)
class Lights:
    """The lights that are switched on."""

    brake: bool
    lamps: bool
    left: bool = False  # indicators: shining at this instant, not only blinking
    right: bool = False

    @property
    def tail(self) -> Surface:
        if self.brake:
            return rgb("ff4a3c"), LAMP
        return (rgb("a81c20"), LAMP) if self.lamps else _TAIL

    @property
    def head(self) -> Surface:
        return (rgb("fffbe8"), LAMP) if self.lamps else (rgb("dfe6ea"), GLOSSY)

    def turn(self, side: float) -> Surface:
        """Return the surface of the indicators of one side, + is left."""
        lit = self.left if side > 0.0 else self.right
        return (rgb("ffae1c"), LAMP) if lit else (rgb("8a4f1a"), GLOSSY)


@dataclass(frozen=True)
class _Frame:
    """Turns shares of a body's extents into metres."""

    size: Size

    def x(self, share: float) -> float:
        return -self.size.rear_m + share * self.size.length_m

    def y(self, share: float) -> float:
        return share * self.size.width_m / 2

    def ys(self, side: float, inner: float, outer: float) -> Range:
        """Return the range between two shares of one side, + is left, in rising order."""
        a, b = side * self.y(inner), side * self.y(outer)
        return min(a, b), max(a, b)

    def across(self, share: float) -> Range:
        """Return the range that reaches as far to both sides."""
        return -self.y(share), self.y(share)

    def zs(self, low: float, high: float) -> Range:
        return low * self.size.height_m, high * self.size.height_m


def _panel(
    face: Literal["rear", "front", "left", "right"],
    at_m: float,
    along: Range,
    z: Range,
    surface: Surface,
) -> Mesh:
    """Return an upright rectangle that looks to one side of the body; ``along`` is in x or in y."""
    a, b = along if face in ("front", "right") else along[::-1]
    if face in ("rear", "front"):
        (x0, y0), (x1, y1) = (at_m, a), (at_m, b)
    else:
        (x0, y0), (x1, y1) = (a, at_m), (b, at_m)
    return quad((x0, y0, z[0]), (x1, y1, z[0]), (x1, y1, z[1]), (x0, y0, z[1]), *surface)


def _on_face(face: Sequence[Vec], u: Range, v: Range, surface: Surface, lift_m: float) -> Mesh:
    """Return a panel on a quadrilateral, lifted off it.

    It lies between shares u along its base and v up.
    """
    a, b, c, d = (np.asarray(p, dtype=np.float64) for p in face)
    normal = np.cross(b - a, d - a)
    normal *= lift_m / np.linalg.norm(normal)

    def at(i: float, j: float) -> Vec:
        x, y, z = (1 - j) * ((1 - i) * a + i * b) + j * ((1 - i) * d + i * c) + normal
        return float(x), float(y), float(z)

    return quad(at(u[0], v[0]), at(u[1], v[0]), at(u[1], v[1]), at(u[0], v[1]), *surface)


def _wheels(
    f: _Frame, xs: Sequence[float], flank_m: float, radius_m: float, width_m: float
) -> list[Mesh]:
    """Return the wheels under dark arches on both flanks, and the dark below the body."""

    def disc(x: float, y: float, z: float, radius: float, colour: Colour) -> Mesh:
        angles = math.copysign(2.0, y) * math.pi * np.arange(12) / 12
        rim = [(x + radius * math.sin(t), y, z + radius * math.cos(t)) for t in angles]
        return fan(rim, colour)

    parts = [box((f.x(0.01), f.x(0.98)), (-flank_m, flank_m), (0.0, 0.02), _DARK)]
    for x in xs:
        for side in (-1.0, 1.0):
            inner, outer = side * (flank_m - width_m), side * (flank_m + 0.012)
            parts += [
                disc(x, side * (flank_m + 0.004), 1.3 * radius_m, 1.1 * radius_m, _ARCH),
                tube((x, inner, radius_m), (x, outer, radius_m), radius_m, radius_m, _TYRE, 16),
                disc(x, outer + side * 0.008, radius_m, 0.62 * radius_m, _RIM),
            ]
    return parts


@dataclass(frozen=True)
class _CarShape:
    """Side view of a car, shares of length and height."""

    bonnet_z: float
    deck_z: float
    backlight_base: float
    roof_rear: float
    roof_front: float
    windscreen_base: float


CAR_SHAPES = (
    _CarShape(0.60, 0.66, 0.10, 0.27, 0.53, 0.71),  # sedan
    _CarShape(0.61, 0.64, 0.015, 0.13, 0.55, 0.74),  # hatchback
)


@lru_cache(maxsize=64)
def car(size: Size, paint: Colour, variant: int, lights: Lights) -> Mesh:
    """Return a car; ``variant`` picks sedan or hatchback."""
    f, shape = _Frame(size), CAR_SHAPES[variant % len(CAR_SHAPES)]
    rear, front = -size.rear_m - 0.006, size.front_m + 0.006
    top, nose = shape.deck_z - 0.1, shape.bonnet_z - 0.18
    parts = [
        _car_hull(f, shape, paint),
        *_car_cabin(f, shape, paint, lights),
        *_wheels(f, (0.0, f.x(0.805)), f.y(1.0), 0.215 * size.height_m, 0.2),
        _panel("rear", rear, f.across(0.24), f.zs(0.37, 0.44), _PLATE),
        _panel("rear", rear, f.across(0.84), f.zs(0.245, 0.3), _PLASTIC),
        _panel("front", front, f.across(0.45), f.zs(0.23, 0.36), _PLASTIC),
    ]
    for side in (-1.0, 1.0):
        turn, behind = lights.turn(side), f.zs(top - 0.115, top - 0.045)
        ahead = f.zs(nose - 0.15, nose - 0.095)
        tail, head = f.zs(top - 0.1, top), f.zs(nose - 0.09, nose)
        parts += [
            _panel("rear", rear, f.ys(side, 0.46, 0.86), tail, lights.tail),
            _panel("rear", rear - 0.004, f.ys(side, 0.73, 0.89), behind, turn),
            _panel("front", front, f.ys(side, 0.48, 0.79), head, lights.head),
            _panel("front", front + 0.004, f.ys(side, 0.58, 0.82), ahead, turn),
            box((f.x(0.0), f.x(0.035)), f.ys(side, 0.9, 0.965), tail, *lights.tail),
            box((f.x(0.955), f.x(0.985)), f.ys(side, 0.85, 0.95), head, *lights.head),
        ]
    return join(parts)


def _car_hull(f: _Frame, shape: _CarShape, paint: Colour) -> Mesh:
    stations = (
        (0.000, 0.24, shape.deck_z - 0.09, 0.86),
        (0.012, 0.18, shape.deck_z - 0.03, 0.93),
        (0.06, 0.14, shape.deck_z, 0.98),
        (0.25, 0.12, shape.deck_z, 1.0),
        (0.60, 0.12, shape.deck_z - 0.01, 1.0),
        (shape.windscreen_base, 0.12, shape.bonnet_z + 0.02, 1.0),
        (0.90, 0.13, shape.bonnet_z - 0.05, 0.97),
        (0.97, 0.15, shape.bonnet_z - 0.11, 0.92),
        (1.000, 0.20, shape.bonnet_z - 0.17, 0.80),
    )
    # Half a cross-section from the bottom up: shares of the station's width and rise.
    profile = np.array(
        [(0.86, 0.0), (0.99, 0.18), (1.0, 0.45), (0.985, 0.75), (0.93, 0.95), (0.80, 1.0)]
    )
    rings = []
    for share, low, high, width in stations:
        y = f.y(width) * profile[:, 0]
        z = f.size.height_m * (low + (high - low) * profile[:, 1])
        half = np.stack([np.full(len(y), f.x(share)), y, z], axis=1)
        rings.append(np.concatenate([half, half[::-1] * (1.0, -1.0, 1.0)]))
    hull = loft(rings, paint, GLOSSY)
    hull.colours[hull.corners[..., 2] < 0.2 * f.size.height_m] = _PLASTIC[0]
    return hull


def _car_cabin(f: _Frame, shape: _CarShape, paint: Colour, lights: Lights) -> list[Mesh]:
    levels = (
        (shape.deck_z - 0.02, shape.backlight_base, shape.windscreen_base + 0.015, 0.93),
        (0.965, shape.roof_rear, shape.roof_front, 0.70),
        (1.0, shape.roof_rear + 0.05, shape.roof_front - 0.05, 0.58),
    )
    rings = []
    for level, rear, front, width in levels:
        x0, x1, y, z = f.x(rear), f.x(front), f.y(width), level * f.size.height_m
        dx, edge = 0.03 * f.size.length_m, y - 0.08 * f.size.width_m
        left = [(x1, edge, z), (x1 - dx, y, z), (x0 + dx, y, z), (x0, edge, z)]
        rings.append([*left, *((x, -y, z) for x, y, z in reversed(left))])
    low, high = rings[0], rings[1]

    def face(i: int) -> tuple[Vec, ...]:
        j = (i + 1) % 8
        return low[i], low[j], high[j], high[i]

    ahead, left_side, behind, right_side = face(7), face(1), face(3), face(5)
    panes = (
        (ahead, (0.0, 1.0), (0.08, 0.93)),
        (behind, (0.04, 0.96), (0.18, 0.9)),
        (left_side, (0.06, 0.45), (0.12, 0.9)),
        (left_side, (0.49, 0.9), (0.12, 0.9)),
        (right_side, (0.1, 0.51), (0.12, 0.9)),
        (right_side, (0.55, 0.94), (0.12, 0.9)),
    )
    third_lamp = lights.tail if lights.brake else _TAIL
    return [
        loft(rings, paint, GLOSSY),
        *(_on_face(*pane, _PANE, 0.012) for pane in panes),
        _on_face(behind, (0.4, 0.6), (0.92, 0.99), third_lamp, 0.02),
    ]


_RADIUS_M = 0.48  # of the wheels of trucks and buses


@lru_cache(maxsize=64)
def truck(size: Size, paint: Colour, lights: Lights) -> Mesh:
    """Return a box truck: cab, gap, cargo box with rear doors, underrun guard."""
    f, floor, top = _Frame(size), 0.95, size.height_m
    cab, rear = (f.x(0.77), f.x(1.0)), f.x(0.0) - 0.008

    def level(half: float, front: float, z: float) -> list[Vec]:
        y = f.y(half)
        return [(cab[0], -y, z), (front, -y, z), (front, y, z), (cab[0], y, z)]

    low, middle = level(0.96, cab[1], 0.45), level(0.96, cab[1], 1.55)
    high = level(0.9, cab[1] - 0.28, 0.86 * top)

    def pane(i: int, u: Range, v: Range) -> Mesh:
        return _on_face((middle[i], middle[i + 1], high[i + 1], high[i]), u, v, _PANE, 0.012)

    parts = [
        hexahedron(low, middle, paint, GLOSSY),
        hexahedron(middle, high, paint, GLOSSY),
        pane(0, (0.38, 0.9), (0.05, 0.7)),
        pane(1, (0.06, 0.94), (0.05, 0.78)),
        pane(2, (0.1, 0.62), (0.05, 0.7)),
        _panel("front", cab[1] + 0.01, f.across(0.6), (0.85, 1.4), _PLASTIC),
        _panel("front", cab[1] + 0.01, f.across(0.95), (0.45, 0.65), _PLASTIC),
        box((f.x(0.0), f.x(0.75)), f.across(1.0), (floor, top), rgb("d9dad6")),
        box((f.x(0.01), f.x(0.8)), f.across(0.4), (0.5, floor), *_PLASTIC),
        box((f.x(0.0), f.x(0.012)), f.across(0.95), (0.42, 0.58), *_PLASTIC),
        _panel("rear", rear - 0.004, f.across(0.2), (0.6, 0.72), _PLATE),
        *_wheels(f, (0.0, f.x(0.86)), f.y(0.98), _RADIUS_M, 0.32),
    ]
    for y in (-0.97, -0.02, 0.93):  # frame and middle of the rear doors
        edge = (f.y(y), f.y(y + 0.04))
        parts.append(_panel("rear", rear, edge, (floor, top), (rgb("8d908f"), MATTE)))
    for side in (-1.0, 1.0):
        turn, lamp = lights.turn(side), f.ys(side, 0.6, 0.94)
        parts += [
            _panel("rear", rear - 0.004, lamp, (0.62, 0.84), lights.tail),
            _panel("rear", rear - 0.008, f.ys(side, 0.74, 0.96), (0.6, 0.72), turn),
            _panel("front", cab[1] + 0.012, lamp, (0.7, 0.9), lights.head),
            _panel("front", cab[1] + 0.014, f.ys(side, 0.78, 0.96), (0.92, 1.06), turn),
            box((cab[1] - 0.35, cab[1] - 0.25), f.ys(side, 1.0, 1.15), (1.7, 2.3), *_PLASTIC),
        ]
    return join(parts)


@lru_cache(maxsize=64)
def bus(size: Size, paint: Colour, lights: Lights) -> Mesh:
    """Return a city bus.

    It is one long body with a band of windows, doors on the right, and a destination sign.
    """
    f, panes = _Frame(size), 7
    rear, front, side_m = f.x(0.0) - 0.01, f.x(1.0) + 0.01, f.y(1.0) + 0.01
    parts = [
        box((f.x(0.0), f.x(1.0)), f.across(1.0), (0.32, 0.9 * size.height_m), paint, GLOSSY),
        box((f.x(0.01), f.x(0.99)), f.across(0.9), f.zs(0.9, 1.0), rgb("dcdcd8")),
        _panel("rear", rear, f.across(0.86), f.zs(0.52, 0.82), _PANE),
        _panel("rear", rear, f.across(0.8), f.zs(0.26, 0.44), (rgb("3b3e42"), MATTE)),
        _panel("rear", rear, f.across(0.3), f.zs(0.84, 0.9), _SIGN),
        _panel("front", front, f.across(0.92), f.zs(0.36, 0.8), _PANE),
        _panel("front", front, f.across(0.7), f.zs(0.82, 0.9), _SIGN),
        *_wheels(f, (0.0, f.x(0.79)), f.y(1.0), _RADIUS_M, 0.3),
    ]
    for i in range(panes):
        x = (f.x(0.02 + 0.95 * i / panes), f.x(0.02 + 0.95 * (i + 0.92) / panes))
        is_door = i in (3, 6)
        parts += [
            _panel("left", side_m, x, f.zs(0.42, 0.82), _PANE),
            _panel("right", -side_m, x, f.zs(0.15 if is_door else 0.42, 0.82), _PANE),
        ]
    for side in (-1.0, 1.0):
        turn, lamp = lights.turn(side), f.ys(side, 0.72, 0.94)
        parts += [
            _panel("rear", rear - 0.002, f.ys(side, 0.68, 0.97), f.zs(0.22, 0.45), _PLASTIC),
            _panel("rear", rear - 0.004, lamp, f.zs(0.24, 0.34), lights.tail),
            _panel("rear", rear - 0.004, lamp, f.zs(0.37, 0.43), turn),
            _panel("front", front + 0.004, lamp, f.zs(0.2, 0.27), lights.head),
            _panel("front", front + 0.004, f.ys(side, 0.76, 0.96), f.zs(0.29, 0.34), turn),
            box((f.x(1.0), f.x(1.012)), f.ys(side, 1.0, 1.16), f.zs(0.55, 0.72), *_PLASTIC),
        ]
    return join(parts)
