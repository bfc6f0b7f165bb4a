"""Meshes of what stands beside a road: trees, lamps, houses, hedges, cones, fences."""

from __future__ import annotations

import numpy as np

from ssp_core.geometry import Pose2
from ssp_ot_controller.camera.mesh import (
    Colour,
    Mesh,
    box,
    ellipsoid,
    join,
    quad,
    triangles,
    tube,
)
from ssp_ot_controller.camera.palettes import Palette, rgb
from ssp_ot_controller.camera.surfaces import FACADE, FOLIAGE, LAMP, MATTE

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


def building(
    rng: np.random.Generator,
    palette: Palette,
    width_m: float,
    depth_m: float,
    floors: int,
    pitched: bool,
) -> Mesh:
    """A house or block with windows all around; x along the road, centred on the origin."""
    return _house(rng, palette, width_m, depth_m, 3.1 * floors, pitched)


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
        mesh = _house(rng, palette, longer, shorter, walls_m, pitched=True)
    else:
        rim_m = min(_PARAPET_M, 0.5 * height_m)
        mesh = _house(rng, palette, longer, shorter, height_m - rim_m, pitched=False, rim_m=rim_m)
    return mesh if length_m >= width_m else mesh.placed(Pose2(0.0, 0.0, np.pi / 2))


def _house(
    rng: np.random.Generator,
    palette: Palette,
    width_m: float,
    depth_m: float,
    top: float,
    pitched: bool,
    rim_m: float = _PARAPET_M,
) -> Mesh:
    """Walls of the given height with a roof on top; a flat one is as high as its rim."""
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
