"""Bodies of cars, fitted to the extents of an ObjectState; see vehicle_parts for the frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from ssp_core.motion.state import Size
from ssp_ot_controller.camera.mesh import Colour, Mesh, box, join, loft, quad
from ssp_ot_controller.camera.surfaces import GLASS, GLOSSY, MATTE
from ssp_ot_controller.camera.vehicle_parts import (
    PANE,
    PLASTIC,
    PLATE,
    TAIL,
    Frame,
    Lights,
    arch,
    front_panel,
    left_panel,
    on_face,
    rear_panel,
    right_panel,
    wheel,
    wheel_step,
)


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
    tail, tail_kind = lights.tail
    head, head_kind = lights.head
    top = shape.deck_z - 0.1
    nose = shape.bonnet_z - 0.18
    parts = [
        rear_panel(rear, -f.y(0.24), f.y(0.24), f.z(0.37), f.z(0.44), PLATE, MATTE),
        rear_panel(rear, -f.y(0.84), f.y(0.84), f.z(0.245), f.z(0.3), PLASTIC, MATTE),
        front_panel(front, -f.y(0.45), f.y(0.45), f.z(0.23), f.z(0.36), PLASTIC, MATTE),
        front_panel(front + 0.01, -f.y(0.22), f.y(0.22), f.z(0.27), f.z(0.33), PLATE, MATTE),
    ]
    for side in (-1.0, 1.0):
        y0, y1 = sorted((side * f.y(0.46), side * f.y(0.86)))
        parts.append(rear_panel(rear, y0, y1, f.z(top - 0.1), f.z(top), tail, tail_kind))
        turn, turn_kind = lights.turn(side)
        y0, y1 = sorted((side * f.y(0.73), side * f.y(0.89)))
        parts.append(
            rear_panel(rear - 0.004, y0, y1, f.z(top - 0.115), f.z(top - 0.045), turn, turn_kind)
        )
        y0, y1 = sorted((side * f.y(0.48), side * f.y(0.79)))
        parts.append(front_panel(front, y0, y1, f.z(nose - 0.09), f.z(nose), head, head_kind))
        y0, y1 = sorted((side * f.y(0.58), side * f.y(0.82)))
        parts.append(
            front_panel(front + 0.004, y0, y1, f.z(nose - 0.15), f.z(nose - 0.095), turn, turn_kind)
        )
        repeater = (f.x(0.745), f.x(0.785), f.z(0.42), f.z(0.48))
        flank_panel = left_panel if side > 0.0 else right_panel
        parts.append(flank_panel(side * (f.y(1.0) + 0.01), *repeater, turn, turn_kind))
        flank = sorted((side * f.y(0.9), side * f.y(0.965)))
        parts.append(
            box(
                (f.x(0.0), f.x(0.035)),
                (flank[0], flank[1]),
                (f.z(top - 0.1), f.z(top)),
                tail,
                tail_kind,
            )
        )
        flank = sorted((side * f.y(0.85), side * f.y(0.95)))
        parts.append(
            box(
                (f.x(0.955), f.x(0.985)),
                (flank[0], flank[1]),
                (f.z(nose - 0.08), f.z(nose)),
                head,
                head_kind,
            )
        )
        mirror = sorted((side * f.y(0.97), side * f.y(1.14)))
        x = f.x(shape.windscreen_base - 0.03)
        parts.append(
            box((x - 0.06, x + 0.06), (mirror[0], mirror[1]), (f.z(0.64), f.z(0.72)), paint, GLOSSY)
        )
        for share in (0.26, 0.46, 0.68):  # door gaps
            y = side * (f.y(1.0) + 0.006)
            x = f.x(share)
            dx = 0.009 * side
            parts.append(
                quad(
                    (x + dx, y, f.z(0.2)),
                    (x - dx, y, f.z(0.2)),
                    (x - dx, y, f.z(0.56)),
                    (x + dx, y, f.z(0.56)),
                    PLASTIC,
                )
            )
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
