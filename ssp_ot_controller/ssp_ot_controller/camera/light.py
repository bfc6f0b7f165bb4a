"""Light on meshes: sun, sky from above, reflected light from below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.mesh import Mesh
from ssp_ot_controller.camera.palettes import Palette
from ssp_ot_controller.camera.surfaces import GLASS, GLOSSY, LAMP

_CONTACT_M = 0.5  # bodies get darker towards the ground over this height
_CONTACT_LIGHT = 0.6


@dataclass(frozen=True)
class Lit:
    """Triangles in the block's frame that know their final colours.

    Args:
        corners: shape (n, 3, 3), m.
        attributes: shape (n, 3, 5): blue, green, red, u, v; see raster.
        kinds: shape (n,).
    """

    corners: Array
    attributes: Array
    kinds: Array


def lit(
    mesh: Mesh, palette: Palette, sun: tuple[float, float, float], ground_m: float | None = None
) -> Lit:
    """Colours of a mesh under the palette's light.

    Args:
        mesh: in the block's frame.
        palette: gives the light.
        sun: unit vector towards the sun, block frame.
        ground_m: height of the ground that the body stands on; None for no darkening there.
    """
    up = mesh.normals[..., 2]
    toward = np.maximum(mesh.normals @ np.asarray(sun, dtype=np.float32), 0.0)
    share = (0.5 + 0.5 * up)[..., None]
    ambient = share * np.asarray(palette.sky_light, np.float32)
    ambient = ambient + (1.0 - share) * np.asarray(palette.ground_light, np.float32)
    if ground_m is not None:
        height = np.clip((mesh.corners[..., 2] - ground_m) / _CONTACT_M, 0.0, 1.0)
        ambient = ambient * (_CONTACT_LIGHT + (1.0 - _CONTACT_LIGHT) * height)[..., None]
    light = ambient + toward[..., None] * np.asarray(palette.sun_light, np.float32)
    colours = mesh.colours * light
    horizon = np.asarray(palette.sky_horizon, np.float32)
    sky = np.maximum(up, 0.0)[..., None]
    glossy, glass, lamp = (mesh.kinds == kind for kind in (GLOSSY, GLASS, LAMP))
    colours[glossy] += 0.16 * (sky[glossy] ** 2) * horizon
    colours[glass] += (0.07 + 0.30 * sky[glass]) * horizon
    colours[lamp] = mesh.colours[lamp]
    attributes = np.concatenate([colours, mesh.uv], axis=2, dtype=np.float32)
    return Lit(mesh.corners, attributes, mesh.kinds)


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
