"""A camera's geometry from its messages, however they were decoded."""

from __future__ import annotations

from typing import Any

from ssp_core.world.camera import Mounting
from ssp_vla_bridge.core.request import CameraGeometry


def mounting_of(transform: Any) -> Mounting:
    """Where a camera is mounted, of a geometry_msgs/Transform."""
    move, turn = transform.translation, transform.rotation
    return Mounting.of_transform(
        (float(move.x), float(move.y), float(move.z)),
        (float(turn.x), float(turn.y), float(turn.z), float(turn.w)),
    )


def geometry_of(info: Any, mount: Mounting | None) -> CameraGeometry | None:
    """The geometry of a sensor_msgs/CameraInfo; None where its matrix K says that it is unknown.

    Args:
        info: with ``k``, ``width`` and ``height``.
        mount: None where it isn't known.
    """
    if float(info.k[0]) <= 0.0 or float(info.k[4]) <= 0.0:
        return None
    return CameraGeometry(
        fx_px=float(info.k[0]),
        fy_px=float(info.k[4]),
        cx_px=float(info.k[2]),
        cy_px=float(info.k[5]),
        width_px=int(info.width),
        height_px=int(info.height),
        height_m=mount.height_m if mount is not None else None,
        pitch_down_rad=mount.pitch_down_rad if mount is not None else None,
    )
