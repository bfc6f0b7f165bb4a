"""Triangle meshes: the few solids that vehicles, people and scenery are built from.

A mesh lives in the frame of its object: x forward, y left, z up, metres. Colours are albedos,
blue, green, red, 0-255.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ssp_core.geometry import Pose2
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.kernels.shading import MATTE

Colour = tuple[float, float, float]
Vec = tuple[float, float, float]


@dataclass(frozen=True)
class Mesh:
    """n triangles.

    Args:
        corners: shape (n, 3, 3), m.
        normals: shape (n, 3, 3), unit, per corner.
        colours: shape (n, 3, 3), per corner.
        uv: shape (n, 3, 2), surface coordinates in m.
        kinds: shape (n,), surface kinds.
    """

    corners: Array
    normals: Array
    colours: Array
    uv: Array
    kinds: Array

    def __len__(self) -> int:
        return len(self.corners)

    def placed(self, pose: Pose2) -> Mesh:
        """Return the mesh in the pose's parent frame."""
        c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]], dtype=np.float32)
        shift = np.array([pose.x_m, pose.y_m, 0.0], dtype=np.float32)
        corners = (self.corners.reshape(-1, 3) @ turn + shift).reshape(self.corners.shape)
        normals = (self.normals.reshape(-1, 3) @ turn).reshape(self.normals.shape)
        return Mesh(corners, normals, self.colours, self.uv, self.kinds)

    def scaled(self, by: float) -> Mesh:
        """Return the mesh that many times as large; its surface pattern keeps its size."""
        return Mesh(self.corners * np.float32(by), self.normals, self.colours, self.uv, self.kinds)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """Return all triangles in one mesh."""
    parts = list(meshes)
    if not parts:
        none = np.zeros((0, 3, 3), dtype=np.float32)
        return Mesh(none, none, none, np.zeros((0, 3, 2), np.float32), np.zeros(0, np.uint8))
    arrays = ("corners", "normals", "colours", "uv", "kinds")
    return Mesh(*(np.concatenate([getattr(part, name) for part in parts]) for name in arrays))


def _cross(a: Array, b: Array) -> Array:
    """Return cross products of the last axis; ten times as fast as numpy's for a few rows."""
    ax, ay, az, bx, by, bz = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    product = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    product[..., 0] = ay * bz - az * by
    product[..., 1] = az * bx - ax * bz
    product[..., 2] = ax * by - ay * bx
    return product


def _length(a: Array) -> Array:
    """Return the lengths along the last axis, which stays."""
    return np.asarray(np.sqrt((a * a).sum(axis=-1, keepdims=True)))


def _flat_normals(corners: Array) -> Array:
    """Return the normal of each triangle at its three corners, shape (n, 3, 3), float32."""
    points = corners.astype(np.float32)
    flat = _cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    flat /= np.maximum(_length(flat), 1e-12)
    return np.repeat(flat[:, None, :], 3, axis=1)


def triangles(
    corners: ArrayLike,
    colour: Colour,
    kind: int = MATTE,
    normals: ArrayLike | None = None,
    uv: ArrayLike | None = None,
) -> Mesh:
    """Return a mesh of one colour; without normals its triangles are flat.

    They are seen counter-clockwise in front.
    """
    points = np.asarray(corners, dtype=np.float32).reshape(-1, 3, 3)
    if normals is None:
        directions = _flat_normals(points)
    else:
        directions = np.asarray(normals, dtype=np.float32).reshape(-1, 3, 3)
    n = len(points)
    if uv is None:
        plane = np.zeros((n, 3, 2), dtype=np.float32)
    else:
        plane = np.asarray(uv, dtype=np.float32).reshape(-1, 3, 2)
    colours = np.broadcast_to(np.asarray(colour, dtype=np.float32), (n, 3, 3))
    return Mesh(
        points,
        directions,
        np.ascontiguousarray(colours),
        plane,
        np.full(n, kind, dtype=np.uint8),
    )


def quad(
    a: Vec,
    b: Vec,
    c: Vec,
    d: Vec,
    colour: Colour,
    kind: int = MATTE,
    uv: Sequence[tuple[float, float]] | None = None,
) -> Mesh:
    """Return a flat quadrilateral, counter-clockwise as seen from outside."""
    plane = None if uv is None else [uv[0], uv[1], uv[2], uv[0], uv[2], uv[3]]
    return triangles([a, b, c, a, c, d], colour, kind, uv=plane)


def hexahedron(low: Sequence[Vec], high: Sequence[Vec], colour: Colour, kind: int = MATTE) -> Mesh:
    """Return a solid between two quadrilaterals, each counter-clockwise as seen from above."""
    faces = [(high[0], high[1], high[2], high[3]), (low[3], low[2], low[1], low[0])]
    for i in range(4):
        j = (i + 1) % 4
        faces.append((low[i], low[j], high[j], high[i]))
    return triangles([(a, b, c, a, c, d) for a, b, c, d in faces], colour, kind)


def _rectangle(x0: float, x1: float, y0: float, y1: float, z: float) -> list[Vec]:
    return [(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]


def box(
    x: tuple[float, float],
    y: tuple[float, float],
    z: tuple[float, float],
    colour: Colour,
    kind: int = MATTE,
) -> Mesh:
    """Return a box between the given limits along x, y and z."""
    return hexahedron(_rectangle(*x, *y, z[0]), _rectangle(*x, *y, z[1]), colour, kind)


def loft(sections: ArrayLike, colour: Colour, kind: int = MATTE) -> Mesh:
    """Return a smooth skin over closed outlines of equally many points, with flat ends.

    Args:
        sections: shape (m, k, 3); outlines counter-clockwise as seen from the last section
            towards the first.
        colour: of the whole skin.
        kind: how the surface is shaded, such as MATTE.
    """
    rings = np.asarray(sections, dtype=np.float64)
    m, k, _ = rings.shape
    after, before = (np.arange(k) + 1) % k, np.arange(k) - 1
    normals = _cross(rings[:, after] - rings[:, before], np.gradient(rings, axis=0))
    normals /= np.maximum(_length(normals), 1e-12)
    index = _skin(m - 1, k)[:, [0, 1, 2, 0, 2, 3]].reshape(-1)
    at = (index // k, index % k)
    ends = np.concatenate([_fan(rings[0][::-1]), _fan(rings[-1])])
    corners = np.concatenate([rings[at].reshape(-1, 3, 3), ends])
    facing = np.concatenate([normals[at].reshape(-1, 3, 3), _flat_normals(ends)])
    return triangles(corners, colour, kind, facing)


@lru_cache(maxsize=64)
def _skin(bands: int, sides: int) -> Array:
    """Return the corners of the quadrilaterals between closed outlines, as numbers of points.

    Shape (bands * sides, 4): a point, the next on its outline, those two on the next outline in
    the opposite order.
    """
    i, j = (part.ravel() for part in np.indices((bands, sides)))
    after = (j + 1) % sides
    corners = [i * sides + j, i * sides + after, (i + 1) * sides + after, (i + 1) * sides + j]
    return np.stack(corners, axis=1)


def _fan(points: Array) -> Array:
    """Return corners of triangles around the middle of a polygon, shape (k, 3, 3)."""
    middle = np.broadcast_to(points.mean(axis=0), points.shape)
    following = np.concatenate([points[1:], points[:1]])
    return np.stack([middle, points, following], axis=1)


def fan(outline: ArrayLike, colour: Colour, kind: int = MATTE) -> Mesh:
    """Return a flat convex polygon, shape (k, 3), counter-clockwise as seen from outside."""
    return triangles(_fan(np.asarray(outline, dtype=np.float64)), colour, kind)


def _perpendicular(axis: Array) -> tuple[Array, Array]:
    helper = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    side = _cross(axis, helper)
    side /= _length(side)
    return side, _cross(axis, side)


def tube(
    start: Vec,
    end: Vec,
    start_radius_m: float,
    end_radius_m: float,
    colour: Colour,
    sides: int = 8,
    kind: int = MATTE,
) -> Mesh:
    """Return a round bar, cone or disc between two points, with flat ends."""
    p, q = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(q - p))
    axis = (q - p) / length
    side, other = _perpendicular(axis)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    circle = np.cos(angles)[:, None] * side + np.sin(angles)[:, None] * other
    return loft([p + start_radius_m * circle, q + end_radius_m * circle], colour, kind)


@lru_cache(maxsize=16)
def _sphere(rings: int, sides: int) -> Array:
    """Return points of a unit sphere, shape (rings + 1, sides, 3), from the top down."""
    polar = np.pi * np.arange(rings + 1)[:, None] / rings
    angles = 2.0 * np.pi * np.arange(sides)[None, :] / sides
    parts = (np.sin(polar) * np.cos(angles), np.sin(polar) * np.sin(angles), np.cos(polar))
    return np.stack(np.broadcast_arrays(*parts), axis=2)


def ellipsoid(
    centre: Vec,
    radii: Vec,
    colour: Colour,
    rings: int = 6,
    sides: int = 10,
    kind: int = MATTE,
    ripple: Array | None = None,
) -> Mesh:
    """Return a rounded body; ``ripple``, shape (rings + 1, sides), scales its radius."""
    unit = _sphere(rings, sides)
    scale = np.ones((rings + 1, sides)) if ripple is None else ripple
    points = np.asarray(centre) + unit * scale[:, :, None] * np.asarray(radii)
    outward = unit / np.asarray(radii)
    outward /= _length(outward)
    index = _skin(rings, sides)[:, [0, 3, 2, 0, 2, 1]].reshape(-1)
    at = (index // sides, index % sides)
    plane = np.stack([points[..., 0] + points[..., 1], points[..., 2]], axis=2)
    return triangles(points[at], colour, kind, outward[at], plane[at])


def ring(
    centre: Vec,
    radius_m: float,
    thickness_m: float,
    width_m: float,
    colour: Colour,
    sides: int = 18,
) -> Mesh:
    """Return an upright tyre whose axle lies along y: both faces and the tread."""
    angles = 2.0 * np.pi * np.arange(sides + 1) / sides
    direction = np.stack([np.cos(angles), np.zeros(sides + 1), np.sin(angles)], axis=1)
    half = np.array([0.0, width_m / 2, 0.0])
    outer = np.asarray(centre) + direction * radius_m
    inner = np.asarray(centre) + direction * (radius_m - thickness_m)
    bands = (
        (outer + half, inner + half),
        (inner - half, outer - half),
        (outer - half, outer + half),
    )
    return join(
        triangles(np.stack([a[:-1], b[:-1], b[1:], a[:-1], b[1:], a[1:]], axis=1), colour)
        for a, b in bands
    )
