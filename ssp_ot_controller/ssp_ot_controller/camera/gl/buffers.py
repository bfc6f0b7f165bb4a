"""What the driver is given of a frame: vertices, runs of scenery, and the sun's point of view."""

from __future__ import annotations

import math

import numpy as np

from ssp_core.camera import View
from ssp_ot_controller.camera import light
from ssp_ot_controller.camera.jit import Array
from ssp_ot_controller.camera.mesh import Mesh
from ssp_ot_controller.camera.raster_frame import visible
from ssp_ot_controller.camera.stage import Stage

BODY_LAYOUT = "3f 3f 3f 2f 1f"
BODY_NAMES = ("place", "lit", "shade", "uv", "kind")
BODY_NUMBERS = 12
SHADOW_TEXELS = 2048
_SHADOW_AHEAD_M, _SHADOW_HALF_M, _SHADOW_DEPTH_M = 42.0, 55.0, 160.0


def vertices(mesh: Mesh, lit: light.Lit, shade: light.Lit) -> Array:
    """Corners as the programs want them, shape (3 n, 12), float32: with and without the sun."""
    n = len(mesh)
    out = np.empty((n, 3, BODY_NUMBERS), np.float32)
    out[..., 0:3] = lit.corners
    out[..., 3:6] = lit.attributes[..., :3]
    out[..., 6:9] = shade.attributes[..., :3]
    out[..., 9:11] = lit.attributes[..., 3:5]
    out[..., 11] = lit.kinds[:, None]
    return out.reshape(-1, BODY_NUMBERS)


def runs(
    stage: Stage, view: View, range_m: float, *, casting: bool = False
) -> list[tuple[int, int]]:
    """First vertex and number of vertices of the scenery in sight, neighbours joined."""
    static = stage.static
    kept = np.sort(visible(static.places, view, range_m))
    if casting:
        kept = kept[np.diff(static.shadow_ranges[kept]).ravel() > 0]
    found: list[tuple[int, int]] = []
    for first, end in static.body_ranges[kept]:
        if found and sum(found[-1]) == 3 * first:
            found[-1] = (found[-1][0], int(3 * end) - found[-1][0])
        else:
            found.append((int(3 * first), int(3 * (end - first))))
    return found


def sun_view_of(sun: tuple[float, float, float], view: View) -> Array:
    """Shape (4, 4): from the block's frame to the shadow map, a box ahead of the camera."""
    toward = np.array(sun)
    side = np.cross([0.0, 0.0, 1.0] if toward[2] < 0.99 else [1.0, 0.0, 0.0], toward)
    side /= np.linalg.norm(side)
    up = np.cross(toward, side)
    ahead = view.rotation[2, :2] / np.linalg.norm(view.rotation[2, :2])
    middle = np.array([*(view.position_m[:2] + _SHADOW_AHEAD_M * ahead), 0.0])
    # Whole texels, so that edges of shadows don't crawl as the camera moves.
    texel = 2.0 * _SHADOW_HALF_M / SHADOW_TEXELS
    matrix = np.eye(4)
    for row, (axis, half) in enumerate(
        ((side, _SHADOW_HALF_M), (up, _SHADOW_HALF_M), (-toward, _SHADOW_DEPTH_M))
    ):
        at = axis @ middle
        if row < 2:
            at = math.floor(at / texel) * texel
        matrix[row, :3], matrix[row, 3] = axis / half, -at / half
    return matrix
