"""Light on meshes: sun, sky from above, reflected light from below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssp_core.geometry import Pose2
from ssp_ot_controller.camera.kernels.jit import Array, compiled
from ssp_ot_controller.camera.kernels.palettes import Colour, Palette
from ssp_ot_controller.camera.kernels.raster import CORNER_ATTRIBUTES, Triangles
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP
from ssp_ot_controller.camera.meshes.mesh import Mesh

_CONTACT_M = 0.5  # bodies get darker towards the ground over this height
_CONTACT_LIGHT = 0.6
_ORIGIN = Pose2(0.0, 0.0, 0.0)


class _Place(NamedTuple):
    """Where a mesh stands and the light there; lights are factors per channel."""

    sun: tuple[float, float, float]
    sun_light: Colour
    sky_light: Colour
    ground_light: Colour
    horizon: Colour
    x_m: float
    y_m: float
    z_m: float
    c: float
    s: float
    floor_m: float  # NaN: the mesh doesn't get darker towards it


@compiled
def _light_corners(
    corners: Array, normals: Array, colours: Array, uv: Array, at: _Place, lit: Triangles
) -> None:
    """Moves a mesh's corners to their place and puts their colours and uv into ``lit``."""
    c, s = at.c, at.s
    for n in range(corners.shape[0]):
        kind = lit.kinds[n]
        for i in range(3):
            x, y = corners[n, i, 0], corners[n, i, 1]
            z = corners[n, i, 2] + at.z_m
            lit.corners[n, i, 0] = c * x - s * y + at.x_m
            lit.corners[n, i, 1] = s * x + c * y + at.y_m
            lit.corners[n, i, 2] = z
            nx, ny, up = normals[n, i, 0], normals[n, i, 1], normals[n, i, 2]
            east, north = c * nx - s * ny, s * nx + c * ny
            toward = max(0.0, east * at.sun[0] + north * at.sun[1] + up * at.sun[2])
            contact = 1.0
            if not math.isnan(at.floor_m):
                height = min(1.0, max(0.0, (z - at.floor_m) / _CONTACT_M))
                contact = _CONTACT_LIGHT + (1.0 - _CONTACT_LIGHT) * height
            sky = max(0.0, up)
            gleam = 0.0
            if kind == GLOSSY:
                gleam = 0.16 * sky * sky
            elif kind == GLASS:
                gleam = 0.07 + 0.30 * sky
            share = 0.5 + 0.5 * up
            for k in range(3):
                light = share * at.sky_light[k]
                light = contact * (light + (1.0 - share) * at.ground_light[k])
                light += toward * at.sun_light[k]
                colour = colours[n, i, k]
                if kind != LAMP:
                    colour = colour * light + gleam * at.horizon[k]
                lit.attributes[n, i, k] = colour
            lit.attributes[n, i, 3], lit.attributes[n, i, 4] = uv[n, i, 0], uv[n, i, 1]


def lit(
    mesh: Mesh,
    palette: Palette,
    sun: tuple[float, float, float],
    pose: Pose2 = _ORIGIN,
    floor_m: float | None = None,
) -> Triangles:
    """A mesh in its place under the palette's light.

    Args:
        mesh: in the frame of its object.
        palette: gives the light.
        sun: unit vector towards the sun, block frame.
        pose: the object's, in the block's frame.
        floor_m: height of the ground that the object stands on, and gets darker towards; None
            for a mesh that has its heights already.
    """
    at = _Place(
        sun, palette.sun_light, palette.sky_light, palette.ground_light, palette.sky_horizon,
        float(pose.x_m), float(pose.y_m), floor_m or 0.0, math.cos(pose.yaw_rad),
        math.sin(pose.yaw_rad), math.nan if floor_m is None else floor_m,
    )  # fmt: skip
    placed = Triangles(
        np.empty(mesh.corners.shape, np.float32),
        np.empty((len(mesh), 3, CORNER_ATTRIBUTES), np.float32),
        mesh.kinds,
    )
    _light_corners(mesh.corners, mesh.normals, mesh.colours, mesh.uv, at, placed)
    return placed


def shadow_on_ground(corners: Array, sun: tuple[float, float, float], ground_m: float) -> Array:
    """Triangles moved along the sun's rays onto a horizontal plane, a centimetre above it."""
    flat = np.array(corners, dtype=np.float32)
    height = np.maximum(flat[..., 2] - ground_m, 0.0)
    flat[..., 0] -= height * (sun[0] / sun[2])
    flat[..., 1] -= height * (sun[1] / sun[2])
    flat[..., 2] = ground_m
    return flat


def gather(parts: Sequence[Triangles]) -> Triangles:
    """All triangles of several bodies, in their order."""
    return Triangles(*(np.concatenate(part) for part in zip(*parts, strict=True)))
