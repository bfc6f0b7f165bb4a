"""Holds the tracks of two recordings against each other: are they one drive (METHOD 4.4)?

Two real drives of one plan never lie on each other to the centimetre. Two files that do are copies
of one recording, however its places were turned, mirrored or moved, and whatever its clock, its
rate and its format are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ssp_eval.recordings.states import Sighting

Numbers = NDArray[np.float64]
Places = NDArray[np.complex128]

# How the figure and its limits were chosen stands in docs/audit.md.
SAME_RMS_M = 0.01
SAME_MOTION_S = 5.0
# Tracks whose shape departs less than this from straight lines at constant speed show nothing.
SHAPE_RMS_M = 0.3
MOVING_MPS = 0.5
# Between states that lie farther apart nothing is interpolated.
GAP_S = 0.55
_GRID_S = 0.05
_CHORD_STEPS = 5
_STRIDE_S = 1.0
_SCAN_S = 0.005
_SCANNED = 15
_CANDIDATES = 4
_APART = 6
# Chords need a quarter of a second at either end.
_SLACK_S = 0.6
_STRETCH_S = SAME_MOTION_S + 0.5
# At its ends a spline is worth less.
_MARGIN_S = 0.1
_FEWEST = 8
# Of a stretch so much must be known in both.
_KNOWN = 0.8


@dataclass(frozen=True)
class Track:
    """Places of one participant.

    Args:
        times_s: clip times, rising.
        places_m: x + iy in the map frame, at these times.
    """

    times_s: Numbers
    places_m: Places

    def __len__(self) -> int:
        return len(self.times_s)


@dataclass(frozen=True)
class SameDrive:
    """Two recordings whose tracks are equal up to a rigid motion and a shift in time.

    Args:
        rms_m: of the distances between their places, in the longest stretch that is equal.
        turned_rad: by how much the second is turned against the first.
        mirrored: the second is the first one's mirror image.
        shift_s: clip time of the second less that of the first.
        length_s: of that stretch.
    """

    rms_m: float
    turned_rad: float
    mirrored: bool
    shift_s: float
    length_s: float

    @property
    def text(self) -> str:
        """Describe their equality, for people."""
        how = f"{100 * self.rms_m:.1f} cm rms over {self.length_s:.1f} s"
        turned_deg = math.degrees(self.turned_rad)
        moved = [
            *(["mirrored"] if self.mirrored else []),
            *([f"turned by {turned_deg:.0f} degrees"] if abs(turned_deg) >= 0.5 else []),
            *([f"shifted by {self.shift_s:.2f} s"] if abs(self.shift_s) >= 0.005 else []),
        ]
        return f"{how}, {', '.join(moved)}" if moved else how


def tracks_of(sightings: Iterable[Sighting], ids: Iterable[str]) -> list[dict[str, Track]]:
    """Return tracks by id, once for each kind of source: the world's, and the participants' own."""
    object_ids = frozenset(ids)
    rows: dict[bool, dict[str, dict[float, complex]]] = {}
    for one in sightings:
        if one.object_id in object_ids:
            is_own = one.source == one.object_id
            of_id = rows.setdefault(is_own, {}).setdefault(one.object_id, {})
            of_id[one.t_s] = complex(one.x_m, one.y_m)
    return [{who: _track(places) for who, places in of.items()} for of in rows.values()]


def _track(places: Mapping[float, complex]) -> Track:
    times = sorted(places)
    return Track(np.array(times), np.array([places[t_s] for t_s in times]))


def same_drive(
    first: Mapping[str, Track], second: Mapping[str, Track], vut: tuple[str, str]
) -> SameDrive | None:
    """Find equal motion of VUT and one object in both; None where it differs or is too short.

    Args:
        first: tracks by id.
        second: tracks by id, whatever the ids there are.
        vut: id of the VUT in the first and in the second.
    """
    if vut[0] not in first or vut[1] not in second:
        return None
    best = None
    for one, other in product(sorted(first.keys() - {vut[0]}), sorted(second.keys() - {vut[1]})):
        a, b = _Pair(first[vut[0]], first[one]), _Pair(second[vut[1]], second[other])
        if not a.is_usable or not b.is_usable:
            continue
        same = _compare(a, b)
        if same is not None and (best is None or same.rms_m < best.rms_m):
            best = same
    return best


class _Pair:
    """VUT and one object of a recording: places at any time, and what no rigid motion changes."""

    def __init__(self, vut: Track, other: Track) -> None:
        self.tracks = vut, other
        self.is_usable = min(len(vut), len(other)) >= 4
        if not self.is_usable:
            return
        self.start_s = max(float(track.times_s[0]) for track in self.tracks)
        self.end_s = min(float(track.times_s[-1]) for track in self.tracks)
        # The mean: of states that were thinned out the median period is still the old one.
        self.period_s = max(
            float(track.times_s[-1] - track.times_s[0]) / (len(track) - 1) for track in self.tracks
        )
        self.is_usable = self.end_s - self.start_s >= SAME_MOTION_S
        if not self.is_usable:
            return
        # A quarter of a second to import, for what few recordings are held against each other.
        from scipy.interpolate import CubicSpline  # type: ignore[import-untyped]  # no types

        self._splines = [CubicSpline(track.times_s, track.places_m) for track in self.tracks]
        count = int((self.end_s - self.start_s) / _GRID_S) + 1
        self.grid_s: Numbers = self.start_s + _GRID_S * np.arange(count, dtype=np.float64)
        places = np.array([self.place_m(k, self.grid_s) for k in range(2)])
        # Chords over half a second: speeds, without the noise of single states.
        chords = np.full((2, count), np.nan)
        inner = slice(_CHORD_STEPS, count - _CHORD_STEPS)
        chords[:, inner] = np.abs(places[:, 2 * _CHORD_STEPS :] - places[:, : -2 * _CHORD_STEPS])
        self.features = np.vstack([np.abs(places[1] - places[0]), chords])
        moving_m = MOVING_MPS * 2 * _CHORD_STEPS * _GRID_S
        self.moves = np.nan_to_num(chords.max(axis=0)) > moving_m

    def place_m(self, which: int, times_s: Numbers) -> Places:
        """Return the places of one of the two at any time, between its states; NaN in gaps."""
        track = self.tracks[which]
        places_m: Places = self._splines[which](times_s)
        after = np.clip(np.searchsorted(track.times_s, times_s), 1, len(track) - 1)
        places_m[track.times_s[after] - track.times_s[after - 1] > GAP_S] = np.nan
        return places_m

    def moving_s(self, first_s: float, last_s: float) -> float:
        """Sum the time in which either of the two moves, in s."""
        inside = (self.grid_s >= first_s) & (self.grid_s <= last_s)
        return _GRID_S * float(self.moves[inside].sum())

    def between(self, first_s: float, last_s: float) -> tuple[Track, ...]:
        """Return the states of both from one time to another, as they were recorded."""
        parts = []
        for track in self.tracks:
            i, j = (int(np.searchsorted(track.times_s, t_s)) for t_s in (first_s, last_s))
            parts.append(Track(track.times_s[i:j], track.places_m[i:j]))
        return tuple(parts)


def _compare(a: _Pair, b: _Pair) -> SameDrive | None:
    # The one with fewer states gives the times, the other one is interpolated.
    if a.period_s > b.period_s:
        turned = _compare(b, a)
        return None if turned is None else _reversed(turned)
    best = None
    for lag_s in _lags(a, b):
        for fit in _fits(a, b, lag_s):
            if fit.rms_m < SAME_RMS_M and (best is None or fit.length_s > best.length_s):
                best = fit
        if best is not None:
            break
    return best


def _reversed(one: SameDrive) -> SameDrive:
    turned_rad = one.turned_rad if one.mirrored else -one.turned_rad
    return replace(one, turned_rad=turned_rad, shift_s=-one.shift_s)


def _lags(a: _Pair, b: _Pair) -> list[float]:
    """Return shifts at which distances and speeds agree best: time of a = time of b + shift."""
    needed = round(SAME_MOTION_S / _GRID_S)
    n, m = len(a.grid_s), len(b.grid_s)
    lags = range(needed - m, n - needed + 1)
    if not lags:
        return []
    costs = np.full(len(lags), np.inf)
    for k, lag in enumerate(lags):
        i, j = max(0, lag), max(0, -lag)
        length = min(n - i, m - j)
        gaps = np.abs(a.features[:, i : i + length] - b.features[:, j : j + length]).sum(axis=0)
        gaps = gaps[np.isfinite(gaps) & (a.moves[i : i + length] | b.moves[j : j + length])]
        if len(gaps) >= needed // 2:
            costs[k] = np.partition(gaps, len(gaps) // 3)[len(gaps) // 3]
    shifts_s = []
    offset_s = a.start_s - b.start_s
    for _ in range(_CANDIDATES):
        k = int(np.argmin(costs))
        if not costs[k] < 1.0:
            break
        shifts_s.append(lags[k] * _GRID_S + offset_s)
        costs[max(0, k - _APART) : k + _APART + 1] = np.inf
    return shifts_s


def _fits(a: _Pair, b: _Pair, lag_s: float) -> Iterator[SameDrive]:
    """Yield the whole overlap laid on the other, and each stretch of it, at the best shift."""
    first_s = max(b.start_s, a.start_s + _MARGIN_S - lag_s)
    last_s = min(b.end_s, a.end_s - _MARGIN_S - lag_s)
    if last_s - first_s < SAME_MOTION_S - _SLACK_S:
        return
    whole = _overlay(a, b, (first_s, last_s), lag_s)
    if whole is not None:
        yield whole
        if whole.rms_m < SAME_RMS_M:
            return
    for start_s in np.arange(first_s, last_s - _STRETCH_S, _STRIDE_S):
        part = _overlay(a, b, (start_s, start_s + _STRETCH_S), lag_s)
        if part is not None:
            yield part


def _overlay(a: _Pair, b: _Pair, span_s: tuple[float, float], lag_s: float) -> SameDrive | None:
    """Return a stretch of b laid on a; None where too little moves in it."""
    from scipy.optimize import minimize_scalar  # type: ignore[import-untyped]  # as slow to import

    if b.moving_s(*span_s) < SAME_MOTION_S - _SLACK_S:
        return None
    theirs = b.between(*span_s)
    if min(map(len, theirs)) < _FEWEST or _shape_m(theirs) < SHAPE_RMS_M:
        return None
    places = np.concatenate([track.places_m for track in theirs])

    def fit(shift_s: float) -> tuple[float, float, bool]:
        ours = [a.place_m(k, track.times_s + shift_s) for k, track in enumerate(theirs)]
        return _rigid(np.concatenate(ours), places)

    def rms_m(shift_s: float) -> float:
        return fit(shift_s)[0]

    # Of noisy positions only the right shift makes the noise the same.
    near_s = min(lag_s + _SCAN_S * np.arange(-_SCANNED, _SCANNED + 1), key=rms_m)
    bounds = near_s - _SCAN_S, near_s + _SCAN_S
    optimum = minimize_scalar(rms_m, bounds=bounds, method="bounded", options={"xatol": 1e-5})
    shift_s = float(optimum.x)
    return SameDrive(*fit(shift_s), shift_s=-shift_s, length_s=span_s[1] - span_s[0])


def _shape_m(tracks: Iterable[Track]) -> float:
    """Return the rms departure from straight lines at constant speed, in m."""
    squares = []
    for track in tracks:
        basis = np.vstack([np.ones(len(track)), track.times_s - track.times_s.mean()])
        weights = basis @ track.places_m / (basis * basis).sum(axis=1)
        squares.append(np.abs(track.places_m - weights @ basis) ** 2)
    return float(np.sqrt(np.concatenate(squares).mean()))


def _rigid(ours: Places, theirs: Places) -> tuple[float, float, bool]:
    """Return the rms distance after the best rigid motion, its angle, and whether it mirrors."""
    is_finite = np.isfinite(ours)
    if is_finite.mean() < _KNOWN:
        return math.inf, 0.0, False
    a, b = ours[is_finite], theirs[is_finite]
    a, b = a - a.mean(), b - b.mean()
    straight, mirrored = np.vdot(a, b), np.dot(a, b)
    is_mirrored = bool(abs(mirrored) > abs(straight) * (1.0 + 1e-12))
    turn = mirrored if is_mirrored else straight
    turned = turn / abs(turn) if abs(turn) > 0.0 else 1.0
    # Not by the difference of sums, which leaves 1e-7 of their size.
    laid = (np.conj(a) if is_mirrored else a) * turned
    rms_m = float(np.sqrt((np.abs(laid - b) ** 2).mean()))
    return rms_m, float(np.angle(turned)), is_mirrored
