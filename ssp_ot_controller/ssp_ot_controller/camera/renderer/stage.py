"""Everything of a run that doesn't change from frame to frame, built once and kept."""

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
from ssp_ot_controller.camera.kernels.jit import Array
from ssp_ot_controller.camera.kernels.palettes import Palette, fog_per_m, palette_of
from ssp_ot_controller.camera.kernels.raster import Triangles
from ssp_ot_controller.camera.kernels.shading import Style, make_noise
from ssp_ot_controller.camera.meshes.mesh import join
from ssp_ot_controller.camera.renderer import light, scenery
from ssp_ot_controller.camera.renderer.scenery import Prop


@dataclass(frozen=True)
class Detail:
    """What the surroundings hold beside the road itself; tests turn it off."""

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
    sun: tuple[float, float, float]
    around: Surroundings
    static: Static


def ranges(lengths: Sequence[int]) -> Array:
    """Shape (n, 2): first and end of consecutive runs of the given lengths."""
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


def _static(props: Sequence[Prop], palette: Palette, sun: tuple[float, float, float]) -> Static:
    bodies = light.lit(join([p.mesh for p in props]), palette, sun)
    shadows = [np.zeros((0, 3, 3), np.float32)]
    for prop in props:
        if prop.casts_shadow:
            floor = float(prop.mesh.corners[..., 2].min())
            shadows.append(light.shadow_on_ground(prop.mesh.corners, sun, floor))
    return Static(
        bodies,
        np.concatenate(shadows),
        np.array([(p.x_m, p.y_m, p.radius_m) for p in props]).reshape(-1, 3),
        ranges([len(p.mesh) for p in props]),
        ranges([len(p.mesh) if p.casts_shadow else 0 for p in props]),
    )


def stage_for(road: Road, look: Look, seed: int, detail: Detail = FULL) -> Stage:
    """The stage of a road, a look and a seed; built when it is first asked for."""
    return _build(road.model_dump_json(), look.model_dump_json(), seed, detail)
