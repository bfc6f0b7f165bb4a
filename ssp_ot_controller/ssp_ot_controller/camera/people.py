"""Bodies of pedestrians, posed by the distance travelled, and the parts that riders share.

The origin is the reference point on the ground (under the body or the saddle), x forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssp_core.motion.state import Size
from ssp_ot_controller.camera.mesh import (
    Colour,
    Mesh,
    Vec,
    box,
    ellipsoid,
    join,
    loft,
    tube,
)
from ssp_ot_controller.camera.palettes import rgb
from ssp_ot_controller.camera.surfaces import MATTE

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
