"""From frame map (ENU, right-handed, rad) to CARLA's frame (left-handed, degrees)."""

from __future__ import annotations

import math

from ssp_core.geometry import Pose2
from ssp_core.motion.state import Size
from ssp_core.run_file.model import Camera
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Point
from ssp_scenario_manager.compile.export.carla_config import Location, Rotation, Transform

# Room below a body that appears, so that it doesn't stick in the ground.
_VEHICLE_ABOVE_M = 0.3
_WALKER_ABOVE_M = 0.1
# A file's numbers: a tenth of a micrometre, and less than that on the horizon.
_DIGITS = 7


def _number(value: float) -> float:
    """Rounded, without a negative zero."""
    return round(value, _DIGITS) + 0.0


def location(point: Point, z_m: float = 0.0) -> Location:
    """A place of frame map: y changes its sign."""
    return Location(x=_number(point[0]), y=_number(-point[1]), z=_number(z_m))


def transform(pose: Pose2, z_m: float = 0.0) -> Transform:
    """A pose of frame map: y and yaw change their signs, yaw is in (-180, 180]."""
    yaw = _number(math.remainder(-math.degrees(pose.yaw_rad), 360.0))
    return Transform(
        location=location((pose.x_m, pose.y_m), z_m),
        rotation=Rotation(pitch=0.0, yaw=180.0 if yaw <= -180.0 else yaw, roll=0.0),
    )


def body_middle_m(size: Size) -> float:
    """From the reference point forward to the middle of the body: CARLA's origin."""
    return 0.5 * (size.front_m - size.rear_m)


def spawn(who: ParticipantSpec, ground_m: float) -> Transform:
    """Where CARLA is to put a participant: middle of the body, somewhat above the ground."""
    start = who.start.pose
    middle = start.to_parent(body_middle_m(who.size), 0.0)
    walks = who.object_class == "pedestrian"
    above = who.size.height_m / 2 + _WALKER_ABOVE_M if walks else _VEHICLE_ABOVE_M
    return transform(Pose2(*middle, start.yaw_rad), ground_m + above)


def camera_mounting(camera: Camera, size: Size) -> Transform:
    """The forward camera relative to the VUT's origin in CARLA.

    There y is to the right, pitch is positive upwards, yaw to the right and roll to the right.
    """
    return Transform(
        location=Location(
            x=_number(camera.forward_m - body_middle_m(size)),
            y=_number(-camera.left_m),
            z=camera.height_m,
        ),
        rotation=Rotation(
            pitch=_number(-math.degrees(camera.pitch_down_rad)),
            yaw=_number(-math.degrees(camera.yaw_left_rad)),
            roll=_number(math.degrees(camera.roll_right_rad)),
        ),
    )
