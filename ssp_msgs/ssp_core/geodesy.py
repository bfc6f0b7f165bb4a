"""The place of a site on the Earth: geodetic places to the site's metres, and back.

The site's plane stands on the normal of the WGS 84 ellipsoid at the datum: x east, y north, z up,
before it is turned by its yaw. The conversion is exact but for rounding, below a micrometre within
100 km. What isn't flat is the ground: at a distance d its height in the plane falls by d²/2R (8 cm
at 1 km, 2 m at 5 km), and a length along it appears shorter by d³/6R² (4 µm and 0.5 mm).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ssp_core.geometry import FloatArray, Pose2, wrap_angle

# WGS 84: semi-major axis, m, and the first eccentricity's square.
_A_M = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_E2 = _FLATTENING * (2.0 - _FLATTENING)
# Each step of the latitude's iteration leaves less than 0.7 % of the error.
_STEPS = 8


@dataclass(frozen=True, slots=True)
class Place:
    """A geodetic place on WGS 84.

    Args:
        latitude_deg: north is positive.
        longitude_deg: east is positive.
        altitude_m: above the ellipsoid, not above the sea.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0

    @property
    def problem(self) -> str | None:
        """Say what keeps its numbers from being a place on the Earth, with the remedy.

        None: nothing.

        NaN is no place either.
        """
        sides = (
            ("latitude", self.latitude_deg, 90),
            ("longitude", self.longitude_deg, 180),
        )
        for name, value, most in sides:
            if not abs(value) <= most:
                return f"{name} {value:g} must be from -{most} to {most}; give decimal degrees"
        return None


@dataclass(frozen=True)
class Datum:
    """The origin of a site's map frame.

    Args:
        place: of the origin.
        yaw_rad: of the site's x axis, counter-clockwise from east; 0 for a frame that is ENU.
    """

    place: Place
    yaw_rad: float = 0.0

    @cached_property
    def _axes(self) -> FloatArray:
        """East, north and up, Earth-centred; a row each."""
        latitude = math.radians(self.place.latitude_deg)
        longitude = math.radians(self.place.longitude_deg)
        sin_b, cos_b = math.sin(latitude), math.cos(latitude)
        sin_l, cos_l = math.sin(longitude), math.cos(longitude)
        rows = [
            (-sin_l, cos_l, 0.0),
            (-sin_b * cos_l, -sin_b * sin_l, cos_b),
            (cos_b * cos_l, cos_b * sin_l, sin_b),
        ]
        return np.array(rows)

    @cached_property
    def _origin(self) -> FloatArray:
        return _earth_centred(
            self.place.latitude_deg, self.place.longitude_deg, self.place.altitude_m
        )

    @cached_property
    def _site(self) -> Pose2:
        return Pose2(0.0, 0.0, self.yaw_rad)

    def to_site(self, place: Place) -> tuple[float, float, float]:
        """Return x, y, z of a place in the site's frame, m."""
        x, y, z = self.all_to_site(
            np.array([place.latitude_deg]),
            np.array([place.longitude_deg]),
            np.array([place.altitude_m]),
        )
        return float(x[0]), float(y[0]), float(z[0])

    def all_to_site(
        self, latitude_deg: FloatArray, longitude_deg: FloatArray, altitude_m: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Convert as ``to_site`` for many places: arrays of shape (n,), each."""
        apart = _earth_centred(latitude_deg, longitude_deg, altitude_m) - self._origin[:, None]
        east, north, up = self._axes @ apart
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return c * east + s * north, c * north - s * east, up

    def to_place(self, x_m: float, y_m: float, z_m: float = 0.0) -> Place:
        """Return the place of a point in the site's frame: the inverse of ``to_site``."""
        x, y, z = self._origin + np.array([*self._site.to_parent(x_m, y_m), z_m]) @ self._axes
        return _geodetic(float(x), float(y), float(z))

    def to_enu(self, pose: Pose2) -> Pose2:
        """Return a pose of the site's frame in the frame that isn't turned: ENU at the datum."""
        return Pose2(
            *self._site.to_parent(pose.x_m, pose.y_m), wrap_angle(pose.yaw_rad + self.yaw_rad)
        )

    def of_enu(self, pose: Pose2) -> Pose2:
        """Return a pose of ENU at the datum in the site's frame: the inverse of ``to_enu``."""
        return Pose2(
            *self._site.to_local(pose.x_m, pose.y_m), wrap_angle(pose.yaw_rad - self.yaw_rad)
        )


def _earth_centred(
    latitude_deg: FloatArray | float,
    longitude_deg: FloatArray | float,
    altitude_m: FloatArray | float,
) -> FloatArray:
    """Return x, y, z of places in rows, earth-centred, m."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    sin_b = np.sin(latitude)
    normal_m = _A_M / np.sqrt(1.0 - _E2 * sin_b * sin_b)
    across_m = (normal_m + altitude_m) * np.cos(latitude)
    up_m = (normal_m * (1.0 - _E2) + altitude_m) * sin_b
    return np.array([across_m * np.cos(longitude), across_m * np.sin(longitude), up_m])


def _geodetic(x_m: float, y_m: float, z_m: float) -> Place:
    across_m = math.hypot(x_m, y_m)
    latitude = math.atan2(z_m, across_m * (1.0 - _E2))
    for _ in range(_STEPS):
        sin_b = math.sin(latitude)
        normal_m = _A_M / math.sqrt(1.0 - _E2 * sin_b * sin_b)
        latitude = math.atan2(z_m + _E2 * normal_m * sin_b, across_m)
    sin_b = math.sin(latitude)
    altitude_m = across_m * math.cos(latitude) + z_m * sin_b
    altitude_m -= _A_M * math.sqrt(1.0 - _E2 * sin_b * sin_b)
    return Place(math.degrees(latitude), math.degrees(math.atan2(y_m, x_m)), altitude_m)
