"""A chain of linear-curvature pieces as arrays: places along it, and the nearest feet of places.

Each piece is cut into panels that turn by little, so that a short Gauss-Legendre sum integrates a
panel to rounding error, and its chord bounds where it can be. Before the first and after the last
panel the chain goes on straight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray, Pose2

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


class Panels:
    """The chain.

    Args:
        origin: pose of its start.
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
        """From a panel's start to the place u m on: east and north, m."""
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
        """Place and heading u m into panels."""
        dx, dy = self._chord(index, u)
        yaw = self.yaw[index] + u * (self.k[index] + 0.5 * self.rate[index] * u)
        return self.x[index] + dx, self.y[index] + dy, yaw

    def index(self, s: FloatArray) -> IndexArray:
        """Panels that hold arc lengths; the outermost ones beyond the ends."""
        found = np.searchsorted(self.s, s, side="right") - 1
        return np.clip(found, 0, len(self.s) - 1)

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Place and heading at arc lengths: x, y, yaw, each of shape (n,)."""
        index = self.index(s)
        inside = np.clip(s, 0.0, self.length_m)
        x, y, yaw = self._on(index, inside - self.s[index])
        beyond = s - inside
        x += beyond * np.cos(yaw) + self._shift[0]
        y += beyond * np.sin(yaw) + self._shift[1]
        return x, y, yaw

    def curvature(self, s: FloatArray) -> FloatArray:
        """Curvature at arc lengths, 1/m; 0 beyond the ends."""
        index = self.index(s)
        k = self.k[index] + self.rate[index] * (s - self.s[index])
        return np.where((s < 0.0) | (s > self.length_m), 0.0, k)

    def feet(self, xy: FloatArray) -> FloatArray:
        """Arc length and offset of the nearest foot of each place.

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
        """Feet that may be the nearest: whose place, arc length, offset, stretch of the map."""
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
        found = []
        bound = (distance + self._sag).min(axis=1)
        for pose, s0, side in rays:
            c, w = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
            dx, dy = xy[:, 0] - pose.x_m, xy[:, 1] - pose.y_m
            along, across = c * dx + w * dy, c * dy - w * dx
            out = np.flatnonzero(along * side > 0.0)
            bound[out] = np.minimum(bound[out], np.abs(across[out]))
            found.append((out, s0 + along[out], across[out], np.ones(len(out))))
        near = distance - self._sag <= bound[:, None] + _SAME_DISTANCE_M
        who, index = np.nonzero(near)
        found += self._roots(xy, who, index)
        merged = [np.concatenate(part) for part in zip(*found, strict=True)]
        return merged[0], merged[1], merged[2], merged[3]

    def _slip(
        self, xy: FloatArray, index: IndexArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """How far a foot has to move on, the offset there, and the stretch of the map."""
        x, y, yaw = self._on(index, u)
        c, w = np.cos(yaw), np.sin(yaw)
        dx, dy = xy[:, 0] - x, xy[:, 1] - y
        across = c * dy - w * dx
        return c * dx + w * dy, across, 1.0 - across * (self.k[index] + self.rate[index] * u)

    def _roots(
        self, xy: FloatArray, who: IndexArray, index: IndexArray
    ) -> list[tuple[IndexArray, FloatArray, FloatArray, FloatArray]]:
        """Feet on panels: places where the slip changes from forwards to backwards."""
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
            done = np.abs(new - u) <= _LAST_STEP_M
            u = new
            if done.all():
                break
        _, across, stretch = self._slip(p, index, u)
        return [(who, self.s[index] + u, across, stretch)]
