"""A road's reference line and the Frenet frame along it (METHOD 2.4).

The line is a chain of pieces whose curvature changes linearly with arc length (straight, arc,
clothoid), tangent-continuous by construction. A place has an arc length s along it and an offset l
to its left. Where lines across it meet, on the inner side of a bend at its centre of curvature and
beyond, (s, l) is no coordinate any more: that is an error here, not a number.

A place's coordinates are those of the nearest foot on the line and its straight extensions, where
one foot alone is nearest. ``to_map`` accepts just the (s, l) that ``to_local`` gives back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray, Pose2, wrap_angle
from ssp_core.run_file.quantities import LEAST
from ssp_core.run_file.road import CurvePiece, JunctionRoad, Road
from ssp_core.run_file.values import Point

IndexArray = NDArray[np.intp]

# A panel turns by at most this; ten nodes then integrate it to rounding error.
_PANEL_TURN_RAD = 0.2
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
# Two feet whose distances differ by less are equally near.
_SAME_DISTANCE_M = 1e-6
# Feet that are nearer to each other than this are one foot, found from two panels.
_SAME_FOOT_M = 1e-4
# A foot is lost in rounding when 1 - l * curvature, the stretch of the map along s, is under this.
LEAST_STRETCH = 1e-3
# A Newton step this short leaves an error of rounding only.
_LAST_STEP_M = 1e-10
_CHUNK = 4096
_SPLITS = 4


# Places of a line are compared with each other in this step, of at most so many.
_APART_STEP_M = 0.5
_MOST_APART = 2000

Ray = tuple[float, float, float, float]


def _rays_meet(one: Ray, other: Ray) -> bool:
    """Tell whether two rays meet, each given by its start and its direction."""
    x0, y0, c0, w0 = one
    x1, y1, c1, w1 = other
    across = c0 * w1 - w0 * c1
    if abs(across) < 1e-12:
        return False
    dx, dy = x1 - x0, y1 - y0
    return (dx * w1 - dy * c1) / across >= 0.0 and (dx * w0 - dy * c0) / across >= 0.0


class Panels:
    """The chain.

    Args:
        lengths_m: of the pieces, each > 0.
        starts_1pm: curvature at each piece's start, + turns left.
        ends_1pm: curvature at each piece's end.

    The caller sees to finite numbers, and to no more turns than make a reasonable array.
    """

    def __init__(
        self,
        origin: Pose2,
        lengths_m: Sequence[float],
        starts_1pm: Sequence[float],
        ends_1pm: Sequence[float],
    ) -> None:
        s, u, k, rate = [], [], [], []
        begin = 0.0
        for length, k0, k1 in zip(lengths_m, starts_1pm, ends_1pm, strict=True):
            turn = max(abs(k0), abs(k1)) * length
            count = max(1, math.ceil(turn / _PANEL_TURN_RAD))
            step = length / count
            slope = (k1 - k0) / length
            for i in range(count):
                s.append(begin + i * step)
                u.append(step)
                k.append(k0 + slope * i * step)
                rate.append(slope)
            begin += length
        self.length_m = begin
        self.s: FloatArray = np.array(s)
        self.u: FloatArray = np.array(u)
        self.k: FloatArray = np.array(k)
        self.rate: FloatArray = np.array(rate)
        turns = self.u * (self.k + 0.5 * self.rate * self.u)
        self.yaw: FloatArray = origin.yaw_rad + np.concatenate(([0.0], np.cumsum(turns)[:-1]))
        dx, dy = self._chord(np.arange(len(self.u)), self.u)
        # From the origin, so that far-off map coordinates cost no precision here.
        self._shift = np.array([origin.x_m, origin.y_m])
        self.x: FloatArray = np.concatenate(([0.0], np.cumsum(dx)))
        self.y: FloatArray = np.concatenate(([0.0], np.cumsum(dy)))
        yaws = np.append(self.yaw, self.yaw[-1] + turns[-1])
        self.heading_range_rad = float(yaws.max() - yaws.min())
        self._last = Pose2(float(self.x[-1]), float(self.y[-1]), float(yaws[-1]))
        # A curve of length u whose heading varies by a leaves its chord by at most u * a / 2.
        worst = np.maximum(np.abs(self.k), np.abs(self.k + self.rate * self.u))
        self._sag = 0.5 * self.u * self.u * worst
        self._sag += 1e-12 * (1.0 + np.abs(self.x[:-1]) + np.abs(self.y[:-1]))

    def _chord(self, index: IndexArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the way from a panel's start to the place u m on: east and north, m."""
        k, rate, yaw = self.k[index], self.rate[index], self.yaw[index]
        half = 0.5 * k * u
        across = u * np.sinc(half / np.pi)
        dx, dy = across * np.cos(yaw + half), across * np.sin(yaw + half)
        bent = rate != 0.0
        if bent.any():
            v = 0.5 * u[bent, None] * (1.0 + _NODES)
            angle = yaw[bent, None] + v * (k[bent, None] + 0.5 * rate[bent, None] * v)
            weight = 0.5 * u[bent, None] * _WEIGHTS
            dx[bent] = (weight * np.cos(angle)).sum(axis=1)
            dy[bent] = (weight * np.sin(angle)).sum(axis=1)
        return dx, dy

    def _on(self, index: IndexArray, u: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the place and heading u m into panels."""
        dx, dy = self._chord(index, u)
        yaw = self.yaw[index] + u * (self.k[index] + 0.5 * self.rate[index] * u)
        return self.x[index] + dx, self.y[index] + dy, yaw

    def index(self, s: FloatArray) -> IndexArray:
        """Return the panels that hold arc lengths; the outermost ones beyond the ends."""
        indexes = np.searchsorted(self.s, s, side="right") - 1
        return np.clip(indexes, 0, len(self.s) - 1)

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the place and heading at arc lengths: x, y, yaw, each of shape (n,)."""
        index = self.index(s)
        inside = np.clip(s, 0.0, self.length_m)
        x, y, yaw = self._on(index, inside - self.s[index])
        beyond = s - inside
        x += beyond * np.cos(yaw) + self._shift[0]
        y += beyond * np.sin(yaw) + self._shift[1]
        return x, y, yaw

    def curvature(self, s: FloatArray) -> FloatArray:
        """Return the curvature at arc lengths, 1/m; 0 beyond the ends."""
        index = self.index(s)
        k = self.k[index] + self.rate[index] * (s - self.s[index])
        return np.where((s < 0.0) | (s > self.length_m), 0.0, k)

    def apart_m(self, most_1pm: float) -> float:
        """Return a distance that places keep between which the heading varies by half a turn.

        Args:
            most_1pm: the largest curvature.

        Returns:
            0 where there is none, or the line is too long to look at all of it.
        """
        count = math.ceil(self.length_m / _APART_STEP_M) + 1
        if count > _MOST_APART:
            return 0.0
        step = self.length_m / (count - 1)
        x, y, yaw = self.at(np.linspace(0.0, self.length_m, count))
        turned = math.pi - 2.0 * most_1pm * step - 1e-6
        least = math.inf
        for i in range(count):
            ahead = yaw[i:]
            spread = np.maximum.accumulate(ahead) - np.minimum.accumulate(ahead)
            first = i + int(np.searchsorted(spread, turned))
            if first < count:
                least = min(least, float(np.hypot(x[first:] - x[i], y[first:] - y[i]).min()))
        # The straights beyond both ends, as far as they can come near.
        rays = []
        for end, side in ((0, -1.0), (-1, 1.0)):
            c, w = side * math.cos(yaw[end]), side * math.sin(yaw[end])
            spread = yaw if side < 0.0 else yaw[::-1]
            spread = np.maximum.accumulate(spread) - np.minimum.accumulate(spread)
            far = spread >= turned if side < 0.0 else (spread >= turned)[::-1]
            dx, dy = x[far] - x[end], y[far] - y[end]
            along = np.maximum(c * dx + w * dy, 0.0)
            least = min(
                least, float(np.hypot(dx - c * along, dy - w * along).min(initial=math.inf))
            )
            rays.append((float(x[end]), float(y[end]), c, w))
        if _rays_meet(*rays):
            return 0.0
        return max(0.0, least - step)

    def feet(self, xy: FloatArray) -> FloatArray:
        """Return the arc length and offset of the nearest foot of each place.

        Args:
            xy: shape (n, 2), m, frame map.

        Returns:
            Shape (n, 2); NaN where no single foot is nearest, or the nearest is where the map along
            s shrinks to nothing (the centre of curvature).
        """
        out = np.full((len(xy), 2), np.nan)
        step = max(1, _CHUNK * 16 // len(self.s))
        for start in range(0, len(xy), step):
            out[start : start + step] = self._feet(xy[start : start + step] - self._shift)
        return out

    def _feet(self, xy: FloatArray) -> FloatArray:
        n = len(xy)
        who, s, off, stretch = self._candidates(xy)
        distance = np.abs(off)
        order = np.lexsort((s, distance, who))
        who, s, off = who[order], s[order], off[order]
        stretch, distance = stretch[order], distance[order]
        first = np.searchsorted(who, np.arange(n))
        if len(np.unique(who)) != n:
            raise RuntimeError("a place without any foot on an endless line")
        best_s, best_d = s[first], distance[first]
        rival = np.abs(s - best_s[who]) > _SAME_FOOT_M
        rival &= distance - best_d[who] <= _SAME_DISTANCE_M
        bad = np.zeros(n, dtype=bool)
        np.logical_or.at(bad, who, rival)
        bad |= stretch[first] < LEAST_STRETCH
        out = np.stack([best_s, off[first]], axis=1)
        out[bad] = np.nan
        return out

    def _candidates(self, xy: FloatArray) -> tuple[IndexArray, FloatArray, FloatArray, FloatArray]:
        """Return feet that may be the nearest: which place's, arc length, offset, map's stretch."""
        px, py = xy[:, :1], xy[:, 1:]
        ax, ay = self.x[:-1], self.y[:-1]
        bx, by = self.x[1:] - ax, self.y[1:] - ay
        norm = np.maximum(bx * bx + by * by, 1e-300)
        t = np.clip(((px - ax) * bx + (py - ay) * by) / norm, 0.0, 1.0)
        distance = np.hypot(px - ax - t * bx, py - ay - t * by)
        # Places on the extensions: along, across, and whether the foot is out there.
        rays = [
            (Pose2(float(self.x[0]), float(self.y[0]), float(self.yaw[0])), 0.0, -1.0),
            (self._last, self.length_m, 1.0),
        ]
        feet = []
        bound = (distance + self._sag).min(axis=1)
        for pose, s0, side in rays:
            c, w = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
            dx, dy = xy[:, 0] - pose.x_m, xy[:, 1] - pose.y_m
            along, across = c * dx + w * dy, c * dy - w * dx
            out = np.flatnonzero(along * side > 0.0)
            bound[out] = np.minimum(bound[out], np.abs(across[out]))
            feet.append((out, s0 + along[out], across[out], np.ones(len(out))))
        near = distance - self._sag <= bound[:, None] + _SAME_DISTANCE_M
        who, index = np.nonzero(near)
        feet += self._roots(xy, who, index)
        merged = [np.concatenate(part) for part in zip(*feet, strict=True)]
        return merged[0], merged[1], merged[2], merged[3]

    def _slip(
        self, xy: FloatArray, index: IndexArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Compute how far a foot has to move on, the offset there, and the stretch of the map."""
        x, y, yaw = self._on(index, u)
        c, w = np.cos(yaw), np.sin(yaw)
        dx, dy = xy[:, 0] - x, xy[:, 1] - y
        across = c * dy - w * dx
        return c * dx + w * dy, across, 1.0 - across * (self.k[index] + self.rate[index] * u)

    def _roots(
        self, xy: FloatArray, who: IndexArray, index: IndexArray
    ) -> list[tuple[IndexArray, FloatArray, FloatArray, FloatArray]]:
        """Return feet on panels: places where the slip changes from forwards to backwards."""
        share = np.linspace(0.0, 1.0, _SPLITS + 1)
        slips = np.stack(
            [self._slip(xy[who], index, self.u[index] * part)[0] for part in share], axis=1
        )
        # A foot on the border of two panels must not fall between them.
        slack = 1e-14 * (1.0 + np.abs(xy[who]).sum(axis=1) + np.abs(self.x[index]))
        crossing = (slips[:, :-1] >= -slack[:, None]) & (slips[:, 1:] <= slack[:, None])
        pair, split = np.nonzero(crossing)
        who, index = who[pair], index[pair]
        low, high = self.u[index] * share[split], self.u[index] * share[split + 1]
        p = xy[who]
        u = 0.5 * (low + high)
        for _ in range(60):
            slip, _, stretch = self._slip(p, index, u)
            low, high = np.where(slip > 0.0, u, low), np.where(slip > 0.0, high, u)
            with np.errstate(divide="ignore", invalid="ignore"):
                step = u + slip / stretch
            inside = (step >= low) & (step <= high)
            new = np.where(inside, step, 0.5 * (low + high))
            is_converged = np.abs(new - u) <= _LAST_STEP_M
            u = new
            if is_converged.all():
                break
        _, across, stretch = self._slip(p, index, u)
        return [(who, self.s[index] + u, across, stretch)]


# What two computations of the same place may differ by.
ROUND_TRIP_M = 1e-6
# Doubles lose the round trip's 1e-6 m farther out.
_FARTHEST_M = 1e8
# More turns than this are no road.
_MOST_TURNS = 100.0


class NotOneToOne(ValueError):
    """The place has no single (s, l) along this line, or the (s, l) no place of its own."""


def _check(*values: float) -> None:
    for value in values:
        if not abs(value) <= _FARTHEST_M:
            raise ValueError(f"a coordinate must be within {_FARTHEST_M:g} m, got {value:g}")


# A line of more pieces on a path was digitised finer than its shape needs.
_MANY_JOINTS = 250


def _thinned(points: FloatArray, error_m: float) -> FloatArray:
    """Return the points that a chord needs to leave none of the others by more than an error."""
    import shapely  # type: ignore[import-untyped]  # slow to import, no types

    line = shapely.LineString(points).simplify(error_m, preserve_topology=False)
    return np.asarray(shapely.get_coordinates(line))


class ReferenceLine:
    """A reference line in frame map; its ends are extended straight.

    Args:
        pieces: at least one.

    Raises:
        ValueError: no piece, a number in them that isn't finite or is beyond 1e8 m, or more
            turns than a road has.
    """

    def __init__(self, origin: Pose2, pieces: Sequence[CurvePiece]) -> None:
        if not pieces:
            raise ValueError("a reference line needs at least one piece")
        numbers = [(p.length_m, p.start_curvature_1pm, p.end_curvature_1pm) for p in pieces]
        for length, k0, k1 in numbers:
            if not (math.isfinite(k0) and math.isfinite(k1) and 0.0 < length < math.inf):
                raise ValueError(f"a piece needs finite numbers, got {(length, k0, k1)}")
        if not all(map(math.isfinite, (origin.x_m, origin.y_m, origin.yaw_rad))):
            raise ValueError(f"an origin needs finite numbers, got {origin}")
        self.origin = origin
        self.pieces: tuple[CurvePiece, ...] = tuple(pieces)
        _check(origin.x_m, origin.y_m, sum(length for length, _, _ in numbers))
        turns = sum(length * max(abs(k0), abs(k1)) for length, k0, k1 in numbers) / (2 * math.pi)
        if not turns <= _MOST_TURNS:
            raise ValueError(f"a reference line turns at most {_MOST_TURNS:g} times")
        self._numbers = numbers
        self._straight = not any(k0 or k1 for _, k0, k1 in numbers)

    @cached_property
    def _panels(self) -> Panels:
        lengths, starts, ends = zip(*self._numbers, strict=True)
        return Panels(self.origin, lengths, starts, ends)

    @cached_property
    def _reach_m(self) -> tuple[float, float]:
        """Offsets (right, left) inside of which every place is known to be one-to-one.

        While the heading varies by less than half a turn, offset lines to one side run into each
        other nowhere before the centre of the tightest bend to that side; stretches between which
        it varies by more do so nowhere before the middle between them.
        """
        ends = [k for _, k0, k1 in self._numbers for k in (k0, k1)]
        most, least = max(ends), min(ends)
        right = (1.0 - LEAST_STRETCH) / least if least < 0.0 else -math.inf
        left = (1.0 - LEAST_STRETCH) / most if most > 0.0 else math.inf
        if self._panels.heading_range_rad >= math.pi - 1e-6:
            half = 0.5 * self._panels.apart_m(max(most, -least))
            right, left = max(right, -half), min(left, half)
        return right, left

    @classmethod
    def of_road(cls, road: Road | JunctionRoad) -> ReferenceLine:
        """Return the line of a road in a run file; straight where the road has no pieces."""
        return cls(road.origin.pose, road.pieces or [CurvePiece(length_m=road.length_m)])

    @property
    def length_m(self) -> float:
        """Arc length."""
        return sum(length for length, _, _ in self._numbers)

    @property
    def is_straight(self) -> bool:
        """True when no piece bends: the transform is then a rigid motion."""
        return self._straight

    def pose(self, s_m: float) -> Pose2:
        """Return the pose of the line at an arc length."""
        return self.poses([s_m])[0]

    def poses(self, s_m: Sequence[float]) -> list[Pose2]:
        """Compute ``pose`` for each of some arc lengths."""
        _check(*s_m)
        if self._straight:
            yaw_rad = wrap_angle(self.origin.yaw_rad)
            return [Pose2(*self.origin.to_parent(s, 0.0), yaw_rad) for s in s_m]
        columns = (part.tolist() for part in self._panels.at(np.array(s_m)))
        return [Pose2(x, y, wrap_angle(yaw)) for x, y, yaw in zip(*columns, strict=True)]

    def curvature_1pm(self, s_m: float) -> float:
        """Return the curvature at an arc length, + turns left; 0 beyond the ends."""
        _check(s_m)
        return float(self._panels.curvature(np.array([s_m]))[0])

    def to_map(self, s_m: float, l_m: float) -> Point:
        """Return the place in frame map.

        Raises:
            NotOneToOne: l is at or beyond the centre of curvature, or another stretch of the line
                is as near to the place.
        """
        _check(s_m, l_m)
        if self._straight:
            return self.origin.to_parent(s_m, l_m)
        x, y = self.to_map_many(np.array([s_m]), l_m)[0]
        return float(x), float(y)

    def to_map_many(self, s_m: FloatArray, l_m: float) -> FloatArray:
        """Convert as to_map for arc lengths of shape (n,) at one offset: shape (n, 2).

        Raises:
            NotOneToOne: as to_map, for any of them.
        """
        s = np.asarray(s_m, dtype=np.float64)
        if s.ndim != 1 or not (np.abs(s) <= _FARTHEST_M).all():
            raise ValueError(f"arc lengths need shape (n,), each within {_FARTHEST_M:g} m")
        _check(l_m)
        if self._straight:
            return np.array([self.origin.to_parent(float(at), l_m) for at in s]).reshape(-1, 2)
        x, y, yaw = self._panels.at(s)
        xy = np.stack([x - l_m * np.sin(yaw), y + l_m * np.cos(yaw)], axis=1)
        right, left = self._reach_m
        if right < l_m < left:
            return xy
        back = self._panels.feet(xy)
        apart = np.abs(back - np.stack([s, np.full(len(s), l_m)], axis=1)).max(axis=1)
        lost = ~(apart <= ROUND_TRIP_M)
        if lost.any():
            at_m = float(s[np.argmax(lost)])
            raise NotOneToOne(
                f"offset {l_m:g} m at arc length {at_m:g} m has no place of its own: it lies at or "
                f"beyond the centre of curvature (curvature {self.curvature_1pm(at_m):g} 1/m), or "
                "as near to another stretch of the line"
            )
        return xy

    def to_local(self, x_m: float, y_m: float) -> Point:
        """Return the arc length and offset of a place in frame map; exact to 1e-6 m against to_map.

        Raises:
            NotOneToOne: two feet on the line are equally near, or the place lies at or beyond the
                centre of curvature.
        """
        _check(x_m, y_m)
        if self._straight:
            return self.origin.to_local(x_m, y_m)
        s, offset = self._panels.feet(np.array([[x_m, y_m]]))[0]
        if math.isnan(s):
            raise NotOneToOne(
                f"({x_m:g}, {y_m:g}) m has no single foot on the line: it lies at or beyond the "
                "centre of curvature, or as near to two stretches of the line"
            )
        return float(s), float(offset)

    def to_local_many(self, xy_m: FloatArray) -> FloatArray:
        """Convert as to_local for shape (n, 2), with NaN where the map isn't one-to-one."""
        xy = np.asarray(xy_m, dtype=np.float64)
        if xy.ndim != 2 or xy.shape[1] != 2 or not (np.abs(xy) <= _FARTHEST_M).all():
            raise ValueError(f"places need shape (n, 2), each within {_FARTHEST_M:g} m")
        if self._straight:
            c, w = math.cos(self.origin.yaw_rad), math.sin(self.origin.yaw_rad)
            local: FloatArray = (xy - [self.origin.x_m, self.origin.y_m]) @ [[c, -w], [w, c]]
            return local
        return self._panels.feet(xy)

    def path(
        self, from_s_m: float, to_s_m: float, l_m: float, max_error_m: float = 0.005
    ) -> list[Point]:
        """Return the points at an offset from one arc length to another (either order), frame map.

        A chord leaves the true curve by at most max_error_m; a straight stretch has two points,
        from one arc length to itself is one point. Of a line in very many pieces only the joints
        are taken that this error needs.

        Raises:
            NotOneToOne: as to_map, for any point of it.
        """
        _check(from_s_m, to_s_m, l_m)
        if not max_error_m > 0.0:
            raise ValueError(f"max_error_m must be above 0, got {max_error_m}")
        low, high = min(from_s_m, to_s_m), max(from_s_m, to_s_m)
        if low == high:
            return [self.to_map(low, l_m)]
        stations = {low, high}
        begin, bent_before, joints = 0.0, False, 0
        for piece in self.pieces:
            end = begin + piece.length_m
            k = max(abs(piece.start_curvature_1pm), abs(piece.end_curvature_1pm))
            inside = (max(low, begin), min(high, end))
            if inside[0] <= inside[1]:
                joints += 1
                if k or bent_before:
                    stations.add(inside[0])
                if k:
                    # Sagitta of an offset arc: curvature / stretch * (step * stretch)^2 / 8.
                    stretch = 1.0 + abs(l_m) * k
                    step = math.sqrt(8.0 * max_error_m / (k * stretch))
                    count = math.ceil((inside[1] - inside[0]) / step) + 1
                    stations.update(np.linspace(*inside, count + 1).tolist())
            begin, bent_before = end, k > 0.0
        if bent_before and low <= begin <= high:
            stations.add(begin)
        ordered = np.array(sorted(stations))
        # Two names of one station (a joint, reached from both sides) are one point.
        ordered = ordered[np.concatenate(([True], np.diff(ordered) > 1e-9))]
        if len(ordered) == 1:
            ordered = np.array([low, high])
        else:
            ordered[-1] = high
        if to_s_m < from_s_m:
            ordered = ordered[::-1]
        points = self.to_map_many(ordered, l_m)
        if joints > _MANY_JOINTS:
            # The step above is at least halved: a chord leaves the curve by a quarter at most.
            points = _thinned(points, 0.75 * max_error_m)
        return [(float(x), float(y)) for x, y in points]

    def section(self, from_s_m: float, to_s_m: float) -> ReferenceLine:
        """Return the part between two arc lengths, as a line of its own.

        Raises:
            ValueError: the second isn't above the first.
        """
        _check(from_s_m, to_s_m)
        if not from_s_m < to_s_m:
            raise ValueError(f"a section needs from < to, got {from_s_m:g} to {to_s_m:g}")
        parts = []
        if from_s_m <= -LEAST:
            parts.append(CurvePiece(length_m=min(0.0, to_s_m) - from_s_m))
        begin = 0.0
        for piece in self.pieces:
            low = max(from_s_m - begin, 0.0)
            high = min(to_s_m - begin, piece.length_m)
            if high - low >= LEAST:
                k0 = piece.start_curvature_1pm
                rate = (piece.end_curvature_1pm - k0) / piece.length_m
                whole = high == piece.length_m
                parts.append(
                    CurvePiece(
                        length_m=high - low,
                        start_curvature_1pm=k0 + rate * low,
                        end_curvature_1pm=piece.end_curvature_1pm if whole else k0 + rate * high,
                    )
                )
            begin += piece.length_m
        if to_s_m > begin:
            parts.append(CurvePiece(length_m=to_s_m - max(begin, from_s_m)))
        return ReferenceLine(self.pose(from_s_m), parts)

    def reversed(self) -> ReferenceLine:
        """Return the same line driven the other way: l changes its sign."""
        end = self.pose(self.length_m)
        pieces = [
            CurvePiece(
                length_m=piece.length_m,
                start_curvature_1pm=-piece.end_curvature_1pm,
                end_curvature_1pm=-piece.start_curvature_1pm,
            )
            for piece in reversed(self.pieces)
        ]
        return ReferenceLine(Pose2(end.x_m, end.y_m, wrap_angle(end.yaw_rad + math.pi)), pieces)
