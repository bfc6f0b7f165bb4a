"""CARLA's RGB camera and weather for a run: what is asked of the server, in its own words."""

from __future__ import annotations

import math

from ssp_core.run_file.model import Camera, Look

CAMERA_BLUEPRINT = "sensor.camera.rgb"
INSTANCES_BLUEPRINT = "sensor.camera.instance_segmentation"
# Written out, so that no default decides: nothing that depends on earlier pictures or the lens.
_PLAIN = {
    "sensor_tick": "0.0",
    "motion_blur_intensity": "0.0",
    "motion_blur_max_distortion": "0.0",
    "lens_flare_intensity": "0.0",
    "bloom_intensity": "0.0",
    "chromatic_aberration_intensity": "0.0",
    "lens_circle_multiplier": "0.0",
    "lens_k": "0.0",
    "lens_kcube": "0.0",
    "enable_postprocess_effects": "true",
}
_CLEAR_SKY_PERCENT, _RAIN_CLOUDS_PERCENT = 10.0, 80.0
_DUSK_ALTITUDE_DEG = 3.0
# Fog as CARLA's percent: how much of the light is lost over this distance.
_FOG_OVER_M = 100.0


def camera_attributes(camera: Camera) -> dict[str, str]:
    """Return the attributes of CARLA's camera that a run's camera asks for.

    All others stay as they are.

    The field of view is horizontal in both, so that the focal length in pixels is the same.
    """
    return {
        "image_size_x": str(camera.width_px),
        "image_size_y": str(camera.height_px),
        "fov": f"{camera.hfov_deg:g}",
        **_PLAIN,
    }


def weather_of(look: Look) -> dict[str, float]:
    """Return the sun, fog and rain of a run as fields of carla.WeatherParameters.

    The azimuth turns as CARLA's yaw.
    """
    rain = look.rain
    dusk = look.light == "dusk"
    return {
        "cloudiness": round(_CLEAR_SKY_PERCENT + _RAIN_CLOUDS_PERCENT * rain, 6),
        "precipitation": round(100.0 * rain, 6),
        "precipitation_deposits": round(50.0 * rain, 6),
        "wetness": round(100.0 * rain, 6),
        "wind_intensity": 5.0,
        "fog_distance": 0.0,
        "fog_density": round(100.0 * -math.expm1(-look.fog_per_m * _FOG_OVER_M), 6),
        "sun_azimuth_angle": round(-look.sun_azimuth_deg % 360.0, 6),
        "sun_altitude_angle": min(look.sun_elevation_deg, _DUSK_ALTITUDE_DEG)
        if dusk
        else look.sun_elevation_deg,
    }


def instance_attributes(camera: Camera) -> dict[str, str]:
    """Return the attributes of a camera that gives each actor a colour of its own."""
    attributes = camera_attributes(camera)
    return {
        name: attributes[name] for name in ("image_size_x", "image_size_y", "fov", "sensor_tick")
    }
