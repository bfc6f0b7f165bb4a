"""Where the camera sits on the VUT, as the mount topic states it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.names import VUT_ID
from ssp_core.run_spec import Camera

Quaternion = tuple[float, float, float, float]

OPTICAL_FRAME = f"{VUT_ID}/front_camera_optical"
BASE_FRAME = f"{VUT_ID}/base_link"


@dataclass(frozen=True, slots=True)
class Mount:
    """Transform from the VUT's base_link to the optical frame: position and orientation there."""

    translation_m: tuple[float, float, float]
    quaternion_xyzw: Quaternion


def mount(camera: Camera) -> Mount:
    """The transform that a camera's mounting means.

    The rotation is the one that turns base_link's axes into the optical ones: the mounting's yaw,
    then yaw by -90 degrees and roll by -90 degrees (REP-103), then the pitch about the optical x
    axis and the roll about the optical z axis.
    """
    # (x, y, z, w) = (-1/2, 1/2, -1/2, 1/2) turns x forward, z up into z forward, y down; the
    # pitch down multiplies from the right with (-sin(half), 0, 0, cos(half)).
    half = camera.pitch_down_rad / 2
    c, s = math.cos(half) / 2, math.sin(half) / 2
    pitched = (-c - s, c + s, s - c, c - s)
    half = camera.yaw_left_rad / 2
    turned = _product((0.0, 0.0, math.sin(half), math.cos(half)), pitched)
    half = camera.roll_right_rad / 2
    return Mount(
        (camera.forward_m, camera.left_m, camera.height_m),
        _product(turned, (0.0, 0.0, math.sin(half), math.cos(half))),
    )


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation that turns by b and then by a, (x, y, z, w)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
