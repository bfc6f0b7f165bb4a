"""Light on meshes, and everything of a run that is the same in every frame, built once and kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssp_core.run_file.model import Look
from ssp_core.run_file.road import Road
from ssp_ot_controller.camera.kernels import ground, sky
from ssp_ot_controller.camera.kernels.bend import build_bend
from ssp_ot_controller.camera.kernels.compose import Surroundings
from ssp_ot_controller.camera.kernels.jit import Array, compiled
from ssp_ot_controller.camera.kernels.palettes import Colour, Palette, fog_per_m, palette_of
from ssp_ot_controller.camera.kernels.raster import CORNER_ATTRIBUTES, Triangles
from ssp_ot_controller.camera.kernels.shading import GLASS, GLOSSY, LAMP, Style, make_noise
from ssp_ot_controller.camera.meshes.mesh import Mesh, join
from ssp_ot_controller.camera.renderer import scenery
from ssp_ot_controller.camera.renderer.scenery import Prop

Sun = tuple[float, float, float]  # unit vector towards it, block frame
_CONTACT_M, _CONTACT_LIGHT = 0.5, 0.6  # bodies get darker towards the ground over this height


def lighted(mesh: Mesh, palette: Palette, sun: Sun, *, stands: bool) -> Triangles:
    """Return a mesh in the block's frame under the palette's light: sun, sky above, ground below.

    Args:
        mesh: in the block's frame.
        palette: gives the light of sun, sky and ground.
        sun: unit vector towards the sun, block frame.
        stands: it stands on the ground, and gets darker towards it.
    """
    attributes = np.empty((len(mesh), 3, CORNER_ATTRIBUTES), np.float32)
    lit = Triangles(mesh.corners, attributes, mesh.kinds)
    around = palette.sky_light, palette.ground_light, palette.sky_horizon
    _light(mesh.normals, mesh.colours, mesh.uv, sun, (palette.sun_light, *around), stands, lit)
    return lit


@compiled
def _light(
    normals: Array,
    colours: Array,
    uv: Array,
    sun: Sun,
    lights: tuple[Colour, ...],
    stands: bool,
    lit: Triangles,
) -> None:
    sun_light, sky_light, ground_light, horizon = lights
    for n in range(normals.shape[0]):
        kind = lit.kinds[n]
        for i in range(3):
            up = normals[n, i, 2]
            toward = normals[n, i, 0] * sun[0] + normals[n, i, 1] * sun[1] + up * sun[2]
            toward, sky, share = max(0.0, toward), max(0.0, up), 0.5 + 0.5 * up
            contact, gleam = 1.0, 0.0
            if stands:
                height = min(1.0, max(0.0, lit.corners[n, i, 2] / _CONTACT_M))
                contact = _CONTACT_LIGHT + (1.0 - _CONTACT_LIGHT) * height
            if kind == GLOSSY:
                gleam = 0.16 * sky * sky
            elif kind == GLASS:
                gleam = 0.07 + 0.30 * sky
            for k in range(3):
                around = contact * (share * sky_light[k] + (1.0 - share) * ground_light[k])
                colour = colours[n, i, k]
                if kind != LAMP:
                    colour = colour * (around + toward * sun_light[k]) + gleam * horizon[k]
                lit.attributes[n, i, k] = colour
            lit.attributes[n, i, 3], lit.attributes[n, i, 4] = uv[n, i, 0], uv[n, i, 1]


def shadow_on_ground(corners: Array, sun: Sun) -> Array:
    """Return triangles moved along the sun's rays onto the ground."""
    flat = np.array(corners, dtype=np.float32)
    height = np.maximum(flat[..., 2:], 0.0)
    flat[..., :2] -= height * np.array([sun[0] / sun[2], sun[1] / sun[2]], np.float32)
    flat[..., 2] = 0.0
    return flat


@dataclass(frozen=True)
class Detail:
    """The detail of the surroundings beside the road itself; tests turn it off."""

    scenery: bool = True
    texture: bool = True


FULL = Detail()


@dataclass(frozen=True)
class Static:
    """Scenery as one list of triangles in the block's frame, and where each prop's part lies.

    Args:
        bodies: the triangles with their colours.
        shadows: shape (m, 3, 3), their shadows on the ground.
        places: shape (props, 3): x, y, radius.
        body_ranges, shadow_ranges: shape (props, 2): first and end of a prop's triangles.
    """

    bodies: Triangles
    shadows: Array
    places: Array
    body_ranges: Array
    shadow_ranges: Array


@dataclass(frozen=True)
class Stage:
    """Everything of a run that doesn't change: built once, used for every frame."""

    palette: Palette
    sun: Sun
    around: Surroundings
    static: Static


def ranges(lengths: Sequence[int]) -> Array:
    """Return first and end of consecutive runs of the given lengths, shape (n, 2)."""
    ends = np.cumsum(np.asarray(lengths, dtype=np.int64))
    return np.stack([ends - np.asarray(lengths, dtype=np.int64), ends], axis=1)


@lru_cache(maxsize=4)
def _build(road_json: str, look_json: str, seed: int, detail: Detail) -> Stage:
    road, look = Road.model_validate_json(road_json), Look.model_validate_json(look_json)
    palette = palette_of(look)
    sun = sky.sun_direction(
        math.radians(look.sun_azimuth_deg) - road.origin.yaw_rad,
        math.radians(look.sun_elevation_deg),
    )
    outline = sky.build_outline(palette, look.palette, seed) if detail.scenery else np.full(8, 0.01)
    fog = float(fog_per_m(look))
    sky_light = sky.SkyLight(
        zenith=palette.sky_zenith,
        horizon=palette.sky_horizon,
        glow=palette.sun_glow,
        cloud=palette.cloud,
        outline=palette.skyline,
        lamp=palette.window_lit,
        fog=palette.fog,
        sun=sun,
        cloud_cover=palette.cloud_cover if detail.texture else 0.0,
        fog_per_m=fog,
        # Nobody lives in a row of trees.
        windows_lit=look.palette == "dusk_city" and palette.window_lit_share > 0.0,
    )
    noise = make_noise(seed)
    bend = build_bend(road)
    props = []
    if detail.scenery:
        props = scenery.build_scenery(road, bend, look.palette, palette, seed)
    around = Surroundings(
        ground=ground.build_ground(road, palette, detail.texture),
        bend=bend,
        panorama=sky.build_panorama(sky_light, outline, noise),
        noise=noise,
        style=Style(
            palette.fog, palette.window_glass, palette.window_lit, palette.window_lit_share
        ),
        shadow=palette.shadow,
        fog_per_m=fog,
    )
    return Stage(palette, sun, around, _static(props, palette, sun))


def _static(props: Sequence[Prop], palette: Palette, sun: Sun) -> Static:
    bodies = lighted(join([p.mesh for p in props]), palette, sun, stands=False)
    shadows = [np.zeros((0, 3, 3), np.float32)]
    shadows += [shadow_on_ground(p.mesh.corners, sun) for p in props if p.casts_shadow]
    return Static(
        bodies,
        np.concatenate(shadows),
        np.array([(p.x_m, p.y_m, p.radius_m) for p in props]).reshape(-1, 3),
        ranges([len(p.mesh) for p in props]),
        ranges([len(p.mesh) if p.casts_shadow else 0 for p in props]),
    )


def stage_for(road: Road, look: Look, seed: int, detail: Detail = FULL) -> Stage:
    """Return the stage of a road, a look and a seed; built when it is first asked for."""
    return _build(road.model_dump_json(), look.model_dump_json(), seed, detail)
