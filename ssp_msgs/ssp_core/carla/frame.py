"""Places in CARLA's frame: left-handed, y to the south, m and degrees, yaw clockwise, pitch up."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, Pose2
from ssp_core.motion.state import Size
from ssp_core.run_file.model import Camera

# Height of the ground in m at x, y of frame map.
Ground = Callable[[float, float], float]


@dataclass(frozen=True, slots=True)
class CarlaPose:
    """Location and rotation as CARLA has them."""

    x_m: float
    y_m: float
    z_m: float
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    roll_deg: float = 0.0

    @property
    def rotation(self) -> FloatArray:
        """Shape (3, 3): columns are the axes forward, right and up in the world."""
        cp, sp = _cos_sin(self.pitch_deg)
        cy, sy = _cos_sin(self.yaw_deg)
        cr, sr = _cos_sin(self.roll_deg)
        return np.array(
            [
                [cp * cy, cy * sp * sr - sy * cr, -cy * sp * cr - sy * sr],
                [cp * sy, sy * sp * sr + cy * cr, -sy * sp * cr + cy * sr],
                [sp, -cp * sr, cp * cr],
            ]
        )


@dataclass(frozen=True, slots=True)
class BodyBox:
    """The box that a server measures around an actor's body.

    Args:
        length_m, width_m, height_m: whole sizes, not halves.
        forward_m, right_m, up_m: middle of the box from the actor's origin.
    """

    length_m: float
    width_m: float
    height_m: float
    forward_m: float = 0.0
    right_m: float = 0.0
    up_m: float = 0.0


def _cos_sin(angle_deg: float) -> tuple[float, float]:
    return math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))


def yaw_in_carla_deg(yaw_rad: float) -> float:
    """Return the yaw in (-180, 180], clockwise, of one that turns counter-clockwise."""
    yaw = math.remainder(-math.degrees(yaw_rad), 360.0) + 0.0
    return 180.0 if yaw <= -180.0 else yaw


def flat_ground(_x_m: float, _y_m: float) -> float:
    """Return the height 0 everywhere."""
    return 0.0


def vehicle_pose(pose: Pose2, size: Size, box: BodyBox, ground: Ground) -> CarlaPose:
    """Place a vehicle so that the middle of CARLA's box lies over the middle of ours.

    Args:
        pose: of our reference point, frame map.
        size: ours.
        box: CARLA's, as measured.
        ground: height of the ground at x, y of frame map.

    Returns:
        The actor's origin, on the ground; pitch by the ground below both ends of our box.
    """
    forward_m = 0.5 * (size.front_m - size.rear_m) - box.forward_m
    rear_z = ground(*pose.to_parent(-size.rear_m, 0.0))
    front_z = ground(*pose.to_parent(size.front_m, 0.0))
    rise = (front_z - rear_z) / size.length_m
    x, y = pose.to_parent(forward_m, box.right_m)
    z = rear_z + rise * (size.rear_m + forward_m)
    pitch_deg = math.degrees(math.atan(rise))
    return CarlaPose(x, -y, z, pitch_deg, yaw_in_carla_deg(pose.yaw_rad))


def feet_pose(pose: Pose2, ground: Ground) -> CarlaPose:
    """Place a pedestrian's feet, which is what CARLA's walker state takes."""
    x, y = pose.x_m, pose.y_m
    return CarlaPose(x, -y, ground(x, y), 0.0, yaw_in_carla_deg(pose.yaw_rad))


def camera_pose(pose: Pose2, size: Size, camera: Camera, ground: Ground) -> CarlaPose:
    """Place a camera that a vehicle carries.

    Args:
        pose: of the vehicle's reference point, frame map.
        size: of the vehicle, for the slope that it stands on.
        camera: pitch down, yaw left and roll right are CARLA's pitch and yaw with the sign changed,
            and its roll.
        ground: height of the ground at x, y of frame map.
    """
    base = vehicle_pose(pose, size, BodyBox(size.length_m, size.width_m, size.height_m), ground)
    # The reference point, on the line between the ground at both ends.
    z = base.z_m - math.tan(math.radians(base.pitch_deg)) * 0.5 * (size.front_m - size.rear_m)
    base_turn = base.rotation
    shift = base_turn @ np.array([camera.forward_m, -camera.left_m, camera.height_m])
    mount = CarlaPose(
        0.0,
        0.0,
        0.0,
        -math.degrees(camera.pitch_down_rad),
        -math.degrees(camera.yaw_left_rad),
        math.degrees(camera.roll_right_rad),
    )
    turn = base_turn @ mount.rotation
    return CarlaPose(
        pose.x_m + float(shift[0]),
        -pose.y_m + float(shift[1]),
        z + float(shift[2]),
        math.degrees(math.asin(max(-1.0, min(1.0, float(turn[2, 0]))))),
        math.degrees(math.atan2(turn[1, 0], turn[0, 0])),
        math.degrees(math.atan2(-turn[2, 1], turn[2, 2])),
    )
