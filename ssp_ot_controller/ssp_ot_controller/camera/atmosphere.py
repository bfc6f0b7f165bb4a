"""What weather and time of day make of a palette: light, sky, fog, wet ground.

Day without rain is the palette itself. Colours of the ground are shown as they stand in the
palette, so dusk darkens them; bodies get darker with the lights.
"""

from __future__ import annotations

from dataclasses import replace

from ssp_core.run_file.model import Look
from ssp_ot_controller.camera.palettes import PALETTES, Colour, Palette, rgb

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
    """Extinction with what the rain adds, 1/m."""
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
    """The palette of a look in its weather and light."""
    palette = PALETTES[look.palette]
    if look.rain > 0.0:
        palette = replace(_rainy(palette, look.rain), lamps_on=True)
    return _dusky(palette) if look.light == "dusk" else palette
