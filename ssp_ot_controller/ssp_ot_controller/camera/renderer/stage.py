"""Light on meshes, and everything of a run that is the same in every frame, built once and kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ssp_core.geometry import Pose2
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


def lighted(
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
    bodies = lighted(join([p.mesh for p in props]), palette, sun)
    shadows = [np.zeros((0, 3, 3), np.float32)]
    for prop in props:
        if prop.casts_shadow:
            floor = float(prop.mesh.corners[..., 2].min())
            shadows.append(shadow_on_ground(prop.mesh.corners, sun, floor))
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
