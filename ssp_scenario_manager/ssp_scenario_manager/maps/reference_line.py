"""Reference lines of roads: exact from OpenDRIVE if possible, else fitted; smooth on a polyline."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from pyclothoids import Clothoid  # type: ignore[import-untyped] # has no types

from ssp_core.geometry import FloatArray, Pose2, wrap_angle
from ssp_core.run_file.quantities import QUANTITIES
from ssp_core.run_file.road import CurvePiece
from ssp_core.run_file.values import Point
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.opendrive_road import Geometry, RoadRecord

# A line leaves the map's by at most this.
FIT_ERROR_M = 0.01
# Beyond these, the parts of a road don't continue one another.
_GAP_M = 0.01
_KINK_RAD = 0.05
# What is smaller at both ends of a part is rounding, and isn't led over until it adds up.
_SLACK_M = 1e-3
_SHORTEST_M = 1e-6
_MOST_FITTED = 64
_SAMPLES = 8
_POLY3_STEPS = 2000


class Unusable(Exception):
    """Something in the map is well-formed and can't be a block; the message says why."""


def piece(length_m: float, start_1pm: float = 0.0, end_1pm: float | None = None) -> CurvePiece:
    """Make a piece from numbers that are known to be fit for one."""
    return CurvePiece(
        length_m=length_m,
        start_curvature_1pm=start_1pm,
        end_curvature_1pm=start_1pm if end_1pm is None else end_1pm,
    )


def _advance(pose: Pose2, pieces: Sequence[CurvePiece]) -> Pose2:
    if not pieces:
        return pose
    line = ReferenceLine(pose, pieces)
    return line.pose(line.length_m)


def _clothoid(start: Pose2, end: Pose2) -> CurvePiece:
    """Return the clothoid from one pose to another (the G1 problem)."""
    distance = math.hypot(end.x_m - start.x_m, end.y_m - start.y_m)
    if not 1e-9 < distance < 1e6:
        raise Unusable(f"two places {distance:g} m apart can't be joined by a curve")
    # Around the origin, where the solver loses no digits.
    clothoid = Clothoid.G1Hermite(
        0.0,
        0.0,
        start.yaw_rad,
        end.x_m - start.x_m,
        end.y_m - start.y_m,
        start.yaw_rad + wrap_angle(end.yaw_rad - start.yaw_rad),
    )
    numbers = (clothoid.length, clothoid.KappaStart, clothoid.KappaEnd)
    if not all(map(math.isfinite, numbers)) or not 0.0 < clothoid.length < 10.0 * distance:
        raise Unusable("no clothoid joins two neighbouring places of the curve")
    return piece(*numbers)


def _poly3_end_m(b: float, c: float, d: float, length_m: float) -> float:
    """Find the end of a poly3 along its own u axis: its length is that of the curve."""
    u = np.linspace(0.0, length_m, _POLY3_STEPS + 1)
    stretch = np.hypot(1.0, b + u * (2 * c + 3 * u * d))
    length = np.concatenate(([0.0], np.cumsum(0.5 * (stretch[1:] + stretch[:-1]) * u[1])))
    return float(np.interp(length_m, length, u))


def _cubic_places(shape: Geometry, share: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) and headings (n,) of a cubic at shares of its parameter, frame map."""
    if shape.kind == "poly3":
        a, b, c, d = shape.numbers
        u = share * _poly3_end_m(b, c, d, shape.length_m)
        v = a + u * (b + u * (c + u * d))
        du, dv = np.ones_like(u), b + u * (2 * c + 3 * u * d)
    else:
        p = share if shape.normalised else share * shape.length_m
        (au, bu, cu, dcu), (av, bv, cv, dcv) = shape.numbers[:4], shape.numbers[4:]
        u, v = au + p * (bu + p * (cu + p * dcu)), av + p * (bv + p * (cv + p * dcv))
        du, dv = bu + p * (2 * cu + 3 * p * dcu), bv + p * (2 * cv + 3 * p * dcv)
    if not (np.abs([u, v, du, dv]) < 1e7).all() or (np.hypot(du, dv) < 1e-9).any():
        raise Unusable(f"its {shape.kind} at s = {shape.s_m:g} m runs off, or stands still")
    c, s = math.cos(shape.heading_rad), math.sin(shape.heading_rad)
    places = np.stack([shape.x_m + c * u - s * v, shape.y_m + s * u + c * v], axis=1)
    return places, shape.heading_rad + np.unwrap(np.arctan2(dv, du))


def fit_cubic(shape: Geometry, start: Pose2) -> list[CurvePiece]:
    """Fit a chain of clothoids that leaves a cubic by at most 1 cm.

    Args:
        shape: poly3 or paramPoly3.
        start: pose to begin at, within 1 cm of the cubic's own.

    Raises:
        Unusable: no chain of up to 64 does.
    """
    count = 1
    worst = math.inf
    while count <= _MOST_FITTED:
        places, headings = _cubic_places(shape, np.linspace(0.0, 1.0, count * _SAMPLES + 1))
        joints = [
            Pose2(float(x), float(y), float(yaw))
            for (x, y), yaw in zip(places[::_SAMPLES], headings[::_SAMPLES], strict=True)
        ]
        joints[0] = start
        pieces = [_clothoid(a, b) for a, b in pairwise(joints)]
        line = ReferenceLine(start, pieces)
        apart = np.abs(line.to_local_many(places)[:, 1])
        worst = float("inf") if np.isnan(apart).any() else float(apart.max())
        if worst <= FIT_ERROR_M:
            length = line.length_m
            if abs(length - shape.length_m) > 0.1 + 0.01 * shape.length_m:
                raise Unusable(
                    f"its {shape.kind} at s = {shape.s_m:g} m is {length:.2f} m long, and is said "
                    f"to be {shape.length_m:g} m"
                )
            return pieces
        count *= 2
    best = f"leave it by {worst:.3f} m" if math.isfinite(worst) else "run back beside themselves"
    raise Unusable(
        f"its {shape.kind} at s = {shape.s_m:g} m can't be fitted within {FIT_ERROR_M:g} m: "
        f"{_MOST_FITTED} clothoids {best}"
    )


def _start(shape: Geometry) -> Pose2:
    """Return the start of a part.

    A cubic's own start may lie, or head, elsewhere than its frame.
    """
    if shape.kind not in ("poly3", "paramPoly3"):
        return Pose2(shape.x_m, shape.y_m, shape.heading_rad)
    places, headings = _cubic_places(shape, np.array([0.0, 0.001]))
    return Pose2(float(places[0, 0]), float(places[0, 1]), float(headings[0]))


def _exact(shape: Geometry) -> CurvePiece:
    return piece(shape.length_m, *shape.numbers)


def _lead_over(pose: Pose2, shape: Geometry, turn_rad: float) -> list[CurvePiece]:
    """Lead from a pose beside a part's start onto that part, within 1 cm, and on to its end."""
    own = Pose2(shape.x_m, shape.y_m, shape.heading_rad)
    whole = _exact(shape)
    # A clothoid that takes up a turn over a length leaves the chord by 4/27 of their product.
    length = min(shape.length_m, max(1.0, 0.03 / max(abs(turn_rad), 1e-9)))
    if length > 0.9 * shape.length_m:
        length = shape.length_m
    line = ReferenceLine(own, [whole])
    pieces = [_clothoid(pose, line.pose(length))]
    if length < shape.length_m:
        pieces += line.section(length, shape.length_m).pieces
    return pieces


def road_line(road: RoadRecord) -> ReferenceLine:
    """Return the reference line of a road.

    Raises:
        Unusable: its parts don't continue one another, or a cubic can't be fitted within 1 cm.
    """
    parts = [part for part in road.geometry if part.length_m > _SHORTEST_M]
    if not parts:
        raise Unusable("has no length")
    total = sum(part.length_m for part in parts)
    if abs(total - road.length_m) > 0.1 + 0.01 * road.length_m:
        raise Unusable(f"says that it is {road.length_m:g} m long; its geometry has {total:g} m")
    origin = pose = _start(parts[0])
    pieces: list[CurvePiece] = []
    for part in parts:
        start = _start(part)
        gap = math.hypot(start.x_m - pose.x_m, start.y_m - pose.y_m)
        turn = wrap_angle(start.yaw_rad - pose.yaw_rad)
        if gap > 2 * _GAP_M:
            raise Unusable(
                f"its geometry at s = {part.s_m:g} m starts {gap:.3f} m beside the end before it"
            )
        if abs(turn) > _KINK_RAD:
            raise Unusable(
                f"turns by {math.degrees(turn):.1f} degrees at s = {part.s_m:g} m without a curve"
            )
        try:
            if part.kind in ("poly3", "paramPoly3"):
                new = fit_cubic(part, pose)
            elif gap <= _SLACK_M and abs(turn) * part.length_m <= _SLACK_M:
                new = [_exact(part)]
            else:
                new = _lead_over(pose, part, turn)
            pose = _advance(pose, new)
        except ValueError as error:
            raise Unusable(str(error)) from error
        pieces += new
    return ReferenceLine(origin, pieces)


# The line cuts each corner by at most this.
CORNER_CUT_M = 0.25
_SHARPEST_RAD = math.radians(150.0)
# No run file holds a piece that bends more.
_TIGHTEST_1PM = QUANTITIES["_1pm"].most
_SAME_M = 0.01
_SMALLEST_TURN_RAD = 1e-7


def _distinct(points: Sequence[Point]) -> list[Point]:
    distinct_points: list[Point] = []
    for point in points:
        if not distinct_points or math.dist(point, distinct_points[-1]) > _SAME_M:
            distinct_points.append(point)
    return distinct_points


def smooth_line(points: Sequence[Point]) -> ReferenceLine:
    """Join straights with an arc at each corner, tangent to both sides of it.

    An arc begins and ends at the same distance from its corner, which is half of the shorter side,
    or less where the corner would be cut by more than 25 cm. Points that sample a bend thus give
    arcs that follow one another.

    Raises:
        Unusable: there are fewer than two places, a corner turns by more than 150 degrees, or it
            lies so near to another one that its arc would have a radius under 1 cm.
    """
    places = _distinct(points)
    if len(places) < 2:
        raise Unusable("has no length")
    sides = [math.dist(a, b) for a, b in pairwise(places)]
    yaws = [math.atan2(b[1] - a[1], b[0] - a[0]) for a, b in pairwise(places)]
    pieces: list[CurvePiece] = []
    reach_before = 0.0
    for i, (before, after) in enumerate(pairwise(yaws)):
        turn = wrap_angle(after - before)
        if abs(turn) > _SHARPEST_RAD:
            x, y = places[i + 1]
            raise Unusable(f"turns by {math.degrees(turn):.0f} degrees at ({x:g}, {y:g})")
        if abs(turn) < _SMALLEST_TURN_RAD:
            reach = 0.0
        else:
            # An arc that begins t before a corner of angle a cuts it by t tan(a / 4).
            reach = min(0.5 * min(sides[i], sides[i + 1]), CORNER_CUT_M / math.tan(abs(turn) / 4))
        ahead = sides[i] - reach_before - reach
        if ahead > _SMALLEST_TURN_RAD:
            pieces.append(piece(ahead))
        if reach > 0.0:
            k = math.tan(turn / 2) / reach
            if abs(k) > _TIGHTEST_1PM:
                x, y = places[i + 1]
                raise Unusable(f"bends by {k:.0f} 1/m at ({x:g}, {y:g})")
            pieces.append(piece(turn / k, k))
        reach_before = reach
    last = sides[-1] - reach_before
    if last > _SMALLEST_TURN_RAD:
        pieces.append(piece(last))
    try:
        return ReferenceLine(Pose2(*places[0], yaws[0]), pieces)
    except ValueError as error:
        raise Unusable(str(error)) from error
