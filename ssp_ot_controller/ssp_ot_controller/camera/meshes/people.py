"""Bodies of pedestrians, cyclists and motorcyclists, posed by the distance travelled.

The origin is the reference point on the ground (under the body or the saddle), x forward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ssp_core.motion.state import Size
from ssp_ot_controller.camera.kernels.palettes import rgb
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP
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
_SHOE, _TYRE, _METAL, _LEATHER = rgb("1f1d1d"), rgb("1b1b1d"), rgb("9ba0a5"), rgb("2a2b2f")
_PANE, _HELMET, _ENGINE = rgb("14181c"), rgb("e8e6e0"), rgb("3a3c40")
_STRIDE_M = 1.45  # both steps
_PEDAL_M = 5.26  # way per turn of the pedals
_PHASES = 48  # poses per stride or turn, so that bodies can be kept
_SWINGS = 8


@dataclass(frozen=True)
class Outfit:
    """Colours of one person, and of what the person rides."""

    top: Colour
    trousers: Colour
    skin: Colour
    hair: Colour
    vehicle: Colour


def outfit(number: int, tops: tuple[Colour, ...], trousers: tuple[Colour, ...]) -> Outfit:
    """Return the outfit that a number stands for."""
    return Outfit(
        tops[number % len(tops)],
        trousers[(number // 7) % len(trousers)],
        _SKIN[(number // 31) % len(_SKIN)],
        _HAIR[(number // 101) % len(_HAIR)],
        tops[(number // 13 + 1) % len(tops)],
    )


def _limb(
    a: Vec,
    b: Vec,
    halves_m: tuple[float, float],
    bend: float,
    radii: Sequence[float],
    colours: tuple[Colour, Colour],
) -> Mesh:
    """Return a leg or an arm between two ends, its joint in the x-z plane.

    A ``bend`` above 0 is forward.
    """
    upper_m, lower_m = halves_m
    dx, dy, dz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    reach = min(max(math.sqrt(dx * dx + dy * dy + dz * dz), 1e-6), upper_m + lower_m)
    along = (upper_m**2 - lower_m**2 + reach**2) / (2 * reach)
    out = bend * math.sqrt(max(0.0, upper_m**2 - along**2)) / (math.hypot(dx, dz) or 1e-6)
    t = along / reach
    middle = (a[0] + t * dx - out * dz, a[1] + t * dy, a[2] + t * dz + out * dx)
    return join(
        [
            tube(a, middle, radii[0], radii[1], colours[0], 7),
            tube(middle, b, radii[1], radii[2], colours[1], 7),
        ]
    )


def _torso(
    levels: Sequence[tuple[float, float]],
    x_m: float,
    lean: float,
    depth_m: float,
    half_m: float,
    colour: Colour,
) -> Mesh:
    """Return a rounded body through elliptic outlines (height, share of the width), leaning.

    A ``lean`` above 0 is forward.
    """
    angles = 2.0 * np.pi * np.arange(10) / 10
    rings = []
    for z, share in levels:
        x = x_m + lean * (z - levels[0][0]) + depth_m * (0.55 + 0.45 * share) * np.cos(angles)
        rings.append(np.stack([x, half_m * share * np.sin(angles), np.full(10, z)], axis=1))
    return loft(rings, colour)


def pedestrian(size: Size, look: Outfit, travelled_m: float, speed_mps: float) -> Mesh:
    """Return a walking person.

    Legs and arms swing with the distance travelled, and hang when the person stands.
    """
    phase = round(travelled_m / _STRIDE_M * _PHASES) % _PHASES
    return _walker(size, look, phase, round(min(1.0, abs(speed_mps)) * _SWINGS))


@lru_cache(maxsize=256)
def _walker(size: Size, look: Outfit, phase_step: int, swing_step: int) -> Mesh:
    h, half = size.height_m, 0.30 * size.width_m
    hip, shoulder, depth = 0.53 * h, 0.82 * h, 0.068 * h
    coat = (
        (hip - 0.01 * h, 0.86),
        (hip + 0.08 * h, 0.8),
        (0.7 * h, 0.92),
        (shoulder, 1.0),
        (shoulder + 0.03 * h, 0.45),
    )
    waist = ((hip - 0.07 * h, 0.66), (hip, 0.84))
    parts = [
        _torso(coat, 0.0, 0.0, depth, half, look.top),
        _torso(waist, 0.0, 0.0, depth, half, look.trousers),
        tube((0.0, 0.0, shoulder), (0.0, 0.0, 0.9 * h), 0.03 * h, 0.03 * h, look.skin, 7),
        ellipsoid((0.012 * h, 0.0, 0.932 * h), (0.062 * h, 0.047 * h, 0.068 * h), look.skin),
        ellipsoid((0.0, 0.0, 0.949 * h), (0.062 * h, 0.052 * h, 0.06 * h), look.hair, 5),
    ]
    for side in (-1.0, 1.0):
        angle = 2.0 * math.pi * phase_step / _PHASES + (0.0 if side > 0 else math.pi)
        swing = h * swing_step / _SWINGS * math.sin(angle)
        lift = 0.07 * h * swing_step / _SWINGS * max(0.0, math.cos(angle))
        top, foot = (
            (0.0, side * 0.6 * half, hip),
            (0.21 * swing, side * 0.055 * h, 0.045 * h + lift),
        )
        shoe = (foot[0] + 0.035 * h, foot[1], foot[2] - 0.02 * h)
        arm = (0.0, side * (half + 0.022 * h), shoulder - 0.02 * h)
        hand = (
            0.02 * h - 0.16 * swing,
            side * (half + 0.05 * h),
            hip - 0.02 * h + 0.048 * abs(swing),
        )
        legs, arms = (0.05 * h, 0.038 * h, 0.026 * h), (0.034 * h, 0.027 * h, 0.02 * h)
        parts += [
            _limb(top, foot, (0.255 * h, 0.25 * h), 1.0, legs, (look.trousers,) * 2),
            ellipsoid(shoe, (0.075 * h, 0.026 * h, 0.025 * h), _SHOE, 4, 7),
            _limb(arm, hand, (0.16 * h, 0.155 * h), -1.0, arms, (look.top,) * 2),
            ellipsoid(hand, (0.025 * h,) * 3, look.skin, 4, 6),
        ]
    return join(parts)


def _rider(
    look: Outfit,
    size: Size,
    saddle: Vec,
    grip: Vec,
    feet: Sequence[Vec],
    lean_m: float,
    sleeves: Colour,
) -> list[Mesh]:
    """Return a person without a head on a saddle: hands on the bar, feet where they are put."""
    scale = size.height_m / 1.75
    top_m, hip_m = size.height_m - 0.32 * scale, saddle[2] + 0.06
    rise = top_m - hip_m
    coat = (
        (hip_m - 0.05, 0.85),
        (hip_m + 0.3 * rise, 0.82),
        (hip_m + 0.75 * rise, 1.0),
        (top_m, 0.9),
        (top_m + 0.05, 0.4),
    )
    parts = [_torso(coat, saddle[0], lean_m / rise, 0.125 * scale, 0.2 * scale, look.top)]
    legs = (0.085 * scale, 0.06 * scale, 0.045 * scale)
    for side, foot in zip((-1.0, 1.0), feet, strict=True):
        hip, hand = (saddle[0], side * 0.1, hip_m), (grip[0], side * grip[1], grip[2])
        arm = (saddle[0] + lean_m, side * 0.2 * scale, top_m - 0.02)
        shoe = (foot[0] + 0.05, foot[1], foot[2])
        parts += [
            _limb(hip, foot, (0.46 * scale,) * 2, 1.0, legs, (look.trousers,) * 2),
            ellipsoid(shoe, (0.13, 0.045, 0.045), _SHOE, 4, 7),
            _limb(arm, hand, (0.32 * scale,) * 2, -1.0, (0.055, 0.042, 0.034), (look.top, sleeves)),
        ]
    return parts


def cyclist(size: Size, look: Outfit, travelled_m: float, lamps: bool) -> Mesh:
    """Return a bicycle with its rider, whose legs turn the pedals with the distance travelled."""
    return _bicycle(size, look, round(travelled_m / _PEDAL_M * _PHASES) % _PHASES, lamps)


@lru_cache(maxsize=256)
def _bicycle(size: Size, look: Outfit, phase_step: int, lamps: bool) -> Mesh:
    radius, bar = 0.335, 0.026
    rear, front = -size.rear_m + radius, size.front_m - radius
    crank, saddle = (0.18, 0.0, 0.28), (-0.02, 0.0, 0.93)
    grip: Vec = (front - 0.12, 0.25, 1.0)
    bars = (
        (crank, saddle, bar),
        (crank, (front - 0.1, 0.0, 0.68), 1.2 * bar),
        ((0.02, 0.0, 0.82), (front - 0.17, 0.0, 0.92), bar),
        ((rear, 0.0, radius), crank, 0.8 * bar),
        ((rear, 0.0, radius), (0.02, 0.0, 0.8), 0.7 * bar),
        ((front, 0.0, radius), (front - 0.19, 0.0, 1.0), bar),
    )
    lamp = LAMP if lamps else GLOSSY
    red = rgb("ff3a30") if lamps else rgb("b01c1c")
    behind, ahead = (-size.rear_m + 0.02, -size.rear_m + 0.05), (front - 0.02, front + 0.03)
    # The rider's head, 0.12 m below the top at 1.75 m, and a helmet that leaves the face free.
    scale = size.height_m / 1.75
    head_m = size.height_m - 0.12 * scale
    helmet = (0.145 * scale, 0.105 * scale, 0.09 * scale)
    parts = [
        *(ring((x, 0.0, radius), radius, 0.045, 0.055, _TYRE) for x in (rear, front)),
        *(tube(a, b, r, r, look.vehicle, 6, GLOSSY) for a, b, r in bars),
        tube((grip[0], -0.28, 1.0), (grip[0], 0.28, 1.0), 0.018, 0.018, _TYRE, 6),
        ellipsoid(saddle, (0.14, 0.08, 0.035), _TYRE, 4, 7),
        box(behind, (-0.05, 0.05), (0.6, 0.7), red, lamp),
        box(ahead, (-0.04, 0.04), (0.86, 0.93), rgb("fffbe8"), lamp),
        ellipsoid((0.35, 0.0, head_m), (0.115 * scale, 0.09 * scale, 0.12 * scale), look.skin),
        ellipsoid((0.33, 0.0, head_m + 0.035 * scale), helmet, _HELMET, 5, 10, GLOSSY),
    ]
    feet = []
    for side in (-1.0, 1.0):
        turn = -2.0 * math.pi * phase_step / _PHASES + (0.0 if side > 0 else math.pi)
        x, z = 0.17 * math.cos(turn), 0.17 * math.sin(turn)
        feet.append((crank[0] + x, side * 0.12, crank[2] + 0.06 + z))
    return join(parts + _rider(look, size, saddle, grip, feet, 0.3, look.skin))


@lru_cache(maxsize=64)
def motorcycle(size: Size, look: Outfit, lights: Lights) -> Mesh:
    """Return a motorcycle with its rider in a full helmet and dark clothes."""
    radius, paint = 0.31, look.vehicle
    tail_m, nose_m = -size.rear_m, size.front_m - radius  # rear end, front hub
    hub = tail_m + radius
    saddle, grip = (-0.1, 0.0, 0.78), (nose_m - 0.42, 0.34, 1.05)
    scale = size.height_m / 1.75
    head_m = size.height_m - 0.12 * scale
    visor = (0.125 * scale, 0.115 * scale, 0.06 * scale)
    low, high = (nose_m - 0.12, 0.17, 0.98), (nose_m - 0.34, 0.12, 1.26)  # left edge of the screen
    screen = (low, (low[0], -low[1], low[2]), (high[0], -high[1], high[2]), high)
    parts = [
        ring((hub, 0.0, radius), radius, 0.09, 0.17, _TYRE),
        ring((nose_m, 0.0, radius), radius, 0.09, 0.12, _TYRE),
        tube((hub, -0.07, radius), (hub, 0.07, radius), 0.2, 0.2, _METAL, 10),
        tube((nose_m, -0.06, radius), (nose_m, 0.06, radius), 0.2, 0.2, _METAL, 10),
        box((hub + 0.36, nose_m - 0.36), (-0.17, 0.17), (0.24, 0.6), _ENGINE),
        ellipsoid((nose_m - 0.68, 0.0, 0.82), (0.32, 0.19, 0.17), paint, 6, 10, GLOSSY),
        ellipsoid((nose_m - 0.24, 0.0, 0.88), (0.24, 0.2, 0.22), paint, 6, 10, GLOSSY),
        ellipsoid((nose_m, 0.0, 0.58), (0.24, 0.085, 0.06), paint, 5, 8, GLOSSY),
        quad(*screen, _PANE, GLASS),
        quad(*screen[::-1], _PANE, GLASS),
        box((tail_m + 0.2, nose_m - 0.85), (-0.13, 0.13), (0.68, 0.79), _TYRE),
        box((tail_m + 0.02, tail_m + 0.4), (-0.13, 0.13), (0.66, 0.84), paint, GLOSSY),
        box((tail_m, tail_m + 0.03), (-0.12, 0.12), (0.69, 0.81), *lights.tail),
        box((tail_m - 0.01, tail_m + 0.03), (-0.09, 0.09), (0.46, 0.58), rgb("e9e6d8")),
        box((nose_m - 0.03, nose_m + 0.02), (-0.11, 0.11), (0.82, 0.98), rgb("fffbe8"), LAMP),
        tube((grip[0], -0.38, grip[2]), (grip[0], 0.38, grip[2]), 0.022, 0.022, _TYRE, 6),
        ellipsoid(
            (0.18, 0.0, head_m), (0.15 * scale, 0.13 * scale, 0.15 * scale), paint, 7, 10, GLOSSY
        ),
        ellipsoid((0.22, 0.0, head_m + 0.015 * scale), visor, _PANE, 5, 10, GLASS),
    ]
    for side in (-1.0, 1.0):
        y0, y1 = sorted((side * 0.17, side * 0.28))
        fork = (nose_m, side * 0.09, radius), (nose_m - 0.3, side * 0.09, 1.0)
        swing_arm = (hub, side * 0.08, radius), (hub + 0.5, side * 0.1, 0.42)
        parts += [
            tube(*fork, 0.03, 0.03, _METAL, 6),
            tube(*swing_arm, 0.035, 0.045, _METAL, 6),
            box((tail_m + 0.02, tail_m + 0.08), (y0, y1), (0.7, 0.79), *lights.turn(side)),
            box((nose_m - 0.16, nose_m - 0.09), (y0, y1), (0.86, 0.95), *lights.turn(side)),
        ]
    blue, green, red = (0.6 * a + 0.4 * b for a, b in zip(_LEATHER, look.top, strict=True))
    dark = replace(look, top=(blue, green, red), trousers=_LEATHER)
    feet = ((0.1, -0.22, 0.36), (0.1, 0.22, 0.36))
    return join(parts + _rider(dark, size, saddle, grip, feet, 0.22, _LEATHER))
