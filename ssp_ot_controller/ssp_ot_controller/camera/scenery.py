"""What stands beside the road: houses, trees, lamps, hedges, cones; placed by seed.

Everything stands outside carriageway and sidewalks. Poses are in the block's frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.run_spec import Road
from ssp_ot_controller.camera.jit import Array
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

BEFORE_M, BEYOND_M = 60.0, 260.0  # scenery starts this far before the block and ends beyond it
_CLEAR_AT_CROSSING_M = 7.0
_TRUNK = rgb("5a4635")
_POLE = rgb("6f7478")
_SOCKLE = rgb("807c76")


@dataclass(frozen=True)
class Prop:
    """One thing beside the road.

    Args:
        mesh: in the block's frame.
        x_m, y_m: its place.
        radius_m: it stays within this distance of its place.
        casts_shadow: whether its shadow on the ground is drawn.
    """

    mesh: Mesh
    x_m: float
    y_m: float
    radius_m: float
    casts_shadow: bool = True


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


def lamp_post(toward_road: float, palette: Palette) -> Mesh:
    """A street lamp of 7.5 m whose arm reaches towards the road (+1: to the left)."""
    shine = rgb("fff0c4") if palette.lamps_on else rgb("d9dcdd")
    arm = 1.6 * toward_road
    head, shade = (arm - 0.35, arm + 0.35), (arm - 0.3, arm + 0.3)
    return join(
        [
            tube((0, 0, 0), (0, 0, 7.3), 0.09, 0.06, _POLE, 7),
            tube((0, 0, 7.25), (0, arm, 7.5), 0.05, 0.045, _POLE, 6),
            box((-0.14, 0.14), head, (7.42, 7.55), _POLE),
            box((-0.11, 0.11), shade, (7.38, 7.42), shine,
                LAMP if palette.lamps_on else MATTE),
        ]
    )  # fmt: skip


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
    wall = palette.walls[int(rng.integers(len(palette.walls)))]
    roof = palette.roofs[int(rng.integers(len(palette.roofs)))]
    x, y, top = width_m / 2, depth_m / 2, 3.1 * floors
    # Window columns start at a whole period, so that facades begin and end with wall.
    corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
    parts = [_wall(corners[i], corners[(i + 1) % 4], 0.0, top, wall) for i in range(4)]
    parts.append(box((-x - 0.03, x + 0.03), (-y - 0.03, y + 0.03), (0.0, 0.5), _SOCKLE))
    if not pitched:
        parts.append(box((-x - 0.2, x + 0.2), (-y - 0.2, y + 0.2), (top, top + 0.5), roof))
        return join(parts)
    e, ridge = 0.5, top + 0.42 * depth_m
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


@dataclass(frozen=True)
class _Side:
    """One side of the road: + is left."""

    sign: float
    edge_m: float  # lateral position where the sidewalk ends
    raised: bool

    def y(self, distance_m: float) -> float:
        """Lateral position that far beyond the sidewalk."""
        return self.edge_m + self.sign * distance_m


class _Planter:
    """Collects props and keeps the crossing clear."""

    def __init__(self, road: Road, kerb_m: float) -> None:
        self.props: list[Prop] = []
        self._crossing = road.crossing_x_m
        self._kerb_m = kerb_m

    def add(
        self,
        mesh: Mesh,
        side: _Side,
        x_m: float,
        distance_m: float,
        yaw_rad: float = 0.0,
        casts_shadow: bool = True,
    ) -> None:
        y = side.y(distance_m)
        reach = float(np.abs(mesh.corners[..., :2]).max()) if len(mesh) else 0.0
        if self._crossing is not None and distance_m < 6.0:
            along = float(np.abs(mesh.corners[..., 0]).max())
            if abs(x_m - self._crossing) < _CLEAR_AT_CROSSING_M + along:
                return
        z = self._kerb_m if side.raised else 0.0
        placed = mesh.placed(Pose2(x_m, y, yaw_rad), z)
        self.props.append(Prop(placed, x_m, y, 1.5 * reach, casts_shadow))


def build_scenery(
    road: Road, palette_name: str, palette: Palette, kerb_m: float, seed: int
) -> list[Prop]:
    """Everything that stands beside the road, the same for the same seed."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 0x5CE11E]))
    planter = _Planter(road, kerb_m)
    sides = (
        _Side(1.0, road.left_edge_m + max(road.sidewalk_left_m, 1.0), road.sidewalk_left_m > 0),
        _Side(-1.0, road.right_edge_m - max(road.sidewalk_right_m, 1.0), road.sidewalk_right_m > 0),
    )
    span = (-BEFORE_M, road.length_m + BEYOND_M)
    plant = {"suburb": _suburb, "proving_ground": _proving_ground, "dusk_city": _city}[palette_name]
    for side in sides:
        plant(planter, side, span, rng, palette)
    return planter.props


def _stations(
    rng: np.random.Generator, span: tuple[float, float], low: float, high: float
) -> Array:
    """Places along the road whose distances are drawn between low and high."""
    count = int((span[1] - span[0]) / low) + 1
    x = span[0] + np.cumsum(rng.uniform(low, high, count))
    return np.asarray(x[x < span[1]])


def _suburb(
    planter: _Planter,
    side: _Side,
    span: tuple[float, float],
    rng: np.random.Generator,
    palette: Palette,
) -> None:
    for x in _stations(rng, span, 17.0, 24.0):
        house = building(
            rng, palette, rng.uniform(9, 13), rng.uniform(8, 10), int(rng.integers(1, 3)), True
        )
        planter.add(house, side, float(x), rng.uniform(12, 16), casts_shadow=False)
        planter.add(hedge(rng.uniform(8, 13), palette), side, float(x), 3.6)
    for x in _stations(rng, span, 9.0, 19.0):
        planter.add(
            tree(rng, palette, rng.uniform(0.75, 1.1)), side, float(x), rng.uniform(4.6, 8.0)
        )
    for x in _stations(rng, span, 26.0, 44.0):
        planter.add(conifer(rng, palette), side, float(x), rng.uniform(20, 26), casts_shadow=False)
    for x in np.arange(span[0] + (8.0 if side.sign > 0 else 24.0), span[1], 32.0):
        planter.add(lamp_post(-side.sign, palette), side, float(x), 0.4)


def _proving_ground(
    planter: _Planter,
    side: _Side,
    span: tuple[float, float],
    rng: np.random.Generator,
    palette: Palette,
) -> None:
    if side.sign > 0:
        for x in np.arange(span[0], span[1], 24.0):
            planter.add(fence(24.0), side, float(x), 6.5)
    for x in np.arange(span[0], span[1], 20.0):
        planter.add(cone(), side, float(x) + float(rng.uniform(-0.3, 0.3)), 1.2)
    for x in _stations(rng, span, 70.0, 110.0):
        hall = building(rng, palette, rng.uniform(28, 45), rng.uniform(14, 20), 2, False)
        planter.add(hall, side, float(x), rng.uniform(42, 62), casts_shadow=False)
    for x in np.arange(span[0] + 25.0, span[1], 60.0):
        mast = join(
            [
                tube((0, 0, 0), (0, 0, 12.0), 0.14, 0.09, _POLE, 8),
                box((-0.9, 0.9), (-0.15, 0.15), (11.7, 12.2), rgb("c9cdd0")),
            ]
        )
        planter.add(mast, side, float(x), 10.0)
    for x in _stations(rng, span, 12.0, 30.0):
        planter.add(
            tree(rng, palette, rng.uniform(0.7, 1.2)),
            side,
            float(x),
            rng.uniform(26, 40),
            casts_shadow=False,
        )


def _city(
    planter: _Planter,
    side: _Side,
    span: tuple[float, float],
    rng: np.random.Generator,
    palette: Palette,
) -> None:
    x = span[0]
    while x < span[1]:
        width = float(rng.uniform(14, 24))
        block = building(rng, palette, width, 14.0, int(rng.integers(4, 9)), False)
        planter.add(block, side, x + width / 2, 9.0, casts_shadow=False)
        x += width + (float(rng.uniform(3, 9)) if rng.uniform() < 0.3 else 0.0)
    for x in np.arange(span[0] + (5.0 if side.sign > 0 else 17.0), span[1], 24.0):
        planter.add(lamp_post(-side.sign, palette), side, float(x), 0.4)
    for x in np.arange(span[0] + (14.0 if side.sign > 0 else 26.0), span[1], 24.0):
        if rng.uniform() < 0.6:
            planter.add(tree(rng, palette, rng.uniform(0.55, 0.7)), side, float(x), 1.3)
