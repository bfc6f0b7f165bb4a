"""Colours and light of the three palettes, and what weather and time of day make of them.

Day without rain is the palette itself. Colours of the ground are shown as they stand in the
palette, so dusk darkens them; bodies get darker with the lights.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from ssp_core.run_file.model import Look

Colour = tuple[float, float, float]
CentreLine = Literal["double", "solid"]


def rgb(code: str) -> Colour:
    """Return a text ``rrggbb`` as blue, green, red, 0-255."""
    return float(int(code[4:6], 16)), float(int(code[2:4], 16)), float(int(code[0:2], 16))


def _colours(codes: str) -> tuple[Colour, ...]:
    return tuple(rgb(code) for code in codes.split())


@dataclass(frozen=True)
class Palette:
    """Colours are blue, green, red, 0-255; lights are factors of an albedo, per channel."""

    sky_zenith: Colour
    sky_horizon: Colour
    sun_glow: Colour
    cloud: Colour
    cloud_cover: float
    fog: Colour
    skyline: Colour
    skyline_height: float  # tangent of the elevation that it reaches
    sun_light: Colour
    sky_light: Colour
    ground_light: Colour
    shadow: Colour  # factor on sunlit ground
    asphalt: Colour
    asphalt_texture: float
    marking: Colour
    centre_marking: Colour
    centre_line: CentreLine
    sidewalk: Colour
    kerb: Colour
    verge: Colour
    verge_texture: float
    paints: tuple[Colour, ...]  # of cars
    clothes: tuple[Colour, ...]
    trousers: tuple[Colour, ...]
    walls: tuple[Colour, ...]
    roofs: tuple[Colour, ...]
    foliage: tuple[Colour, ...]
    window_glass: Colour
    window_lit: Colour
    window_lit_share: float
    lamps_on: bool


_SUBURB = Palette(
    sky_zenith=rgb("4a86c8"),
    sky_horizon=rgb("cfe0ec"),
    sun_glow=rgb("fff3d0"),
    cloud=rgb("f6f8fa"),
    cloud_cover=0.42,
    fog=rgb("c3d3de"),
    skyline=rgb("5d7a63"),
    skyline_height=0.035,
    sun_light=(0.62, 0.70, 0.74),
    sky_light=(0.64, 0.58, 0.54),
    ground_light=(0.36, 0.38, 0.38),
    shadow=(0.58, 0.52, 0.49),
    asphalt=rgb("73757a"),
    asphalt_texture=9.0,
    marking=rgb("e6e7e4"),
    centre_marking=rgb("dfb53c"),
    centre_line="double",
    sidewalk=rgb("aeaaa2"),
    kerb=rgb("c4c2bc"),
    verge=rgb("6e8f45"),
    verge_texture=22.0,
    paints=_colours("b3261e e8e8e6 1f4e9c 8d9299 2f6b4a d9a520 3a3d42"),
    clothes=_colours("c8372d 2c62b0 e2b93b 4b9a5b d97a2c"),
    trousers=_colours("2b3550 3c3c3f 6b5a45 20242c"),
    walls=_colours("d8c9ae c98f6b e4e0d6 b7bfae a35d4a"),
    roofs=_colours("7d4033 55504d 8a6048"),
    foliage=_colours("4f7a34 5f8a3c 41682f 6f8f3f"),
    window_glass=rgb("4f6272"),
    window_lit=rgb("ffe9b0"),
    window_lit_share=0.0,
    lamps_on=False,
)

_PROVING_GROUND = Palette(
    sky_zenith=rgb("7f93a6"),
    sky_horizon=rgb("d5d9da"),
    sun_glow=rgb("fbf7ea"),
    cloud=rgb("e4e7e8"),
    cloud_cover=0.75,
    fog=rgb("ced3d5"),
    skyline=rgb("7f8a86"),
    skyline_height=0.028,
    sun_light=(0.50, 0.52, 0.53),
    sky_light=(0.66, 0.63, 0.61),
    ground_light=(0.40, 0.41, 0.41),
    shadow=(0.68, 0.64, 0.62),
    asphalt=rgb("58595b"),
    asphalt_texture=5.0,
    marking=rgb("f2f2ee"),
    centre_marking=rgb("f2f2ee"),
    centre_line="solid",
    sidewalk=rgb("b9b9b4"),
    kerb=rgb("cbcbc6"),
    verge=rgb("a39a63"),
    verge_texture=16.0,
    paints=_colours("e9ebec d5641c 9aa0a6 24487f b12a25 c9c32b"),
    clothes=_colours("e07b1f 2f6fb5 b8352f d8d23a"),
    trousers=_colours("22262e 3a4256 4a4640"),
    walls=_colours("c9cdd0 9fb0bd d7d2c3"),
    roofs=_colours("7c858c 6a5f58"),
    foliage=_colours("5f7443 6f7c48 54673f"),
    window_glass=rgb("5a6872"),
    window_lit=rgb("fff0c8"),
    window_lit_share=0.0,
    lamps_on=False,
)

_DUSK_CITY = Palette(
    sky_zenith=rgb("283a66"),
    sky_horizon=rgb("e8a36e"),
    sun_glow=rgb("ffb45e"),
    cloud=rgb("b0787f"),
    cloud_cover=0.5,
    fog=rgb("a98a86"),
    skyline=rgb("3c4058"),
    skyline_height=0.10,
    sun_light=(0.26, 0.40, 0.54),
    sky_light=(0.72, 0.62, 0.60),
    ground_light=(0.42, 0.38, 0.38),
    shadow=(0.80, 0.72, 0.66),
    asphalt=rgb("4b4a52"),
    asphalt_texture=7.0,
    marking=rgb("cfc8c2"),
    centre_marking=rgb("cfc8c2"),
    centre_line="double",
    sidewalk=rgb("77727a"),
    kerb=rgb("8f8a8e"),
    verge=rgb("5c5a60"),
    verge_texture=6.0,
    paints=_colours("d8d6d4 c43a2a 2a6aa8 c7922a 7f868e 3f8a6a"),
    clothes=_colours("d34a3a 3f86c9 e6c24a d9d4cf 8a4fa0"),
    trousers=_colours("2a3048 55504c 34383f"),
    walls=_colours("5f5853 6a5042 525964 776a5b 474d57"),
    roofs=_colours("3a3a40 45403f"),
    foliage=_colours("3a4a33 45523a"),
    window_glass=rgb("2b3344"),
    window_lit=rgb("ffd27a"),
    window_lit_share=0.36,
    lamps_on=True,
)

PALETTES: dict[str, Palette] = {
    "suburb": _SUBURB,
    "proving_ground": _PROVING_GROUND,
    "dusk_city": _DUSK_CITY,
}


_GREY_SKY = rgb("9aa3aa")
_DUSK_ZENITH, _DUSK_HORIZON = rgb("22305a"), rgb("b07a6a")
_DUSK_CLOUD, _DUSK_FOG, _DUSK_SKYLINE = rgb("54506a"), rgb("6a606c"), rgb("262a38")
_DUSK_GLOW = rgb("d98a5a")
_DUSK_GROUND = 0.42  # light that the ground keeps
_DUSK_SKY, _DUSK_SUN = 0.5, 0.06  # light of sky and sun on bodies
_DUSK_WINDOWS = 0.3
RAIN_FOG_PER_M = 0.006  # in a downpour


def _mix(a: Colour, b: Colour, share: float) -> Colour:
    blue, green, red = ((1.0 - share) * p + share * q for p, q in zip(a, b, strict=True))
    return blue, green, red


def _times(a: Colour, factor: float | Colour) -> Colour:
    by = (factor,) * 3 if isinstance(factor, float) else factor
    blue, green, red = (p * q for p, q in zip(a, by, strict=True))
    return blue, green, red


def fog_per_m(look: Look) -> float:
    """Return the extinction with what the rain adds, 1/m."""
    return look.fog_per_m + RAIN_FOG_PER_M * look.rain


def _rainy(palette: Palette, rain: float) -> Palette:
    overcast = min(1.0, 2.0 * rain)
    sky = _mix(palette.sky_horizon, _GREY_SKY, 0.7)
    return replace(
        palette,
        sky_zenith=_mix(palette.sky_zenith, _times(sky, 0.85), overcast),
        sky_horizon=_mix(palette.sky_horizon, sky, overcast),
        sun_glow=_mix(palette.sun_glow, sky, overcast),
        cloud=_mix(palette.cloud, _times(sky, 0.75), overcast),
        cloud_cover=palette.cloud_cover + overcast * (0.8 - palette.cloud_cover),
        fog=_mix(palette.fog, sky, overcast),
        sun_light=_times(palette.sun_light, 1.0 - 0.85 * overcast),
        sky_light=_times(palette.sky_light, 1.0 + 0.12 * overcast),
        shadow=_mix(palette.shadow, (1.0, 1.0, 1.0), 0.85 * overcast),
        asphalt=_times(palette.asphalt, 1.0 - 0.45 * rain**0.5),
        sidewalk=_times(palette.sidewalk, 1.0 - 0.35 * rain**0.5),
        kerb=_times(palette.kerb, 1.0 - 0.3 * rain**0.5),
        verge=_times(palette.verge, 1.0 - 0.25 * rain**0.5),
        marking=_times(palette.marking, 1.0 - 0.22 * rain**0.5),
        centre_marking=_times(palette.centre_marking, 1.0 - 0.22 * rain**0.5),
    )


def _dusky(palette: Palette) -> Palette:
    return replace(
        palette,
        sky_zenith=_mix(_times(palette.sky_zenith, 0.25), _DUSK_ZENITH, 0.7),
        sky_horizon=_mix(_times(palette.sky_horizon, 0.4), _DUSK_HORIZON, 0.7),
        sun_glow=_DUSK_GLOW,
        cloud=_mix(_times(palette.cloud, 0.3), _DUSK_CLOUD, 0.7),
        fog=_mix(_times(palette.fog, 0.3), _DUSK_FOG, 0.6),
        skyline=_mix(_times(palette.skyline, 0.25), _DUSK_SKYLINE, 0.6),
        sun_light=_times(palette.sun_light, _DUSK_SUN),
        sky_light=_times(palette.sky_light, _DUSK_SKY),
        ground_light=_times(palette.ground_light, _DUSK_SKY),
        shadow=(0.97, 0.97, 0.97),
        asphalt=_times(palette.asphalt, _DUSK_GROUND),
        asphalt_texture=palette.asphalt_texture * _DUSK_GROUND,
        marking=_times(palette.marking, _DUSK_GROUND),
        centre_marking=_times(palette.centre_marking, _DUSK_GROUND),
        sidewalk=_times(palette.sidewalk, _DUSK_GROUND),
        kerb=_times(palette.kerb, _DUSK_GROUND),
        verge=_times(palette.verge, _DUSK_GROUND),
        verge_texture=palette.verge_texture * _DUSK_GROUND,
        window_glass=_times(palette.window_glass, 0.35),
        window_lit=rgb("ffd27a"),
        window_lit_share=max(palette.window_lit_share, _DUSK_WINDOWS),
        lamps_on=True,
    )


def palette_of(look: Look) -> Palette:
    """Return the palette of a look in its weather and light."""
    palette = PALETTES[look.palette]
    if look.rain > 0.0:
        palette = replace(_rainy(palette, look.rain), lamps_on=True)
    return _dusky(palette) if look.light == "dusk" else palette
