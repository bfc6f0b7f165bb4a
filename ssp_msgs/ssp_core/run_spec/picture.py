"""What the VUT's forward camera is, and what the surroundings look like."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from ssp_core.run_spec.values import Finite, NonNegative, Positive, Strict, without


class Camera(Strict):
    """Forward camera: pinhole without distortion, mounted on the VUT."""

    width_px: Annotated[int, Field(ge=64, le=4096)] = 960
    height_px: Annotated[int, Field(ge=64, le=4096)] = 540
    hfov_deg: Annotated[float, Field(gt=10, lt=150)] = 75.0
    rate_hz: Annotated[float, Field(gt=0, le=60)] = 10.0
    forward_m: Finite = Field(1.8, description="ahead of the VUT's reference point")
    left_m: Finite = Field(0.0, description="to the left of the VUT's middle")
    height_m: Positive = 1.45
    pitch_down_rad: Finite = 0.03
    yaw_left_rad: Finite = 0.0
    roll_right_rad: Finite = 0.0
    exposure_time_s: NonNegative = Field(0.0, description="motion blur; 0: none")
    renderer: Annotated[
        Literal["raster"], BeforeValidator(without("gl", "the renderer", "raster"))
    ] = Field("raster", description="numba, the same pixels everywhere")
    jpeg_quality: Annotated[int, Field(ge=10, le=100)] = 90

    @property
    def focal_px(self) -> float:
        return self.width_px / 2 / math.tan(math.radians(self.hfov_deg) / 2)


class Look(Strict):
    """What the surroundings look like. Nothing here changes what happens."""

    palette: Literal["suburb", "proving_ground", "dusk_city"] = "suburb"
    fog_per_m: NonNegative = 0.002
    rain: Annotated[float, Field(ge=0, le=1)] = Field(0.0, description="0 none, 1 a downpour")
    light: Literal["day", "dusk"] = "day"
    sun_azimuth_deg: Finite = 50.0
    sun_elevation_deg: Annotated[float, Field(gt=5, le=90)] = 40.0
    exposure: Positive = 1.0
    noise_sigma: NonNegative = 1.5
