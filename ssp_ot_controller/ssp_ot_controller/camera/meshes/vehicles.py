"""Bodies of cars, trucks and buses, fitted to the extents of an ObjectState; parts that they share.

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
from ssp_ot_controller.camera.kernels.palettes import rgb
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP, MATTE
from ssp_ot_controller.camera.meshes.mesh import Colour, Mesh, Vec, box, fan, join, loft, quad, tube

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

    def ys(self, side: float, inner: float, outer: float) -> tuple[float, float]:
        """Between two shares of one side, + is left, in rising order."""
        a, b = side * self.y(inner), side * self.y(outer)
        return min(a, b), max(a, b)


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


def side_panel(
    side: float, y: float, x0: float, x1: float, z0: float, z1: float, colour: Colour, kind: int
) -> Mesh:
    """On the flank of a side, + is left."""
    near, far = (x1, x0) if side > 0.0 else (x0, x1)
    return quad((near, y, z0), (far, y, z0), (far, y, z1), (near, y, z1), colour, kind)


@dataclass(frozen=True)
class _CarShape:
    """Side view of a car, shares of length and height."""

    bonnet_z: float
    deck_z: float
    backlight_base: float
    roof_rear: float
    roof_front: float
    windscreen_base: float


_SEDAN = _CarShape(0.60, 0.66, 0.10, 0.27, 0.53, 0.71)
_HATCHBACK = _CarShape(0.61, 0.64, 0.015, 0.13, 0.55, 0.74)
CAR_SHAPES = (_SEDAN, _HATCHBACK)


def _car_hull(f: Frame, shape: _CarShape, paint: Colour) -> Mesh:
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
    rings = []
    for share, low, high, width in stations:
        rise = high - low
        half = [
            (0.86 * width, low),
            (0.99 * width, low + 0.18 * rise),
            (width, low + 0.45 * rise),
            (0.985 * width, low + 0.75 * rise),
            (0.93 * width, low + 0.95 * rise),
            (0.80 * width, high),
        ]
        ring = [(f.x(share), f.y(y), f.z(z)) for y, z in half]
        ring += [(f.x(share), -f.y(y), f.z(z)) for y, z in reversed(half)]
        rings.append(ring)
    hull = loft(rings, paint, GLOSSY)
    skirt = hull.corners[..., 2] < f.z(0.2)
    hull.colours[skirt] = PLASTIC
    return hull


def _car_cabin(f: Frame, shape: _CarShape, paint: Colour, lights: Lights) -> Mesh:
    base, roof = shape.deck_z - 0.02, 0.965
    levels = (
        (base, shape.backlight_base, shape.windscreen_base + 0.015, 0.93),
        (roof, shape.roof_rear, shape.roof_front, 0.70),
        (1.0, shape.roof_rear + 0.05, shape.roof_front - 0.05, 0.58),
    )
    rings = []
    for level, rear, front, width in levels:
        x0, x1, y, z = f.x(rear), f.x(front), f.y(width), f.z(level)
        cx, cy = 0.03 * f.size.length_m, 0.08 * f.size.width_m
        rings.append(
            [
                (x1, -y + cy, z),
                (x1, y - cy, z),
                (x1 - cx, y, z),
                (x0 + cx, y, z),
                (x0, y - cy, z),
                (x0, -y + cy, z),
                (x0 + cx, -y, z),
                (x1 - cx, -y, z),
            ]
        )
    low, high = rings[0], rings[1]
    faces = {
        "front": (low[0], low[1], high[1], high[0]),
        "left": (low[2], low[3], high[3], high[2]),
        "rear": (low[4], low[5], high[5], high[4]),
        "right": (low[6], low[7], high[7], high[6]),
    }
    parts = [loft(rings, paint, GLOSSY)]
    parts.append(on_face(faces["front"], (0.0, 1.0), (0.08, 0.93), PANE, GLASS))
    parts.append(on_face(faces["rear"], (0.04, 0.96), (0.18, 0.9), PANE, GLASS))
    for side, windows in (
        ("left", ((0.06, 0.45), (0.49, 0.9))),
        ("right", ((0.1, 0.51), (0.55, 0.94))),
    ):
        parts += [on_face(faces[side], w, (0.12, 0.9), PANE, GLASS) for w in windows]
    colour, kind = lights.tail if lights.brake else (TAIL, GLOSSY)
    parts.append(on_face(faces["rear"], (0.4, 0.6), (0.92, 0.99), colour, kind, 0.02))
    return join(parts)


def _car_details(f: Frame, shape: _CarShape, paint: Colour, lights: Lights) -> Mesh:
    rear, front = -f.size.rear_m - 0.006, f.size.front_m + 0.006
    top, nose = shape.deck_z - 0.1, shape.bonnet_z - 0.18
    mirror_x = f.x(shape.windscreen_base - 0.03)
    parts = [
        rear_panel(rear, -f.y(0.24), f.y(0.24), f.z(0.37), f.z(0.44), PLATE, MATTE),
        rear_panel(rear, -f.y(0.84), f.y(0.84), f.z(0.245), f.z(0.3), PLASTIC, MATTE),
        front_panel(front, -f.y(0.45), f.y(0.45), f.z(0.23), f.z(0.36), PLASTIC, MATTE),
        front_panel(front + 0.01, -f.y(0.22), f.y(0.22), f.z(0.27), f.z(0.33), PLATE, MATTE),
    ]
    for side in (-1.0, 1.0):
        turn, tail = lights.turn(side), (f.z(top - 0.1), f.z(top))
        lamp, above = (f.z(top - 0.115), f.z(top - 0.045)), (f.z(nose - 0.15), f.z(nose - 0.095))
        repeater = (f.x(0.745), f.x(0.785), f.z(0.42), f.z(0.48))
        head = (f.z(nose - 0.08), f.z(nose))
        parts += [
            rear_panel(rear, *f.ys(side, 0.46, 0.86), *tail, *lights.tail),
            rear_panel(rear - 0.004, *f.ys(side, 0.73, 0.89), *lamp, *turn),
            front_panel(front, *f.ys(side, 0.48, 0.79), f.z(nose - 0.09), f.z(nose), *lights.head),
            front_panel(front + 0.004, *f.ys(side, 0.58, 0.82), *above, *turn),
            side_panel(side, side * (f.y(1.0) + 0.01), *repeater, *turn),
            box((f.x(0.0), f.x(0.035)), f.ys(side, 0.9, 0.965), tail, *lights.tail),
            box((f.x(0.955), f.x(0.985)), f.ys(side, 0.85, 0.95), head, *lights.head),
            box((mirror_x - 0.06, mirror_x + 0.06), f.ys(side, 0.97, 1.14),
                (f.z(0.64), f.z(0.72)), paint, GLOSSY),
        ]  # fmt: skip
        y, dx = side * (f.y(1.0) + 0.006), 0.009 * side
        for x in (f.x(0.26), f.x(0.46), f.x(0.68)):  # door gaps
            low, high = f.z(0.2), f.z(0.56)
            gap = ((x + dx, y, low), (x - dx, y, low), (x - dx, y, high), (x + dx, y, high))
            parts.append(quad(*gap, PLASTIC))
    return join(parts)


def car(size: Size, paint: Colour, variant: int, lights: Lights, travelled_m: float = 0.0) -> Mesh:
    """A car; ``variant`` picks sedan or hatchback, ``travelled_m`` turns its wheels."""
    step = wheel_step(travelled_m, _radius(size))
    return _car(size, paint, variant % len(CAR_SHAPES), lights, step)


def _radius(size: Size) -> float:
    return 0.215 * size.height_m


@lru_cache(maxsize=256)
def _car(size: Size, paint: Colour, variant: int, lights: Lights, step: int) -> Mesh:
    f, radius = Frame(size), _radius(size)
    parts = [_car_body(size, paint, variant, lights)]
    for x in (0.0, f.x(0.805)):
        for side in (-1.0, 1.0):
            y = side * (f.y(1.0) + 0.012)
            parts.append(wheel(x, y, radius, 0.2, side, step))
    return join(parts)


@lru_cache(maxsize=64)
def _car_body(size: Size, paint: Colour, variant: int, lights: Lights) -> Mesh:
    f, shape = Frame(size), CAR_SHAPES[variant]
    parts = [
        _car_hull(f, shape, paint),
        _car_cabin(f, shape, paint, lights),
        _car_details(f, shape, paint, lights),
    ]
    for x in (0.0, f.x(0.805)):
        for side in (-1.0, 1.0):
            y = side * (f.y(1.0) + 0.004)
            parts.append(arch(x, y, 1.18 * _radius(size), f.z(0.13), side))
    return join(parts)


_RADIUS_M = 0.48  # of the wheels of both
_DARK = (PLASTIC, MATTE)


def truck(size: Size, paint: Colour, lights: Lights, travelled_m: float = 0.0) -> Mesh:
    """A box truck: cab, gap, cargo box with rear doors, underrun guard."""
    return _truck(size, paint, lights, wheel_step(travelled_m, _RADIUS_M))


def bus(size: Size, paint: Colour, lights: Lights, travelled_m: float = 0.0) -> Mesh:
    """A city bus: one long body with a band of windows, doors on the right, a destination sign."""
    return _bus(size, paint, lights, wheel_step(travelled_m, _RADIUS_M))


@lru_cache(maxsize=128)
def _truck(size: Size, paint: Colour, lights: Lights, step: int) -> Mesh:
    f = Frame(size)
    wheels = [
        wheel(x, side * f.y(0.98), _RADIUS_M, 0.32, side, step)
        for side in (-1.0, 1.0)
        for x in (0.0, f.x(0.86))
    ]
    return join([_truck_body(size, paint, lights), *wheels])


@lru_cache(maxsize=64)
def _truck_body(size: Size, paint: Colour, lights: Lights) -> Mesh:
    f = Frame(size)
    cargo, frame_z, slope = rgb("d9dad6"), 0.95, 0.28
    cab0, cab1 = f.x(0.77), f.x(1.0)
    top, cab_top = size.height_m, 0.86 * size.height_m

    def level(half: float, front: float, z: float) -> list[Vec]:
        y = f.y(half)
        return [(cab0, -y, z), (front, -y, z), (front, y, z), (cab0, y, z)]

    low, middle = level(0.96, cab1, 0.45), level(0.96, cab1, 1.55)
    high = level(0.9, cab1 - slope, cab_top)
    rear = f.x(0.0) - 0.008
    parts = [
        _solid(low, middle, paint, GLOSSY),
        _solid(middle, high, paint, GLOSSY),
        on_face((middle[1], middle[2], high[2], high[1]), (0.06, 0.94), (0.05, 0.78), PANE, GLASS),
        on_face((middle[2], middle[3], high[3], high[2]), (0.1, 0.62), (0.05, 0.7), PANE, GLASS),
        on_face((middle[0], middle[1], high[1], high[0]), (0.38, 0.9), (0.05, 0.7), PANE, GLASS),
        front_panel(cab1 + 0.01, -f.y(0.6), f.y(0.6), 0.85, 1.4, PLASTIC, MATTE),
        front_panel(cab1 + 0.01, -f.y(0.95), f.y(0.95), 0.45, 0.65, PLASTIC, MATTE),
        box((f.x(0.0), f.x(0.75)), (-f.y(1.0), f.y(1.0)), (frame_z, top), cargo, MATTE),
        box((f.x(0.01), f.x(0.8)), (-f.y(0.4), f.y(0.4)), (0.5, frame_z), PLASTIC, MATTE),
        box((f.x(0.0), f.x(0.012)), (-f.y(0.95), f.y(0.95)), (0.42, 0.58), PLASTIC, MATTE),
    ]
    parts += [  # frame and hinge line of the rear doors
        rear_panel(rear, f.y(y), f.y(y + 0.04), frame_z, top, rgb("8d908f"), MATTE)
        for y in (-0.97, -0.02, 0.93)
    ]
    stripe, doors = rgb("b23a34"), rear - 0.004
    band = (frame_z + 0.25 * (top - frame_z), frame_z + 0.45 * (top - frame_z))
    parts += [
        rear_panel(doors, -f.y(0.96), f.y(0.96), frame_z, frame_z + 0.12, stripe, MATTE),
        rear_panel(doors, -f.y(0.2), f.y(0.2), 0.6, 0.72, PLATE, MATTE),
        side_panel(1.0, f.y(1.0) + 0.008, f.x(0.03), f.x(0.72), *band, paint, MATTE),
        side_panel(-1.0, -f.y(1.0) - 0.008, f.x(0.03), f.x(0.72), *band, paint, MATTE),
    ]
    for side in (-1.0, 1.0):
        turn = lights.turn(side)
        y = side * (f.y(0.96) + 0.012)
        mirror = ((cab1 - 0.35, cab1 - 0.25), f.ys(side, 1.0, 1.15), (1.7, 2.3))
        parts += [
            rear_panel(doors, *f.ys(side, 0.6, 0.94), 0.62, 0.84, *lights.tail),
            front_panel(cab1 + 0.012, *f.ys(side, 0.6, 0.94), 0.7, 0.9, *lights.head),
            box(*mirror, PLASTIC, MATTE),
            rear_panel(rear - 0.008, *f.ys(side, 0.74, 0.96), 0.6, 0.72, *turn),
            front_panel(cab1 + 0.014, *f.ys(side, 0.78, 0.96), 0.92, 1.06, *turn),
            side_panel(side, y, cab1 - 0.45, cab1 - 0.2, 1.3, 1.42, *turn),
        ]
    return join(parts)


def _solid(low: Sequence[Vec], high: Sequence[Vec], colour: Colour, kind: int) -> Mesh:
    """A solid between two rectangles, each counter-clockwise as seen from above."""
    faces = [quad(high[0], high[1], high[2], high[3], colour, kind)]
    for i in range(4):
        j = (i + 1) % 4
        faces.append(quad(low[i], low[j], high[j], high[i], colour, kind))
    return join(faces)


@lru_cache(maxsize=128)
def _bus(size: Size, paint: Colour, lights: Lights, step: int) -> Mesh:
    f = Frame(size)
    wheels = [
        wheel(x, side * (f.y(1.0) + 0.016), _RADIUS_M, 0.3, side, step)
        for side in (-1.0, 1.0)
        for x in (0.0, f.x(0.79))
    ]
    return join([_bus_body(size, paint, lights), *wheels])


@lru_cache(maxsize=64)
def _bus_body(size: Size, paint: Colour, lights: Lights) -> Mesh:
    f = Frame(size)
    floor, top = 0.32, size.height_m
    window = (0.42 * top, 0.82 * top)
    left, right = f.y(1.0) + 0.01, -f.y(1.0) - 0.01
    rear, front = f.x(0.0) - 0.01, f.x(1.0) + 0.01

    def level(half: float, inset: float, z: float) -> list[Vec]:
        x0, x1, y = f.x(inset), f.x(1.0 - inset), f.y(half)
        return [(x0, -y, z), (x1, -y, z), (x1, y, z), (x0, y, z)]

    parts = [
        box((f.x(0.0), f.x(1.0)), (-f.y(1.0), f.y(1.0)), (floor, 0.9 * top), paint, GLOSSY),
        _solid(level(1.0, 0.0, 0.9 * top), level(0.88, 0.01, top), rgb("dcdcd8"), MATTE),
        rear_panel(rear, -f.y(0.86), f.y(0.86), 0.52 * top, 0.82 * top, PANE, GLASS),
        rear_panel(rear, -f.y(0.8), f.y(0.8), 0.26 * top, 0.44 * top, rgb("3b3e42"), MATTE),
        rear_panel(rear - 0.004, -f.y(0.2), f.y(0.2), 0.17 * top, 0.21 * top, PLATE, MATTE),
        rear_panel(rear, -f.y(0.3), f.y(0.3), 0.84 * top, 0.9 * top, AMBER, LAMP),
        front_panel(front, -f.y(0.92), f.y(0.92), 0.36 * top, 0.8 * top, PANE, GLASS),
        front_panel(front, -f.y(0.7), f.y(0.7), 0.82 * top, 0.9 * top, AMBER, LAMP),
        front_panel(front, -f.y(0.98), f.y(0.98), floor, 0.18 * top, PLASTIC, MATTE),
    ]
    panes = 7
    for i in range(panes):
        x0 = f.x(0.02 + 0.95 * i / panes)
        x1 = f.x(0.02 + 0.95 * (i + 0.92) / panes)
        low = 0.45 if i in (3, 6) else window[0]  # doors
        parts.append(side_panel(1.0, left, x0, x1, *window, PANE, GLASS))
        parts.append(side_panel(-1.0, right, x0, x1, low, window[1], PANE, GLASS))
    for side in (-1.0, 1.0):
        turn, lamp = lights.turn(side), f.ys(side, 0.72, 0.94)
        flank = left if side > 0.0 else right
        parts += [
            rear_panel(rear - 0.002, *f.ys(side, 0.68, 0.97), 0.22 * top, 0.45 * top, *_DARK),
            rear_panel(rear - 0.004, *lamp, 0.24 * top, 0.34 * top, *lights.tail),
            rear_panel(rear - 0.004, *lamp, 0.37 * top, 0.43 * top, *turn),
            front_panel(front + 0.004, *f.ys(side, 0.76, 0.96), 0.29 * top, 0.34 * top, *turn),
            side_panel(side, flank, f.x(0.93), f.x(0.955), 0.3 * top, 0.345 * top, *turn),
            front_panel(front + 0.004, *lamp, 0.2 * top, 0.27 * top, *lights.head),
            box((f.x(1.0), f.x(1.012)), f.ys(side, 1.0, 1.16), (0.55 * top, 0.72 * top), PLASTIC,
                MATTE),
        ]  # fmt: skip
        y = side * (f.y(1.0) + 0.012)
        parts += [arch(x, y, 1.2 * _RADIUS_M, floor, side) for x in (0.0, f.x(0.79))]
    return join(parts)
