"""Light on meshes: sun, sky from above, reflected light from below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import Pose2
from ssp_ot_controller.camera.kernels.jit import Array, compiled
from ssp_ot_controller.camera.kernels.palettes import Palette
from ssp_ot_controller.camera.kernels.raster import CORNER_ATTRIBUTES
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP
from ssp_ot_controller.camera.meshes.mesh import Mesh

_CONTACT_M = 0.5  # bodies get darker towards the ground over this height
_CONTACT_LIGHT = 0.6
_ORIGIN = Pose2(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Lit:
    """Triangles in the block's frame that know their final colours.

    Args:
        corners: shape (n, 3, 3), m.
        attributes: shape (n, 3, 5): blue, green, red, u, v; see raster.
    """

    corners: Array
    attributes: Array
    kinds: Array


# Layout of the vector of numbers that the kernel wants; lights are factors per channel.
(L_SUN, L_SUN_LIGHT, L_SKY_LIGHT, L_GROUND_LIGHT, L_HORIZON, L_SHIFT) = range(0, 18, 3)
L_COS, L_SIN, L_FLOOR = 18, 19, 20
_NUMBERS = 21


@compiled
def _light_corners(
    corners: Array,
    normals: Array,
    colours: Array,
    uv: Array,
    kinds: Array,
    numbers: Array,
    placed: Array,
    attributes: Array,
) -> None:
    """Moves a mesh's corners to ``placed`` and puts their colours and uv into ``attributes``."""
    c, s = numbers[L_COS], numbers[L_SIN]
    for n in range(corners.shape[0]):
        kind = kinds[n]
        for i in range(3):
            x, y = corners[n, i, 0], corners[n, i, 1]
            z = corners[n, i, 2] + numbers[L_SHIFT + 2]
            placed[n, i, 0] = c * x - s * y + numbers[L_SHIFT]
            placed[n, i, 1] = s * x + c * y + numbers[L_SHIFT + 1]
            placed[n, i, 2] = z
            nx, ny, up = normals[n, i, 0], normals[n, i, 1], normals[n, i, 2]
            east, north = c * nx - s * ny, s * nx + c * ny
            toward = east * numbers[L_SUN] + north * numbers[L_SUN + 1] + up * numbers[L_SUN + 2]
            toward = max(0.0, toward)
            contact = 1.0
            if not math.isnan(numbers[L_FLOOR]):
                height = min(1.0, max(0.0, (z - numbers[L_FLOOR]) / _CONTACT_M))
                contact = _CONTACT_LIGHT + (1.0 - _CONTACT_LIGHT) * height
            sky = max(0.0, up)
            gleam = 0.0
            if kind == GLOSSY:
                gleam = 0.16 * sky * sky
            elif kind == GLASS:
                gleam = 0.07 + 0.30 * sky
            share = 0.5 + 0.5 * up
            for k in range(3):
                light = share * numbers[L_SKY_LIGHT + k]
                light = contact * (light + (1.0 - share) * numbers[L_GROUND_LIGHT + k])
                light += toward * numbers[L_SUN_LIGHT + k]
                colour = colours[n, i, k]
                if kind != LAMP:
                    colour = colour * light + gleam * numbers[L_HORIZON + k]
                attributes[n, i, k] = colour
            attributes[n, i, 3], attributes[n, i, 4] = uv[n, i, 0], uv[n, i, 1]


def lit(
    mesh: Mesh,
    palette: Palette,
    sun: tuple[float, float, float],
    pose: Pose2 = _ORIGIN,
    floor_m: float | None = None,
) -> Lit:
    """A mesh in its place under the palette's light.

    Args:
        sun: unit vector towards the sun, block frame.
        pose: the object's, in the block's frame.
        floor_m: height of the ground that the object stands on, and gets darker towards; None
            for a mesh that has its heights already.
    """
    numbers = np.empty(_NUMBERS)
    lights = (sun, palette.sun_light, palette.sky_light, palette.ground_light, palette.sky_horizon)
    numbers[:L_SHIFT] = np.ravel(lights)
    numbers[L_SHIFT : L_SHIFT + 3] = pose.x_m, pose.y_m, floor_m or 0.0
    numbers[L_COS], numbers[L_SIN] = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    numbers[L_FLOOR] = math.nan if floor_m is None else floor_m
    placed = np.empty(mesh.corners.shape, np.float32)
    attributes = np.empty((len(mesh), 3, CORNER_ATTRIBUTES), np.float32)
    _light_corners(
        mesh.corners, mesh.normals, mesh.colours, mesh.uv, mesh.kinds, numbers, placed, attributes
    )
    return Lit(placed, attributes, mesh.kinds)


def shadow_on_ground(corners: Array, sun: tuple[float, float, float], ground_m: float) -> Array:
    """Triangles moved along the sun's rays onto a horizontal plane, a centimetre above it."""
    flat = np.array(corners, dtype=np.float32)
    height = np.maximum(flat[..., 2] - ground_m, 0.0)
    flat[..., 0] -= height * (sun[0] / sun[2])
    flat[..., 1] -= height * (sun[1] / sun[2])
    flat[..., 2] = ground_m
    return flat


def gather(parts: Sequence[Lit]) -> Lit:
    """All triangles of several bodies, in their order."""
    return Lit(
        np.concatenate([p.corners for p in parts]),
        np.concatenate([p.attributes for p in parts]),
        np.concatenate([p.kinds for p in parts]),
    )
