"""References as trajectories of ISO 22133, and back.

A trajectory's times count from the start that a STRT gives. Its points lie on a grid of these
times: an object that is sent points of the same times again can only replace them, while points in
between would be driven beside the old ones. Places are rounded to 1 mm, speeds to 1 cm/s.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.files.reading import read_text
from ssp_core.geodesy import Datum
from ssp_core.geometry import Pose2
from ssp_core.motion.reference import Points, Reference, sample
from ssp_ot_controller.bodies.iso22133.framing import Reason, RejectedBytes
from ssp_ot_controller.bodies.iso22133.messages import Traj, TrajectoryInfo, TrajPoint

# Whole milliseconds, which is what the wire has.
POINT_STEP_NS = 50_000_000
_NAME_BYTES = 63


def trajectory_of(
    reference: Reference,
    start_ns: int,
    datum: Datum,
    trajectory_id: int,
    *,
    from_ns: int | None = None,
    to_ns: int | None = None,
) -> Traj:
    """Return a reference, or a part of it, as it is sent.

    The last point of a whole reference is a standstill at its end.

    Args:
        reference: one that ``check_reference`` accepts; it begins no earlier than ``start_ns``.
        start_ns: session time at which the trajectory's time is 0.
        datum: of the site; the points are sent in ENU at it.
        trajectory_id: number of the trajectory in the message.
        from_ns: session time of the first point that is sent; None: where the reference begins.
        to_ns: session time before which the last point lies; None: the reference's end.

    Raises:
        ValueError: the reference begins before the start.
    """
    if reference.execute_at_ns < start_ns:
        early_s = ns_to_seconds(start_ns - reference.execute_at_ns)
        raise ValueError(f"{reference.reference_id} begins {early_s:.3f} s before the start")
    begin_ns = max(reference.execute_at_ns, from_ns or 0) - start_ns
    end_ns = reference.end_ns - start_ns
    last = -(-end_ns // POINT_STEP_NS)
    if to_ns is not None:
        last = min(last, (to_ns - start_ns - 1) // POINT_STEP_NS)
    points = []
    for step in range(-(-begin_ns // POINT_STEP_NS), last + 1):
        at_ns = step * POINT_STEP_NS
        there = sample(reference, start_ns + at_ns)
        pose = datum.to_enu(Pose2(there.x_m, there.y_m, there.yaw_rad))
        points.append(
            TrajPoint(
                t_s=ns_to_seconds(at_ns),
                x_m=pose.x_m,
                y_m=pose.y_m,
                z_m=0.0,
                yaw_rad=pose.yaw_rad,
                speed_mps=there.speed_mps,
                lateral_speed_mps=0.0,
                acceleration_mps2=there.acceleration_mps2,
                lateral_acceleration_mps2=0.0,
                curvature_1pm=there.curvature_1pm,
            )
        )
    name = reference.reference_id.encode()[:_NAME_BYTES].decode(errors="ignore")
    info = TrajectoryInfo.RELATIVE_TO_ORIGIN
    return Traj(trajectory_id, info, name, tuple(points))


def points_of(trajectory: Traj, datum: Datum) -> Points | RejectedBytes:
    """Return the points of a trajectory of another centre, with times since the start.

    Accelerations that aren't stated are the differences of the speeds; curvatures that aren't
    stated are the turn over the way.
    """
    if trajectory.info != TrajectoryInfo.RELATIVE_TO_ORIGIN:
        text = f"trajectory info {trajectory.info} isn't supported, only relative to the origin"
        return RejectedBytes(Reason.ITEM, text)
    if len(trajectory.points) < 2:
        return RejectedBytes(Reason.MISSING, f"{len(trajectory.points)} points, needs 2 or more")
    rows = []
    for number, point in enumerate(trajectory.points):
        x, y, yaw, speed = point.x_m, point.y_m, point.yaw_rad, point.speed_mps
        if x is None or y is None or yaw is None or speed is None:
            return RejectedBytes(Reason.MISSING, f"point {number} states no place, yaw or speed")
        pose = datum.of_enu(Pose2(x, y, yaw))
        stated = (point.acceleration_mps2, point.curvature_1pm)
        rest = [np.nan if value is None else value for value in stated]
        rows.append((point.t_s, pose.x_m, pose.y_m, pose.yaw_rad, speed, *rest))
    columns = np.array(rows, dtype=np.float64).T.copy()
    t_s, _, _, yaw_rad, speed_mps = columns[:5]
    if not np.all(np.diff(t_s) > 0.0):
        return RejectedBytes(Reason.ORDER, "times of the points don't rise")
    acceleration = np.gradient(speed_mps, t_s)
    turn = np.gradient(np.unwrap(yaw_rad), t_s)
    curvature = np.where(speed_mps > 0.1, turn / np.maximum(speed_mps, 0.1), 0.0)
    columns[5] = np.where(np.isnan(columns[5]), acceleration, columns[5])
    columns[6] = np.where(np.isnan(columns[6]), curvature, columns[6])
    return Points(columns)


_NEEDED_COLUMNS = ("t_s", "x_m", "y_m", "yaw_rad", "speed_mps")
_OTHER_COLUMNS = ("acceleration_mps2", "curvature_1pm")
_REST: dict[str, Any] = {
    **dict.fromkeys(_OTHER_COLUMNS),
    "z_m": 0.0,
    "lateral_speed_mps": 0.0,
    "lateral_acceleration_mps2": 0.0,
}


def read_trajectory(path: str | Path) -> Traj:
    """Return a trajectory of a CSV file, as it is sent to an object.

    Its header names the columns t_s, x_m, y_m, yaw_rad, speed_mps, and may name acceleration_mps2
    and curvature_1pm: those of ``TrajPoint``, in the test's coordinate system.

    Raises:
        InputError: it can't be read, or isn't of that form.
    """
    header, *lines = read_text(path).splitlines() or [""]
    names = [name.strip() for name in header.split(",")]
    missing = [name for name in _NEEDED_COLUMNS if names.count(name) != 1]
    unknown = [name for name in names if name not in (*_NEEDED_COLUMNS, *_OTHER_COLUMNS)]
    if missing or unknown:
        raise InputError(
            f"must have one {missing[0]}" if missing else f"{unknown[0]!r} isn't known",
            file=path,
            field="header",
            value=header,
            remedy=f"name {', '.join(_NEEDED_COLUMNS)}, and at will {', '.join(_OTHER_COLUMNS)}",
        )
    points = []
    for number, line in enumerate(lines, start=2):
        try:
            row = [decimal(text) for text in line.split(",")]
        except ValueError:
            row = []
        if len(row) != len(names) or not all(map(math.isfinite, row)):
            remedy = f"give {len(names)} finite numbers, separated by commas"
            raise InputError("is no point", file=path, line=number, value=line, remedy=remedy)
        points.append(TrajPoint(**{**_REST, **dict(zip(names, row, strict=True))}))
    if len(points) < 2:
        raise InputError(
            f"has {len(points)} points, needs 2 or more",
            file=path,
            remedy="give two points or more",
        )
    name = Path(path).stem.encode()[:_NAME_BYTES].decode(errors="ignore")
    return Traj(1, TrajectoryInfo.RELATIVE_TO_ORIGIN, name, tuple(points))
