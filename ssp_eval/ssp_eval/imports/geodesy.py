"""Geodetic positions in the local frame of a datum: east, north, on WGS 84."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray

_A_M = 6378137.0
_F = 1 / 298.257223563
_E2 = _F * (2 - _F)


@dataclass(frozen=True)
class Datum:
    """Origin of a local frame: degrees, and metres above the ellipsoid."""

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0


def local(
    datum: Datum, latitude_deg: FloatArray, longitude_deg: FloatArray, altitude_m: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """East and north of a datum, m, in the plane that touches the ellipsoid there."""
    origin = _earth_fixed(
        np.array([datum.latitude_deg]),
        np.array([datum.longitude_deg]),
        np.array([datum.altitude_m]),
    )
    away = _earth_fixed(latitude_deg, longitude_deg, altitude_m) - origin
    lat, lon = np.radians(datum.latitude_deg), np.radians(datum.longitude_deg)
    east = np.array([-np.sin(lon), np.cos(lon), 0.0])
    north = np.array([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)])
    return away @ east, away @ north


def _earth_fixed(
    latitude_deg: FloatArray, longitude_deg: FloatArray, altitude_m: FloatArray
) -> FloatArray:
    """Earth-centred, earth-fixed coordinates, shape (n, 3), m."""
    lat, lon = np.radians(latitude_deg), np.radians(longitude_deg)
    normal = _A_M / np.sqrt(1 - _E2 * np.sin(lat) ** 2)
    return np.column_stack(
        [
            (normal + altitude_m) * np.cos(lat) * np.cos(lon),
            (normal + altitude_m) * np.cos(lat) * np.sin(lon),
            (normal * (1 - _E2) + altitude_m) * np.sin(lat),
        ]
    )
