"""Meshes of what stands beside a road: trees, lamps, houses, hedges, cones, fences, traffic signs.

A sign's mesh faces along -x, towards drivers who go along x.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_core.geometry import Pose2
from ssp_ot_controller.camera.kernels.palettes import Palette, rgb
from ssp_ot_controller.camera.kernels.shading import FACADE, FOLIAGE, LAMP, MATTE
from ssp_ot_controller.camera.meshes.mesh import (
    Colour,
    Mesh,
    Vec,
    box,
    ellipsoid,
    fan,
    join,
    quad,
    triangles,
    tube,
)

_TRUNK = rgb("5a4635")
_POLE = rgb("6f7478")
_SOCKLE = rgb("807c76")
_STEEL = rgb("a5abb0")
_PARAPET_M, _ROOF_SLOPE = 0.5, 0.42  # height of a flat roof; of a ridge, per m of depth
_LEAST_WALLS_M, _WIDEST_PITCHED_M = 2.4, 14.0
LAMP_POST_M = 7.5


def tree(rng: np.random.Generator, palette: Palette, height_m: float) -> Mesh:
    """Return a broad-leaved tree."""
    colour = np.array(palette.foliage[int(rng.integers(len(palette.foliage)))])
    scale, trunk_m = height_m / 7.0, height_m / 7.0 * rng.uniform(1.9, 2.6)
    parts = [tube((0, 0, 0), (0, 0, trunk_m + 0.8), 0.17 * scale, 0.1 * scale, _TRUNK, 7)]
    for i in range(5):
        angle, off = rng.uniform(0, 2 * np.pi), scale * (0.0 if i == 0 else rng.uniform(0.7, 1.3))
        up = trunk_m + scale * (2.3 if i == 0 else rng.uniform(0.7, 2.6))
        size = scale * (1.9 if i == 0 else rng.uniform(1.0, 1.5))
        ripple = rng.uniform(0.82, 1.14, (7, 10))
        ripple[0], ripple[-1] = 1.0, 1.0
        b, g, r = colour * rng.uniform(0.85, 1.12)
        centre = (off * math.cos(angle), off * math.sin(angle), up)
        radii = (size, size, 0.85 * size)
        parts.append(ellipsoid(centre, radii, (b, g, r), 6, 10, FOLIAGE, ripple))
    mesh = join(parts)
    return mesh.scaled(height_m / float(mesh.corners[..., 2].max()))


def lamp_post(toward_road: float, palette: Palette, height_m: float = LAMP_POST_M) -> Mesh:
    """Return a street lamp whose arm reaches towards the road (+1: to the left)."""
    shine = (rgb("fff0c4"), LAMP) if palette.lamps_on else (rgb("d9dcdd"), MATTE)
    arm = 1.6 * toward_road
    head, shade, top = (arm - 0.35, arm + 0.35), (arm - 0.3, arm + 0.3), height_m + 0.05
    return join(
        [
            tube((0, 0, 0), (0, 0, top - 0.25), 0.09, 0.06, _POLE, 7),
            tube((0, 0, top - 0.3), (0, arm, top - 0.05), 0.05, 0.045, _POLE, 6),
            box((-0.14, 0.14), head, (top - 0.13, top), _POLE),
            box((-0.11, 0.11), shade, (top - 0.17, top - 0.13), *shine),
        ]
    )


def pole(height_m: float) -> Mesh:
    """Return a bare post."""
    return tube((0, 0, 0), (0, 0, height_m), 0.08, 0.06, _POLE, 8)


def building_of(
    rng: np.random.Generator,
    palette: Palette,
    length_m: float,
    width_m: float,
    height_m: float,
    may_be_pitched: bool,
) -> Mesh:
    """Return a building of a map, as high as it says; length along x, centred on the origin.

    A small one may have a pitched roof, whose ridge lies along its longer side.
    """
    longer, shorter = max(length_m, width_m), min(length_m, width_m)
    walls_m = height_m - _ROOF_SLOPE * shorter
    if may_be_pitched and walls_m >= _LEAST_WALLS_M and shorter <= _WIDEST_PITCHED_M:
        mesh = building(rng, palette, longer, shorter, walls_m, pitched=True)
    else:
        rim_m = min(_PARAPET_M, 0.5 * height_m)
        mesh = building(rng, palette, longer, shorter, height_m - rim_m, pitched=False, rim_m=rim_m)
    return mesh if length_m >= width_m else mesh.placed(Pose2(0.0, 0.0, np.pi / 2))


def building(
    rng: np.random.Generator,
    palette: Palette,
    width_m: float,
    depth_m: float,
    top: float,
    pitched: bool,
    rim_m: float = _PARAPET_M,
) -> Mesh:
    """Return a house or block with windows all around; x along the road, centred on the origin.

    Its walls are ``top`` high, with a roof on top; a flat one is as high as its rim.
    """
    wall = palette.walls[int(rng.integers(len(palette.walls)))]
    roof = palette.roofs[int(rng.integers(len(palette.roofs)))]
    x, y = width_m / 2, depth_m / 2
    parts = [box((-x - 0.03, x + 0.03), (-y - 0.03, y + 0.03), (0.0, min(0.5, top)), _SOCKLE)]
    # Window columns start at a whole period, so that facades begin and end with wall.
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
        length = math.hypot(bx - ax, by - ay)
        wall_uv = [(0.0, 0.0), (length, 0.0), (length, top), (0.0, top)]
        a, b, over_b, over_a = (ax, ay, 0.0), (bx, by, 0.0), (bx, by, top), (ax, ay, top)
        parts.append(quad(a, b, over_b, over_a, wall, FACADE, wall_uv))
    if not pitched:
        parts.append(box((-x - 0.2, x + 0.2), (-y - 0.2, y + 0.2), (top, top + rim_m), roof))
        return join(parts)
    ridge, end, eaves, low = top + _ROOF_SLOPE * depth_m, x + 0.5, y + 0.5, top - 0.1
    for side in (-1.0, 1.0):  # towards -y along x, and back on the other side
        far, near, foot = side * end, -side * end, side * eaves
        up = ((near, 0.0, ridge), (far, 0.0, ridge))
        parts.append(quad((far, foot, low), (near, foot, low), *up, roof))
        gable = [(side * x, -side * y, top), (side * x, side * y, top), (side * x, 0.0, ridge)]
        parts.append(triangles([gable], wall))
    return join(parts)


def hedge(length_m: float, palette: Palette) -> Mesh:
    """Return a clipped hedge along the road, 1.1 m high, centred on the origin."""
    half = length_m / 2
    body = box((-half, half), (-0.35, 0.35), (0.0, 1.1), palette.foliage[0], FOLIAGE)
    plane = np.stack([body.corners[..., 0] + body.corners[..., 1], body.corners[..., 2]], axis=2)
    return Mesh(body.corners, body.normals, body.colours, plane, body.kinds)


def cone() -> Mesh:
    """Return a traffic cone of 0.7 m."""
    orange, white = rgb("e0561c"), rgb("f0f0ee")
    return join(
        [
            box((-0.2, 0.2), (-0.2, 0.2), (0.0, 0.04), rgb("2c2c2e")),
            tube((0, 0, 0.04), (0, 0, 0.3), 0.15, 0.105, orange, 9),
            tube((0, 0, 0.3), (0, 0, 0.47), 0.105, 0.07, white, 9),
            tube((0, 0, 0.47), (0, 0, 0.7), 0.07, 0.025, orange, 9),
        ]
    )


def fence(length_m: float) -> Mesh:
    """Return a post and a rail of a safety fence along the road, centred on the origin."""
    post = box((-0.05, 0.05), (-0.05, 0.05), (0.0, 0.75), _STEEL)
    half = length_m / 2
    return join([post, box((-half, half), (-0.04, 0.04), (0.48, 0.76), _STEEL)])


_SIGN_POLE, _BACK = rgb("8d9296"), rgb("9aa0a4")
_RED, _WHITE, _BLUE, _BLACK = rgb("c81e24"), rgb("f2f2f0"), rgb("1f5fae"), rgb("17181a")
_MIDDLE_M = 2.5  # above the ground
_LIFT_M = 0.006

# Regular polygons that lie over each other: radius, corners, where the first one is, colour.
_SIGNS: dict[str, tuple[tuple[float, int, float, Colour], ...]] = {
    "speed_limit": ((0.42, 20, 0.0, _RED), (0.33, 20, 0.0, _WHITE)),
    "crossing": ((0.566, 4, math.pi / 4, _BLUE), (0.36, 3, math.pi / 2, _WHITE)),
    "stop": ((0.48, 8, math.pi / 8, _WHITE), (0.43, 8, math.pi / 8, _RED)),
    "yield": ((0.5, 3, -math.pi / 2, _RED), (0.32, 3, -math.pi / 2, _WHITE)),
    "other": ((0.45, 4, math.pi / 4, _BLACK), (0.38, 4, math.pi / 4, _WHITE)),
}
# Bars of a digit: top, upper left and right, middle, lower left and right, bottom.
_BARS = {
    "0": "1110111",
    "1": "0010010",
    "2": "1011101",
    "3": "1011011",
    "4": "0111010",
    "5": "1101011",
    "6": "1101111",
    "7": "1010010",
    "8": "1111111",
    "9": "1111011",
}


def sign(kind: str, value: int | None = None) -> Mesh:
    """Return a traffic sign on its post; ``value`` is printed on it."""
    layers = [_polygon(*layer, k + 1) for k, layer in enumerate(_SIGNS[kind])]
    back = triangles(_polygon(*_SIGNS[kind][0], -1).corners[:, ::-1], _BACK)
    post = tube((0.05, 0, 0), (0.05, 0, _MIDDLE_M + 0.3), 0.035, 0.035, _SIGN_POLE, 6)
    return join([post, back, *layers, *_digits("" if value is None else str(value))])


def _polygon(radius_m: float, sides: int, first_rad: float, colour: Colour, lift: int) -> Mesh:
    """Return a regular polygon, with a corner at first_rad from its right hand side."""
    angles = 2.0 * np.pi * np.arange(sides) / sides + first_rad
    outline: list[Vec] = [
        (-_LIFT_M * lift, -radius_m * math.cos(a), _MIDDLE_M + radius_m * math.sin(a))
        for a in angles
    ]
    return fan(outline, colour)


def _digits(text: str) -> list[Mesh]:
    """Return digits of seven bars; for a view along x, y falls from left to right."""
    width, gap, height = (0.13, 0.05, 0.3) if len(text) > 2 else (0.19, 0.07, 0.36)
    bar, x, middle = 0.24 * width, -3 * _LIFT_M, _MIDDLE_M
    low, high = middle - height / 2, middle + height / 2
    meshes = []
    for i, digit in enumerate(text):
        y1 = (len(text) * (width + gap) - gap) / 2 - i * (width + gap)
        y0 = y1 - width
        places = (
            (y0, y1, high - bar, high),
            (y1 - bar, y1, middle, high),
            (y0, y0 + bar, middle, high),
            (y0, y1, middle - bar / 2, middle + bar / 2),
            (y1 - bar, y1, low, middle),
            (y0, y0 + bar, low, middle),
            (y0, y1, low, low + bar),
        )
        for (a, b, z0, z1), on in zip(places, _BARS[digit], strict=True):
            if on == "1":
                meshes.append(quad((x, b, z0), (x, a, z0), (x, a, z1), (x, b, z1), _BLACK))
    return meshes
