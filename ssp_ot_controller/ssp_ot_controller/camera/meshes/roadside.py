"""Meshes of what stands beside a road: trees, lamps, houses, hedges, cones, fences, traffic signs.

A sign's mesh faces along -x, towards drivers who go along x.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import Sign
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
_PARAPET_M, _ROOF_SLOPE = 0.5, 0.42  # height of a flat roof; of a ridge, per m of depth
_LEAST_WALLS_M, _WIDEST_PITCHED_M = 2.4, 14.0
_TREE_M, _LAMP_POST_M = 7.0, 7.5  # heights of the usual ones


def tree(rng: np.random.Generator, palette: Palette, scale: float = 1.0) -> Mesh:
    """A broad-leaved tree of about 7 m times scale."""
    colour = palette.foliage[int(rng.integers(len(palette.foliage)))]
    trunk_m = scale * rng.uniform(1.9, 2.6)
    parts = [tube((0, 0, 0), (0, 0, trunk_m + 0.8), 0.17 * scale, 0.1 * scale, _TRUNK, 7)]
    for i in range(5):
        angle = rng.uniform(0, 2 * np.pi)
        off = scale * (0.0 if i == 0 else rng.uniform(0.7, 1.3))
        centre = (
            off * float(np.cos(angle)),
            off * float(np.sin(angle)),
            trunk_m + scale * (2.3 if i == 0 else rng.uniform(0.7, 2.6)),
        )
        size = scale * (1.9 if i == 0 else rng.uniform(1.0, 1.5))
        ripple = rng.uniform(0.82, 1.14, (7, 10))
        ripple[0], ripple[-1] = 1.0, 1.0
        tone = rng.uniform(0.85, 1.12)
        shade: Colour = (colour[0] * tone, colour[1] * tone, colour[2] * tone)
        parts.append(ellipsoid(centre, (size, size, 0.85 * size), shade, 6, 10, FOLIAGE, ripple))
    return join(parts)


def conifer(rng: np.random.Generator, palette: Palette) -> Mesh:
    """A pointed tree of 6 to 9 m."""
    colour = palette.foliage[int(rng.integers(len(palette.foliage)))]
    shade: Colour = (colour[0] * 0.85, colour[1] * 0.82, colour[2] * 0.75)
    height = rng.uniform(6.0, 9.0)
    parts = [tube((0, 0, 0), (0, 0, 1.2), 0.16, 0.14, _TRUNK, 6)]
    for i in range(4):
        low = 0.9 + i * (height - 0.9) * 0.22
        radius = 1.9 * (1 - 0.22 * i)
        parts.append(tube((0, 0, low), (0, 0, low + 0.36 * height), radius, 0.05, shade, 10, MATTE))
    return join(parts)


def tree_of(rng: np.random.Generator, palette: Palette, height_m: float) -> Mesh:
    """A tree of a map, exactly as high as it says."""
    mesh = tree(rng, palette, height_m / _TREE_M)
    return mesh.scaled(height_m / float(mesh.corners[..., 2].max()))


def lamp_post(toward_road: float, palette: Palette, height_m: float = _LAMP_POST_M) -> Mesh:
    """A street lamp whose arm reaches towards the road (+1: to the left)."""
    shine = rgb("fff0c4") if palette.lamps_on else rgb("d9dcdd")
    arm = 1.6 * toward_road
    head, shade = (arm - 0.35, arm + 0.35), (arm - 0.3, arm + 0.3)
    up = height_m - _LAMP_POST_M
    return join(
        [
            tube((0, 0, 0), (0, 0, 7.3 + up), 0.09, 0.06, _POLE, 7),
            tube((0, 0, 7.25 + up), (0, arm, 7.5 + up), 0.05, 0.045, _POLE, 6),
            box((-0.14, 0.14), head, (7.42 + up, 7.55 + up), _POLE),
            box((-0.11, 0.11), shade, (7.38 + up, 7.42 + up), shine,
                LAMP if palette.lamps_on else MATTE),
        ]
    )  # fmt: skip


def pole(height_m: float) -> Mesh:
    """A bare post."""
    return tube((0, 0, 0), (0, 0, height_m), 0.08, 0.06, _POLE, 8)


def _wall(
    a: tuple[float, float], b: tuple[float, float], z0: float, z1: float, colour: Colour
) -> Mesh:
    length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
    return quad(
        (a[0], a[1], z0), (b[0], b[1], z0), (b[0], b[1], z1), (a[0], a[1], z1), colour, FACADE,
        [(0.0, z0), (length, z0), (length, z1), (0.0, z1)],
    )  # fmt: skip


def building_of(
    rng: np.random.Generator,
    palette: Palette,
    length_m: float,
    width_m: float,
    height_m: float,
    may_be_pitched: bool,
) -> Mesh:
    """A building of a map, as high as it says; length along x, centred on the origin.

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
    """A house or block with windows all around; x along the road, centred on the origin.

    Its walls are ``top`` high, with a roof on top; a flat one is as high as its rim.
    """
    wall = palette.walls[int(rng.integers(len(palette.walls)))]
    roof = palette.roofs[int(rng.integers(len(palette.roofs)))]
    x, y = width_m / 2, depth_m / 2
    # Window columns start at a whole period, so that facades begin and end with wall.
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    parts = [_wall(corners[i], corners[(i + 1) % 4], 0.0, top, wall) for i in range(4)]
    parts.append(box((-x - 0.03, x + 0.03), (-y - 0.03, y + 0.03), (0.0, min(0.5, top)), _SOCKLE))
    if not pitched:
        parts.append(box((-x - 0.2, x + 0.2), (-y - 0.2, y + 0.2), (top, top + rim_m), roof))
        return join(parts)
    e, ridge = 0.5, top + _ROOF_SLOPE * depth_m
    low = top - 0.1
    parts += [
        quad(
            (-x - e, -y - e, low), (x + e, -y - e, low), (x + e, 0, ridge), (-x - e, 0, ridge), roof
        ),
        quad(
            (x + e, y + e, low), (-x - e, y + e, low), (-x - e, 0, ridge), (x + e, 0, ridge), roof
        ),
        triangles([(x, -y, top), (x, y, top), (x, 0, ridge)], wall),
        triangles([(-x, y, top), (-x, -y, top), (-x, 0, ridge)], wall),
    ]
    return join(parts)


def hedge(length_m: float, palette: Palette) -> Mesh:
    """A clipped hedge along the road, 1.1 m high, centred on the origin."""
    colour = palette.foliage[0]
    body = box((-length_m / 2, length_m / 2), (-0.35, 0.35), (0.0, 1.1), colour, FOLIAGE)
    plane = np.stack([body.corners[..., 0] + body.corners[..., 1], body.corners[..., 2]], axis=2)
    return Mesh(body.corners, body.normals, body.colours, plane, body.kinds)


def cone() -> Mesh:
    """A traffic cone of 0.7 m."""
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
    """A post-and-rail safety fence along the road, centred on the origin."""
    steel = rgb("a5abb0")
    posts = [
        box((x - 0.05, x + 0.05), (-0.05, 0.05), (0.0, 0.75), steel)
        for x in np.arange(-length_m / 2, length_m / 2 + 0.1, 4.0)
    ]
    rail = box((-length_m / 2, length_m / 2), (-0.04, 0.04), (0.48, 0.76), steel)
    return join([*posts, rail])


def mast() -> Mesh:
    """A light mast of 12 m."""
    return join(
        [
            tube((0, 0, 0), (0, 0, 12.0), 0.14, 0.09, _POLE, 8),
            box((-0.9, 0.9), (-0.15, 0.15), (11.7, 12.2), rgb("c9cdd0")),
        ]
    )


_SIGN_POLE = rgb("8d9296")
_BACK = rgb("9aa0a4")
_RED, _WHITE = rgb("c81e24"), rgb("f2f2f0")
_BLUE, _BLACK = rgb("1f5fae"), rgb("17181a")
_RADIUS_M = 0.42
_MIDDLE_M = 2.5  # above the ground
_SIDE_M = 0.8  # of the square sign
_LIFT_M = 0.006
_SIDES = 20

# Bars of a digit: top, upper left and right, middle, lower left and right, bottom.
_BARS = {
    "0": "1110111", "1": "0010010", "2": "1011101", "3": "1011011", "4": "0111010",
    "5": "1101011", "6": "1101111", "7": "1010010", "8": "1111111", "9": "1111011",
}  # fmt: skip


def _post(x: float = 0.05) -> Mesh:
    return tube((x, 0, 0), (x, 0, _MIDDLE_M + 0.3), 0.035, 0.035, _SIGN_POLE, 6)


def _panel(y0: float, y1: float, z0: float, z1: float, lift: int, colour: Colour) -> Mesh:
    """A rectangle that faces along -x; ``lift`` says what lies over what."""
    x = -_LIFT_M * lift
    return quad((x, y1, z0), (x, y0, z0), (x, y0, z1), (x, y1, z1), colour)


def _disc(
    radius_m: float, lift: int, colour: Colour, sides: int = _SIDES, first_rad: float = 0.0
) -> Mesh:
    """A regular polygon, with a corner at first_rad from its right hand side."""
    angles = 2.0 * np.pi * np.arange(sides) / sides + first_rad
    outline: list[Vec] = [
        (-_LIFT_M * lift, -radius_m * math.cos(a), _MIDDLE_M + radius_m * math.sin(a))
        for a in angles
    ]
    return fan(outline, colour)


def _bars(marks: str, left_m: float, width_m: float, height_m: float, colour: Colour) -> list[Mesh]:
    """Seven bars, those that are on; y falls from left to right for who looks along x."""
    bar = 0.24 * width_m
    y0, y1 = left_m - width_m, left_m
    low, high = _MIDDLE_M - height_m / 2, _MIDDLE_M + height_m / 2
    middle = _MIDDLE_M
    places = (
        (y0, y1, high - bar, high),
        (y1 - bar, y1, middle, high),
        (y0, y0 + bar, middle, high),
        (y0, y1, middle - bar / 2, middle + bar / 2),
        (y1 - bar, y1, low, middle),
        (y0, y0 + bar, low, middle),
        (y0, y1, low, low + bar),
    )
    return [_panel(*place, 3, colour) for place, on in zip(places, marks, strict=True) if on == "1"]


def speed_limit_sign(kmh: int) -> Mesh:
    """A round sign with a red border and a number."""
    text = str(kmh)
    width, gap, height = 0.19, 0.07, 0.36
    if len(text) > 2:
        width, gap, height = 0.13, 0.05, 0.3
    total = len(text) * width + (len(text) - 1) * gap
    digits: list[Mesh] = []
    for i, one in enumerate(text):
        digits += _bars(_BARS[one], total / 2 - i * (width + gap), width, height, _BLACK)
    back = triangles(_disc(_RADIUS_M, -1, _BACK).corners[:, ::-1], _BACK)
    return join(
        [_post(), back, _disc(_RADIUS_M, 1, _RED), _disc(0.78 * _RADIUS_M, 2, _WHITE), *digits]
    )


def _plate(radius_m: float, sides: int, first_rad: float, rims: tuple[Colour, ...]) -> Mesh:
    """A polygon on a post, of rings of colour from outside to inside, with a grey back."""
    front = [
        _disc(radius_m * (1.0 - 0.16 * k), k + 1, colour, sides, first_rad)
        for k, colour in enumerate(rims)
    ]
    back = _disc(radius_m, -1, _BACK, sides, first_rad)
    return join([_post(), triangles(back.corners[:, ::-1], _BACK), *front])


def stop_sign() -> Mesh:
    """A red octagon with a white border and the word."""
    plate = _plate(0.48, 8, math.pi / 8, (_WHITE, _RED))
    width, gap, high = 0.12, 0.045, 0.13
    bar = 0.3 * width
    letters: list[Mesh] = []
    # Bars as of digits; the T's upright stands in its middle.
    for i, on in enumerate(("1101011", "1000000", "1110111", "1111100")):
        left = 2 * width + 1.5 * gap - i * (width + gap)
        letters += _bars(on, left, width, 2 * high, _WHITE)
        if i == 1:
            middle = left - width / 2
            letters.append(
                _panel(middle - bar / 2, middle + bar / 2, _MIDDLE_M - high, _MIDDLE_M + high, 3,
                       _WHITE)
            )  # fmt: skip
    return join([plate, *letters])


def give_way_sign() -> Mesh:
    """A triangle that stands on its point, white with a red border."""
    plate = _plate(0.5, 3, -math.pi / 2, (_RED,))
    return join([plate, _disc(0.32, 2, _WHITE, 3, -math.pi / 2)])


def plain_sign() -> Mesh:
    """A plate that says nothing: of a sign that is none of the others."""
    return _plate(0.45, 4, math.pi / 4, (_BLACK, _WHITE))


def sign_of(sign: Sign) -> Mesh:
    """The mesh of a map's sign."""
    if sign.kind == "speed_limit" and sign.value is not None:
        return speed_limit_sign(sign.value)
    made = {"crossing": crossing_sign, "stop": stop_sign, "yield": give_way_sign}
    return made.get(sign.kind, plain_sign)()


def crossing_sign() -> Mesh:
    """A blue square with a white triangle and somebody who walks in it."""
    h, z = _SIDE_M / 2, _MIDDLE_M
    x = -2 * _LIFT_M
    triangle = triangles([(x, 0.34, z - 0.29), (x, -0.34, z - 0.29), (x, 0.0, z + 0.31)], _WHITE)

    def limb(a: tuple[float, float], b: tuple[float, float], wide: float) -> Mesh:
        away = np.subtract(b, a)
        across = wide / 2 * np.array([-away[1], away[0]]) / np.linalg.norm(away)
        corners = (np.add(a, across), np.subtract(a, across), np.subtract(b, across),
                   np.add(b, across))  # fmt: skip
        p, q, r, t = ((-3 * _LIFT_M, float(y), float(z + up)) for y, up in corners)
        # Whichever way round: both sides of so thin a thing are drawn.
        return join([quad(p, q, r, t, _BLACK), quad(t, r, q, p, _BLACK)])

    figure = [
        limb((0.0, 0.1), (0.0, -0.06), 0.075),
        limb((0.0, -0.05), (0.11, -0.27), 0.05),
        limb((0.0, -0.05), (-0.11, -0.27), 0.05),
        limb((0.0, 0.06), (0.12, -0.04), 0.035),
        limb((0.0, 0.06), (-0.12, -0.04), 0.035),
        limb((0.0, 0.19), (0.0, 0.11), 0.075),
    ]
    plate = box((0.0, 0.012), (-h, h), (z - h, z + h), _BACK)
    return join([_post(), plate, _panel(-h, h, z - h, z + h, 1, _BLUE), triangle, *figure])
