"""Bodies of pedestrians, cyclists and motorcyclists, posed by the distance travelled.

The origin is the reference point on the ground (under the body or the saddle), x forward.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ssp_core.motion.state import Size
from ssp_ot_controller.camera.kernels.palettes import rgb
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP, MATTE
from ssp_ot_controller.camera.meshes.mesh import (
    Colour,
    Mesh,
    Vec,
    box,
    ellipsoid,
    join,
    loft,
    quad,
    ring,
    tube,
)
from ssp_ot_controller.camera.meshes.vehicles import Lights

_SKIN = (rgb("d9a684"), rgb("a9744f"), rgb("7a4f35"), rgb("e5b898"))
_HAIR = (rgb("2a1d15"), rgb("5a3d22"), rgb("1a1a1c"), rgb("8a6a3a"))
SHOE = rgb("1f1d1d")
_STRIDE_M = 1.45  # both steps
_PHASES = 48  # poses per stride, so that bodies can be kept
_SWINGS = 8


@dataclass(frozen=True)
class Outfit:
    """Colours of one person, and of what the person rides."""

    top: Colour
    trousers: Colour
    skin: Colour
    hair: Colour
    vehicle: Colour
    bag: bool


def outfit(number: int, tops: tuple[Colour, ...], trousers: tuple[Colour, ...]) -> Outfit:
    """The outfit that a number stands for."""
    return Outfit(
        tops[number % len(tops)],
        trousers[(number // 7) % len(trousers)],
        _SKIN[(number // 31) % len(_SKIN)],
        _HAIR[(number // 101) % len(_HAIR)],
        tops[(number // 13 + 1) % len(tops)],
        (number // 3) % 2 == 0,
    )


def joint(a: Vec, b: Vec, upper_m: float, lower_m: float, bend: float) -> Vec:
    """Knee or elbow between two ends in the x-z plane; bend + puts it forward."""
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    reach = math.sqrt(dx * dx + dy * dy + dz * dz)
    reach = min(max(reach, 1e-6), upper_m + lower_m)
    along = (upper_m**2 - lower_m**2 + reach**2) / (2 * reach)
    out = math.sqrt(max(0.0, upper_m**2 - along**2))
    norm = math.hypot(dx, dz) or 1e-6
    forward = (-dz / norm, dx / norm)
    t = along / reach
    return (
        a[0] + t * dx + bend * out * forward[0],
        a[1] + t * dy,
        a[2] + t * dz + bend * out * forward[1],
    )


def limb(
    a: Vec, middle: Vec, b: Vec, radii: tuple[float, float, float], colours: tuple[Colour, Colour]
) -> Mesh:
    return join(
        [
            tube(a, middle, radii[0], radii[1], colours[0], 7),
            tube(middle, b, radii[1], radii[2], colours[1], 7),
        ]
    )


def _head(x: float, z: float, size: float, look: Outfit) -> Mesh:
    return join(
        [
            ellipsoid((x, 0.0, z), (0.062 * size, 0.047 * size, 0.068 * size), look.skin, 6, 9),
            ellipsoid(
                (x - 0.012 * size, 0.0, z + 0.017 * size),
                (0.062 * size, 0.052 * size, 0.06 * size),
                look.hair, 5, 9,
            ),
        ]
    )  # fmt: skip


def pedestrian(size: Size, look: Outfit, travelled_m: float, speed_mps: float) -> Mesh:
    """A walking person; legs and arms swing with the distance travelled, and hang when standing."""
    phase = round(travelled_m / _STRIDE_M * _PHASES) % _PHASES
    return _walker(size, look, phase, round(min(1.0, abs(speed_mps)) * _SWINGS))


@lru_cache(maxsize=256)
def _walker(size: Size, look: Outfit, phase_step: int, swing_step: int) -> Mesh:
    h = size.height_m
    swing = swing_step / _SWINGS
    phase = 2.0 * math.pi * phase_step / _PHASES
    hip, shoulder = 0.53 * h, 0.82 * h
    half = 0.30 * size.width_m
    parts = []
    for side in (-1.0, 1.0):
        angle = phase + (0.0 if side > 0 else math.pi)
        step = 0.21 * h * swing * math.sin(angle)
        lift = 0.07 * h * swing * max(0.0, math.cos(angle))
        top = (0.0, side * 0.30 * half * 2, hip)
        foot = (step, side * 0.055 * h, 0.045 * h + lift)
        knee = joint(top, foot, 0.255 * h, 0.25 * h, 1.0)
        parts.append(
            limb(top, knee, foot, (0.05 * h, 0.038 * h, 0.026 * h), (look.trousers, look.trousers))
        )
        parts.append(
            ellipsoid(
                (foot[0] + 0.035 * h, foot[1], foot[2] - 0.02 * h),
                (0.075 * h, 0.026 * h, 0.025 * h), SHOE, 4, 7,
            )
        )  # fmt: skip
        reach = -0.16 * h * swing * math.sin(angle)
        arm = (0.0, side * (half + 0.022 * h), shoulder - 0.02 * h)
        hand = (reach + 0.02 * h, side * (half + 0.05 * h), hip - 0.02 * h + 0.3 * abs(reach))
        elbow = joint(arm, hand, 0.16 * h, 0.155 * h, -1.0)
        parts.append(limb(arm, elbow, hand, (0.034 * h, 0.027 * h, 0.02 * h), (look.top, look.top)))
        parts.append(ellipsoid(hand, (0.025 * h,) * 3, look.skin, 4, 6))
    depth = 0.068 * h
    parts += [
        torso(((hip - 0.01 * h, 0.86), (hip + 0.08 * h, 0.8), (0.7 * h, 0.92), (shoulder, 1.0),
                (shoulder + 0.03 * h, 0.45)), 0.0, 0.0, depth, half, look.top),
        torso(((hip - 0.07 * h, 0.66), (hip + 0.0 * h, 0.84)), 0.0, 0.0, depth, half,
               look.trousers),
        tube((0.0, 0.0, shoulder), (0.0, 0.0, 0.9 * h), 0.03 * h, 0.03 * h, look.skin, 7),
        _head(0.012 * h, 0.932 * h, h, look),
    ]  # fmt: skip
    if look.bag:
        parts.append(
            box((-depth - 0.1, -depth + 0.02), (-0.7 * half, 0.7 * half), (0.6 * h, 0.81 * h),
                look.vehicle, MATTE)
        )  # fmt: skip
    return join(parts)


def torso(
    levels: tuple[tuple[float, float], ...],
    x0: float,
    lean: float,
    depth_m: float,
    half_m: float,
    colour: Colour,
) -> Mesh:
    """A rounded body through elliptic outlines (height, share of the width), leaning forward."""
    angles = 2.0 * np.pi * np.arange(10) / 10
    rings = []
    base = levels[0][0]
    for z, share in levels:
        x = x0 + lean * (z - base)
        rings.append(
            np.stack(
                [
                    x + depth_m * (0.55 + 0.45 * share) * np.cos(angles),
                    half_m * share * np.sin(angles),
                    np.full(10, z),
                ],
                axis=1,
            )
        )
    return loft(rings, colour)


_TYRE = rgb("1b1b1d")
_METAL = rgb("9ba0a5")
_PANE = rgb("14181c")
_LEATHER = rgb("2a2b2f")
_WHEEL_M = 0.335  # radius of a bicycle's wheels
# Wheel turns per turn of the pedals; with eight spokes the wheels look the same after each.
_GEAR = 2.5
_PEDAL_M = _GEAR * 2.0 * math.pi * _WHEEL_M
_HELMET = rgb("e8e6e0")
# poses per turn of the pedals, so that bodies can be kept
_MOTOR_WHEEL_M = 0.31
_MOTOR_SPOKES = 3  # bars across the wheel
_MOTOR_STEPS = 8  # poses of a motorcycle's wheel between two of its spokes


def _rider(
    look: Outfit,
    size: Size,
    saddle: Vec,
    grip: Vec,
    feet: tuple[Vec, Vec],
    lean_m: float,
    sleeves: Colour,
    head: Callable[[float, float, float], Mesh],
) -> Mesh:
    """A person who sits on a saddle, hands on the bar, feet where they are put.

    ``head`` makes what is above the shoulders, of a place along x, a height and a scale.
    """
    h = size.height_m
    scale = h / 1.75
    top = h - 0.12 * scale
    shoulder = (saddle[0] + lean_m, 0.0, top - 0.2 * scale)
    hip_z = saddle[2] + 0.06
    lean = lean_m / (shoulder[2] - hip_z)
    rise = shoulder[2] - hip_z
    parts = [
        torso(((hip_z - 0.05, 0.85), (hip_z + 0.3 * rise, 0.82), (hip_z + 0.75 * rise, 1.0),
                (shoulder[2], 0.9), (shoulder[2] + 0.05, 0.4)),
               saddle[0], lean, 0.125 * scale, 0.2 * scale, look.top),
        head(shoulder[0], top, scale),
    ]  # fmt: skip
    for side, foot in zip((-1.0, 1.0), feet, strict=True):
        hip = (saddle[0], side * 0.1, hip_z)
        knee = joint(hip, foot, 0.46 * scale, 0.46 * scale, 1.0)
        parts.append(
            limb(
                hip,
                knee,
                foot,
                (0.085 * scale, 0.06 * scale, 0.045 * scale),
                (look.trousers, look.trousers),
            )
        )
        parts.append(
            ellipsoid((foot[0] + 0.05, foot[1], foot[2]), (0.13, 0.045, 0.045), SHOE, 4, 7)
        )
        arm = (shoulder[0], side * 0.2 * scale, shoulder[2] - 0.02)
        hand = (grip[0], side * grip[1], grip[2])
        elbow = joint(arm, hand, 0.32 * scale, 0.32 * scale, -1.0)
        parts.append(limb(arm, elbow, hand, (0.055, 0.042, 0.034), (look.top, sleeves)))
    return join(parts)


def _open_helmet(x: float, z: float, scale: float, look: Outfit) -> Mesh:
    return join(
        [
            ellipsoid((x + 0.07, 0.0, z), (0.115 * scale, 0.09 * scale, 0.12 * scale),
                      look.skin, 6, 9),
            ellipsoid((x + 0.05, 0.0, z + 0.035 * scale),
                      (0.145 * scale, 0.105 * scale, 0.09 * scale), _HELMET, 5, 10, GLOSSY),
        ]
    )  # fmt: skip


def _full_helmet(x: float, z: float, scale: float, paint: Colour) -> Mesh:
    """Closed all round, with a dark visor."""
    return join(
        [
            ellipsoid((x + 0.06, 0.0, z), (0.15 * scale, 0.13 * scale, 0.15 * scale),
                      paint, 7, 10, GLOSSY),
            ellipsoid((x + 0.1, 0.0, z + 0.015 * scale),
                      (0.125 * scale, 0.115 * scale, 0.06 * scale), _PANE, 5, 10, GLASS),
        ]
    )  # fmt: skip


def cyclist(size: Size, look: Outfit, travelled_m: float, lamps: bool) -> Mesh:
    """A bicycle with its rider; pedals and wheels turn with the distance travelled."""
    return _bicycle(size, look, round(travelled_m / _PEDAL_M * _PHASES) % _PHASES, lamps)


@lru_cache(maxsize=256)
def _bicycle(size: Size, look: Outfit, phase_step: int, lamps: bool) -> Mesh:
    angle = -2.0 * math.pi * phase_step / _PHASES
    radius = _WHEEL_M
    rear, front = -size.rear_m + radius, size.front_m - radius
    crank = (0.18, 0.0, 0.28)
    saddle = (-0.02, 0.0, 0.93)
    head_low, head_high = (front - 0.1, 0.0, 0.68), (front - 0.17, 0.0, 0.92)
    grip: Vec = (front - 0.12, 0.25, 1.0)
    bar = 0.026
    frame = look.vehicle
    parts = [
        ring((rear, 0.0, radius), radius, 0.045, 0.055, _TYRE),
        ring((front, 0.0, radius), radius, 0.045, 0.055, _TYRE),
        tube(crank, saddle, bar, bar, frame, 6, GLOSSY),
        tube(crank, head_low, bar * 1.2, bar * 1.2, frame, 6, GLOSSY),
        tube((0.02, 0.0, 0.82), head_high, bar, bar, frame, 6, GLOSSY),
        tube((rear, 0.0, radius), crank, bar * 0.8, bar * 0.8, frame, 6, GLOSSY),
        tube((rear, 0.0, radius), (0.02, 0.0, 0.8), bar * 0.7, bar * 0.7, frame, 6, GLOSSY),
        tube((front, 0.0, radius), (front - 0.19, 0.0, 1.0), bar, bar, frame, 6, GLOSSY),
        tube((grip[0], -0.28, 1.0), (grip[0], 0.28, 1.0), 0.018, 0.018, _TYRE, 6),
        ellipsoid(saddle, (0.14, 0.08, 0.035), _TYRE, 4, 7),
        box((-size.rear_m + 0.02, -size.rear_m + 0.05), (-0.05, 0.05), (0.6, 0.7),
            rgb("ff3a30") if lamps else rgb("b01c1c"), LAMP if lamps else GLOSSY),
        box((front - 0.02, front + 0.03), (-0.04, 0.04), (0.86, 0.93),
            rgb("fffbe8"), LAMP if lamps else GLOSSY),
    ]  # fmt: skip
    parts += [_spokes((x, 0.0, radius), radius, _GEAR * angle) for x in (rear, front)]
    feet = []
    for side in (-1.0, 1.0):
        turn = angle + (0.0 if side > 0 else math.pi)
        feet.append(
            (crank[0] + 0.17 * math.cos(turn), side * 0.12, crank[2] + 0.06 + 0.17 * math.sin(turn))
        )
    parts.append(
        _rider(
            look, size, saddle, grip, (feet[0], feet[1]), 0.3, look.skin,
            lambda x, z, scale: _open_helmet(x, z, scale, look),
        )
    )  # fmt: skip
    return join(parts)


def _spokes(hub: Vec, radius_m: float, angle: float, count: int = 4, bar_m: float = 0.006) -> Mesh:
    """So many bars right across a wheel."""
    parts = []
    for i in range(count):
        turn = angle + i * math.pi / count
        dx, dz = 0.93 * radius_m * math.cos(turn), 0.93 * radius_m * math.sin(turn)
        low, high = (hub[0] - dx, 0.0, hub[2] - dz), (hub[0] + dx, 0.0, hub[2] + dz)
        parts.append(tube(low, high, bar_m, bar_m, _METAL, 3))
    return join(parts)


def motorcycle(size: Size, look: Outfit, lights: Lights, travelled_m: float = 0.0) -> Mesh:
    """A motorcycle with its rider in a full helmet and dark clothes; its wheels turn."""
    between = 2.0 * math.pi / (2 * _MOTOR_SPOKES) * _MOTOR_WHEEL_M
    step = round(travelled_m / between * _MOTOR_STEPS) % _MOTOR_STEPS
    return _motorcycle(size, look, lights, step)


@lru_cache(maxsize=128)
def _motorcycle(size: Size, look: Outfit, lights: Lights, step: int) -> Mesh:
    radius = _MOTOR_WHEEL_M
    turned = -math.pi / _MOTOR_SPOKES * step / _MOTOR_STEPS
    spokes = [
        _spokes((x, 0.0, radius), 0.85 * radius, turned, _MOTOR_SPOKES, 0.022)
        for x in (-size.rear_m + radius, size.front_m - radius)
    ]
    return join([_motorcycle_body(size, look, lights), *spokes])


@lru_cache(maxsize=32)
def _motorcycle_body(size: Size, look: Outfit, lights: Lights) -> Mesh:
    radius = _MOTOR_WHEEL_M
    rear, front = -size.rear_m + radius, size.front_m - radius
    saddle = (-0.1, 0.0, 0.78)
    grip: Vec = (front - 0.42, 0.34, 1.05)
    paint = look.vehicle
    tail, tail_kind = lights.tail
    parts = [
        ring((rear, 0.0, radius), radius, 0.09, 0.17, _TYRE),
        ring((front, 0.0, radius), radius, 0.09, 0.12, _TYRE),
        tube((rear, -0.07, radius), (rear, 0.07, radius), 0.09, 0.09, _METAL, 10),
        tube((front, -0.06, radius), (front, 0.06, radius), 0.12, 0.12, _METAL, 10),
        tube((front, -0.09, radius), (front - 0.3, -0.09, 1.0), 0.03, 0.03, _METAL, 6),
        tube((front, 0.09, radius), (front - 0.3, 0.09, 1.0), 0.03, 0.03, _METAL, 6),
        tube((rear, -0.08, radius), (rear + 0.5, -0.1, 0.42), 0.035, 0.045, _METAL, 6),
        tube((rear, 0.08, radius), (rear + 0.5, 0.1, 0.42), 0.035, 0.045, _METAL, 6),
        box((rear + 0.36, front - 0.36), (-0.17, 0.17), (0.24, 0.6), rgb("3a3c40"), MATTE),
        ellipsoid((front - 0.68, 0.0, 0.82), (0.32, 0.19, 0.17), paint, 6, 10, GLOSSY),
        ellipsoid((front - 0.24, 0.0, 0.88), (0.24, 0.2, 0.22), paint, 6, 10, GLOSSY),
        ellipsoid((front, 0.0, 0.58), (0.24, 0.085, 0.06), paint, 5, 8, GLOSSY),
        quad((front - 0.12, -0.17, 0.98), (front - 0.12, 0.17, 0.98), (front - 0.34, 0.12, 1.26),
             (front - 0.34, -0.12, 1.26), _PANE, GLASS),
        quad((front - 0.12, 0.17, 0.98), (front - 0.12, -0.17, 0.98), (front - 0.34, -0.12, 1.26),
             (front - 0.34, 0.12, 1.26), _PANE, GLASS),
        box((-size.rear_m + 0.2, front - 0.85), (-0.13, 0.13), (0.68, 0.79), _TYRE, MATTE),
        box((-size.rear_m + 0.02, -size.rear_m + 0.4), (-0.13, 0.13), (0.66, 0.84), paint, GLOSSY),
        box((-size.rear_m, -size.rear_m + 0.03), (-0.12, 0.12), (0.69, 0.81), tail, tail_kind),
        box((-size.rear_m - 0.01, -size.rear_m + 0.03), (-0.09, 0.09), (0.46, 0.58), rgb("e9e6d8")),
        box((front - 0.03, front + 0.02), (-0.11, 0.11), (0.82, 0.98), rgb("fffbe8"), LAMP),
        tube((grip[0], -0.38, grip[2]), (grip[0], 0.38, grip[2]), 0.022, 0.022, _TYRE, 6),
        tube((rear, -0.2, 0.4), (0.2, -0.2, 0.34), 0.065, 0.05, _METAL, 7),
    ]  # fmt: skip
    for side in (-1.0, 1.0):
        turn, turn_kind = lights.turn(side)
        y0, y1 = sorted((side * 0.17, side * 0.28))
        parts += [
            box((-size.rear_m + 0.02, -size.rear_m + 0.08), (y0, y1), (0.7, 0.79), turn, turn_kind),
            box((front - 0.16, front - 0.09), (y0, y1), (0.86, 0.95), turn, turn_kind),
            box((grip[0] + 0.02, grip[0] + 0.05), _ordered(side * 0.3, side * 0.46),
                (1.16, 1.26), _TYRE),
        ]  # fmt: skip
    feet = ((0.1, -0.22, 0.36), (0.1, 0.22, 0.36))
    dark = replace(look, top=_jacket(look.top), trousers=_LEATHER)
    parts.append(
        _rider(
            dark, size, saddle, grip, feet, 0.22, _LEATHER,
            lambda x, z, scale: _full_helmet(x, z, scale, paint),
        )
    )  # fmt: skip
    return join(parts)


def _ordered(a: float, b: float) -> tuple[float, float]:
    return min(a, b), max(a, b)


def _jacket(top: Colour) -> Colour:
    """Leather with a shade of its wearer's colour."""
    blue, green, red = (0.6 * a + 0.4 * b for a, b in zip(_LEATHER, top, strict=True))
    return blue, green, red
