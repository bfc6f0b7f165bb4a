"""The detection of stated motion that contradicts its places (METHOD 4.3b).

The bounds are those of live states (ssp_core.safety.window); here the whole recording is known, so
that one delay is fitted to all of it, and each window is judged. Windows are of half a second, or
longer until they hold three samples; a way is the chord between their ends. A step of more than
half a second is a gap: no window spans it, and what can have happened in it is asked instead.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray, wrap_angles
from ssp_core.safety.consistency import (
    AXES_SHARE,
    DIRECTION_MPS,
    LEAST_WAY_M,
    direction_bound_rad,
)
from ssp_core.safety.delays import DELAYS_S
from ssp_core.safety.window import (
    EMPTY_TWIST,
    LEAST_SAMPLES,
    SPEED_MPS,
    SPEED_SHARE,
    TURNED,
    WINDOW_S,
    Window,
    kind_of,
)
from ssp_core.vocabulary import ObjectClass

# A vehicle moves across its heading by at most this share of its speed, or SPEED_MPS.
SIDEWAYS_SHARE = 0.1
VEHICLES = (ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS, ObjectClass.MOTORCYCLE)
# A step leaps if it is longer than both: this many times the way at the larger speed, and this.
LEAP_SHARE = 1.5
LEAP_M = 0.5
# A direction may need a longer window.
_LONGEST_S = 1.0
# A step of more than this, and of more than three usual ones, is a gap.
_GAP_S = 0.5
_GAP_STEPS = 3.0
# A clock that steps by less isn't told from stamps that tremble.
_CLOCK_STEP_S = 0.1
# Nobody brakes or speeds up harder.
_HARDEST_MPS2 = 10.0
# After a longer gap any way may have been driven.
_LONGEST_GAP_S = 3.0
# Noise of places beyond this isn't believed.
_NOISE_M = 0.5
# Of sound recordings with independent deviations, at the most, for each check.
_FALSE_ALARMS = 1e-3
# A delay that leaves more than this share of what is off without it explains nothing.
_UNEXPLAINED = 0.25
# From this share of its windows on a contradiction is one of the whole recording.
_WHOLE_SHARE = 0.8

Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
Name = Literal["clock_step", "leap", "heading", "speed", "sideways"]


@dataclass(frozen=True)
class Course:
    """The motion of one object, one entry a sample.

    Args:
        t_s: rising.
        xy_m: of the point that is judged, shape (n, 2).
        reported_xy_m: of the point that the source reports.
        yaw_rad: None: the source has none.
        speed_mps: along the yaw; None: the source has none.
    """

    object_class: ObjectClass
    t_s: FloatArray
    xy_m: FloatArray
    reported_xy_m: FloatArray
    yaw_rad: FloatArray | None
    speed_mps: FloatArray | None


@dataclass(frozen=True)
class Contradiction:
    """A stretch in which states and places don't agree.

    Args:
        first: number of the first sample of it; last: of the last one.
        is_whole: it is nearly all of the motion.
        stretches: how many of this kind there are; this is the first one.
        stated: what the source says in the worst window, or in a usual one of the whole recording.
        way: what its places say there.
        why: what explains it best; empty: nothing does.
        factors: of a speed in the whole recording, the least and the most that all stated speeds
            together can be of the way; None: of another contradiction.
    """

    name: Name
    first: int
    last: int
    is_whole: bool
    stretches: int
    stated: float
    way: float
    why: str = ""
    factors: tuple[float, float] | None = None


def contradictions(course: Course) -> list[Contradiction]:
    """Give the first stretch of each kind of contradiction; of those that overlap the clearest."""
    judge = _Judge(course)
    candidates: list[list[Contradiction]] = [
        judge.clock_steps(),
        judge.leaps(),
        judge.headings(),
        judge.speeds(),
        judge.sideways(),
    ]
    distinct_stretches: list[Contradiction] = []
    for stretches in candidates:
        distinct_stretches += [
            one
            for one in stretches
            if not any(_explains(course, other, one) for other in distinct_stretches)
        ]
    firsts: dict[str, Contradiction] = {}
    for one in distinct_stretches:
        firsts.setdefault(one.name, one)
    counts = {name: sum(one.name == name for one in distinct_stretches) for name in firsts}
    return [replace(one, stretches=counts[one.name]) for one in firsts.values()]


def _explains(course: Course, one: Contradiction, other: Contradiction) -> bool:
    """Return True where a contradiction causes another one, which is at most beside it."""
    t_s = course.t_s
    window_s = max(WINDOW_S, LEAST_SAMPLES * float(np.median(np.diff(t_s))))
    if t_s[one.first] > t_s[other.last] + window_s or t_s[other.first] > t_s[one.last] + window_s:
        return False
    beside_s = 2.0 * (_LONGEST_S if other.name == "sideways" else window_s)
    lasts = [t_s[c.last] - t_s[c.first] for c in (one, other)]
    return bool(lasts[1] <= lasts[0] + beside_s + 1e-9)


def noise_m(t_s: FloatArray, xy_m: FloatArray) -> float:
    """Estimate the standard deviation of places along an axis, by what no motion explains.

    Third differences are free of a constant acceleration; their variance is 20 times that of
    independent deviations.
    """
    if len(t_s) < 8:
        return 0.0
    steps = np.diff(t_s)
    even = np.abs(steps / np.median(steps) - 1.0) < 0.5
    runs = even[:-2] & even[1:-1] & even[2:]
    if runs.sum() < LEAST_SAMPLES:
        return 0.0
    third = np.diff(xy_m, n=3, axis=0)[runs]
    spread = 1.4826 * np.median(np.abs(third - np.median(third, axis=0)), axis=0)
    return min(float(spread.max()) / math.sqrt(20.0), _NOISE_M)


def _farthest_m(std_m: float, number: int) -> float:
    """Give how far apart noise sets two places in no more than one of a thousand recordings.

    The distance of two places is Rayleigh distributed; there are as many of them as samples.
    """
    return math.sqrt(2.0) * std_m * math.sqrt(2.0 * math.log(number / _FALSE_ALARMS))


class _Judge:
    def __init__(self, course: Course) -> None:
        self._course = course
        self._t = t = course.t_s
        self._steps_s = np.diff(t)
        self._usual_s = float(np.median(self._steps_s))
        self._noise_m = _farthest_m(noise_m(t, course.xy_m), len(t))
        self._gaps = self._steps_s > max(_GAP_S, _GAP_STEPS * self._usual_s)
        self._part = np.concatenate([[0], np.cumsum(self._gaps)])
        self._step_m = np.linalg.norm(np.diff(course.xy_m, axis=0), axis=1)
        self._first, self._last = self._windows(WINDOW_S)
        self._odo = None if course.speed_mps is None else _integral(t, course.speed_mps)
        self._yaw = None if course.yaw_rad is None else np.unwrap(course.yaw_rad)
        self._turn = None if self._yaw is None else _integral(t, self._yaw)
        self._speed_delay_s = self._yaw_delay_s = 0.0
        if self._odo is not None:
            self._speed_delay_s = self._delay(self._speed_off)

    # -- windows -------------------------------------------------------------------------------

    def _windows(self, length_s: float) -> tuple[Ints, Ints]:
        """Give the first and last sample of each window that ends with a sample."""
        last = np.arange(len(self._t))
        first = np.searchsorted(self._t, self._t - length_s + 1e-9, side="right") - 1
        first = np.minimum(first, last - (LEAST_SAMPLES - 1))
        fits = first >= 0
        first, last = first[fits], last[fits]
        fits = self._part[first] == self._part[last]
        return first[fits], last[fits]

    def _chord(self, first: Ints, last: Ints) -> tuple[FloatArray, FloatArray]:
        """Give span and chord of windows, shapes (n,) and (n, 2)."""
        span: FloatArray = self._t[last] - self._t[first]
        chord: FloatArray = self._course.xy_m[last] - self._course.xy_m[first]
        return span, chord

    def _mean(self, integral: FloatArray, first: Ints, last: Ints, delay_s: float) -> FloatArray:
        """Give the mean of a column over windows, older by a delay; its ends are carried on."""
        begin, end = self._t[first], self._t[last]
        means: FloatArray = (integral[last] - integral[first]) / (end - begin)
        if delay_s != 0.0:
            late = self._at(integral, end - delay_s) - self._at(integral, begin - delay_s)
            means = late / (end - begin)
        return means

    def _at(self, integral: FloatArray, t_s: FloatArray) -> FloatArray:
        """Give an integral between two samples, or beyond the first or last one."""
        t = self._t
        integrals: FloatArray = np.interp(t_s, t, integral)
        rates = np.diff(integral[[0, 1, -2, -1]])[[0, 2]] / np.diff(t[[0, 1, -2, -1]])[[0, 2]]
        integrals += rates[0] * np.minimum(t_s - t[0], 0.0) + rates[1] * np.maximum(
            t_s - t[-1], 0.0
        )
        return integrals

    def _delay(self, off: Callable[[float], Bools]) -> float:
        """Give the one delay that explains nearly all windows that are off; 0: none does."""
        without = int(off(0.0).sum())
        if not without:
            return 0.0
        best = min(sorted(DELAYS_S, key=abs), key=lambda delay_s: int(off(delay_s).sum()))
        return best if off(best).sum() <= _UNEXPLAINED * without else 0.0

    # -- speeds --------------------------------------------------------------------------------

    def _speed_window(self, delay_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Give stated speed, speed of the way and what they may differ by."""
        span, chord = self._chord(self._first, self._last)
        way = np.linalg.norm(chord, axis=1) / span
        if self._odo is None:
            return way, way, np.full(len(way), np.inf)
        stated = self._mean(self._odo, self._first, self._last, delay_s)
        larger = np.maximum(np.abs(stated), way)
        bound = np.maximum(np.maximum(SPEED_SHARE * larger, SPEED_MPS), self._noise_m / span)
        return stated, way, bound

    def _speed_off(self, delay_s: float) -> Bools:
        stated, way, bound = self._speed_window(delay_s)
        off: Bools = np.abs(np.abs(stated) - way) > bound
        return off

    def speeds(self) -> list[Contradiction]:
        """Hold stated speeds against the way."""
        if self._course.speed_mps is None:
            return []
        stated, way, bound = self._speed_window(self._speed_delay_s)
        excess = np.abs(np.abs(stated) - way)
        off = excess > bound
        moves = np.maximum(np.abs(stated), way) > SPEED_MPS
        stretches = self._stretches(
            "speed",
            off,
            self._first,
            self._last,
            excess,
            stated,
            way,
            is_whole=_share(off[moves]) > _WHOLE_SHARE,
            off_at=self._sample_speed_off(),
        )
        factors = self._speed_factors(moves) if stretches else None
        return [replace(one, factors=factors) if one.is_whole else one for one in stretches]

    def _speed_factors(self, moves: Bools) -> tuple[float, float] | None:
        """Give the range of stated speeds to the way, all in all, with each delay that may be."""
        ratios = []
        for delay_s in DELAYS_S:
            stated, way, _ = self._speed_window(delay_s)
            if (whole := float(way[moves].sum())) > 0.0:
                ratios.append(float(np.abs(stated[moves]).sum()) / whole)
        return (min(ratios), max(ratios)) if ratios else None

    def _sample_speed_off(self) -> Bools:
        """Say of each sample whether its speed contradicts the way to the next one."""
        stated = np.abs(self._course.speed_mps) if self._course.speed_mps is not None else 0.0
        way = self._step_m / self._steps_s
        way = np.append(way, way[-1:])
        noise = self._noise_m / np.append(self._steps_s, self._steps_s[-1:])
        bound = np.maximum(np.maximum(SPEED_SHARE * np.maximum(stated, way), SPEED_MPS), noise)
        off: Bools = np.abs(stated - way) > bound
        return off

    # -- directions ----------------------------------------------------------------------------

    def _directions(self) -> tuple[Ints, Ints]:
        """Give the windows whose way is long enough to say where the object goes."""
        windows: list[tuple[Ints, Ints]] = []
        has_window = np.zeros(len(self._t), dtype=bool)
        for length_s in (WINDOW_S, _LONGEST_S):
            first, last = self._windows(length_s)
            span, chord = self._chord(first, last)
            way_m = np.linalg.norm(chord, axis=1)
            tells = (way_m >= max(LEAST_WAY_M, 2.0 * self._noise_m)) & (
                way_m > DIRECTION_MPS * span
            )
            if self._odo is not None:
                stated = self._mean(self._odo, first, last, self._speed_delay_s)
                tells &= np.abs(stated) >= SPEED_MPS
            tells &= ~has_window[last]
            has_window[last[tells]] = True
            windows.append((first[tells], last[tells]))
        first = np.concatenate([one for one, _ in windows])
        last = np.concatenate([other for _, other in windows])
        order = np.argsort(last, kind="stable")
        return first[order], last[order]

    def _turned(self, first: Ints, last: Ints, delay_s: float) -> FloatArray:
        """Give how far the way lies to the left of the yaw, by the sign of the speed."""
        if self._turn is None:
            return np.zeros(len(first))
        _, chord = self._chord(first, last)
        course = np.arctan2(chord[:, 1], chord[:, 0])
        if self._odo is not None:
            stated = self._mean(self._odo, first, last, self._speed_delay_s)
            course = course + math.pi * (stated < 0.0)
        turned: FloatArray = wrap_angles(course - self._mean(self._turn, first, last, delay_s))
        return turned

    def _direction_bound(self, first: Ints, last: Ints) -> FloatArray:
        _, chord = self._chord(first, last)
        noise = np.arctan2(self._noise_m, np.linalg.norm(chord, axis=1))
        bound: FloatArray = np.maximum(direction_bound_rad(self._course.object_class), noise)
        return bound

    def headings(self) -> list[Contradiction]:
        """Hold yaws against the direction of the way; fits their delay."""
        if self._turn is None:
            return []
        first, last = self._directions()
        bound = self._direction_bound(first, last)

        def off(delay_s: float) -> Bools:
            mask: Bools = np.abs(self._turned(first, last, delay_s)) > bound
            return mask

        def any_off(delay_s: float) -> Bools:
            return off(delay_s) | self._sideways_off(first, last, delay_s)[0]

        self._yaw_delay_s = self._delay(any_off)
        turned = self._turned(first, last, self._yaw_delay_s)
        is_off = off(self._yaw_delay_s)
        return self._stretches(
            "heading",
            is_off,
            first,
            last,
            np.abs(turned),
            np.degrees(turned),
            np.zeros(len(first)),
            is_whole=_share(is_off) > _WHOLE_SHARE,
            off_at=self._sample_heading_off(),
        )

    def _sample_heading_off(self) -> Bools:
        """Say of each sample whether its yaw contradicts the way to the next one."""
        step = np.diff(self._course.xy_m, axis=0)
        course = np.arctan2(step[:, 1], step[:, 0])
        if self._yaw is None:
            return np.zeros(len(self._t), dtype=bool)
        if self._course.speed_mps is not None:
            course = course + math.pi * (self._course.speed_mps[:-1] < 0.0)
        noise = np.arctan2(self._noise_m, np.maximum(self._step_m, 1e-9))
        off = np.abs(wrap_angles(course - self._yaw[:-1])) > np.maximum(
            direction_bound_rad(self._course.object_class), noise
        )
        return np.append(off, off[-1:])

    def _sideways_off(
        self, first: Ints, last: Ints, delay_s: float
    ) -> tuple[Bools, FloatArray, FloatArray]:
        """Say where a vehicle moves across its heading; with speeds across and bounds."""
        span, chord = self._chord(first, last)
        way = np.linalg.norm(chord, axis=1) / span
        across = np.abs(np.sin(self._turned(first, last, delay_s))) * way
        bound = np.maximum(np.maximum(SIDEWAYS_SHARE * way, SPEED_MPS), self._noise_m / span)
        off: Bools = across > bound
        if self._course.object_class not in VEHICLES:
            off = np.zeros(len(first), dtype=bool)
        return off, across, way

    def sideways(self) -> list[Contradiction]:
        """Hold the way of a vehicle against its heading; after ``headings``."""
        if self._turn is None:
            return []
        first, last = self._directions()
        off, across, way = self._sideways_off(first, last, self._yaw_delay_s)
        return self._stretches(
            "sideways",
            off,
            first,
            last,
            across,
            across,
            way,
            is_whole=_share(off) > _WHOLE_SHARE,
        )

    # -- steps ---------------------------------------------------------------------------------

    def _speeds_at_steps(self) -> tuple[FloatArray, FloatArray]:
        """Give the speeds before and after each step, stated or by the steps beside it."""
        if self._course.speed_mps is not None:
            speed = np.abs(self._course.speed_mps)
            return speed[:-1], speed[1:]
        way = self._step_m / self._steps_s
        return np.append(way[:1], way[:-1]), np.append(way[1:], way[-1:])

    def clock_steps(self) -> list[Contradiction]:
        """Find steps of the stamps that the places don't make."""
        before, after = self._speeds_at_steps()
        steps_s, step_m, usual_s = self._steps_s, self._step_m, self._usual_s
        mean = (before + after) / 2.0
        # A change of speed within the step, at its hardest.
        slack_m = _HARDEST_MPS2 * np.minimum(steps_s, _LONGEST_GAP_S) ** 2 / 8.0
        bound_m = np.maximum(SPEED_SHARE * mean, SPEED_MPS) * steps_s + slack_m + self._noise_m
        short = mean * steps_s - step_m > bound_m
        long = steps_s >= max(2.0 * usual_s, usual_s + _CLOCK_STEP_S)
        usual_m = LEAP_SHARE * np.maximum(before, after) * usual_s + self._noise_m
        as_usual = (step_m <= usual_m) & (np.minimum(before, after) > DIRECTION_MPS)
        believable = as_usual | (steps_s <= _LONGEST_GAP_S)
        # Within half a second the windows say whether it matters.
        window_off = np.zeros(len(self._t), dtype=bool)
        if self._odo is not None:
            for a, b in self._off_windows():
                window_off[a : b + 1] = True
        matters = self._gaps | (window_off[:-1] & window_off[1:] & as_usual)
        at = np.flatnonzero(long & short & believable & (matters | (self._odo is None)))
        return [
            Contradiction(
                "clock_step",
                int(i),
                int(i) + 1,
                False,
                1,
                float(mean[i]),
                float(step_m[i] / steps_s[i]),
                "a step of the clock?" if as_usual[i] else "",
            )
            for i in at
        ]

    def _off_windows(self) -> list[tuple[int, int]]:
        off = self._speed_off(self._speed_delay_s)
        return list(zip(self._first[off].tolist(), self._last[off].tolist(), strict=True))

    def leaps(self) -> list[Contradiction]:
        """Find steps that no speed beside them explains."""
        before, after = self._speeds_at_steps()
        way = np.pad(self._step_m / self._steps_s, 2, mode="edge")
        around = np.median(np.lib.stride_tricks.sliding_window_view(way, 5), axis=1)
        larger = np.maximum(np.maximum(before, after), around)
        if self._course.speed_mps is None:
            larger = around
        bound = np.maximum(LEAP_SHARE * larger * self._steps_s, LEAP_M) + self._noise_m
        reported = np.linalg.norm(np.diff(self._course.reported_xy_m, axis=0), axis=1)
        # A heading that turns moves the point that is judged, not the one that is reported.
        at = np.flatnonzero(np.minimum(self._step_m, reported) > bound)
        return [
            Contradiction(
                "leap", int(i), int(i) + 1, False, 1, float(larger[i]), float(self._step_m[i])
            )
            for i in at
        ]

    # -- stretches -----------------------------------------------------------------------------

    def _stretches(
        self,
        name: Name,
        off: Bools,
        first: Ints,
        last: Ints,
        excess: FloatArray,
        stated: FloatArray,
        way: FloatArray,
        *,
        is_whole: bool,
        off_at: Bools | None = None,
    ) -> list[Contradiction]:
        """Join windows that are off and overlap; their ends are where single samples agree."""
        stretches: list[Contradiction] = []
        group: list[int] = []
        for i in [*np.flatnonzero(off).tolist(), -1]:
            if group and (i < 0 or first[i] > last[group[-1]]):
                # The worst window; of a contradiction of the whole recording the usual one.
                order = np.argsort(excess[group], kind="stable")
                worst = group[int(order[len(order) // 2 if is_whole else -1])]
                a, b = self._ends(int(first[group[0]]), int(last[group[-1]]), off_at)
                stretches.append(
                    Contradiction(
                        name,
                        a,
                        b,
                        is_whole,
                        1,
                        float(stated[worst]),
                        float(way[worst]),
                        self._why(int(first[worst]), int(last[worst])),
                    )
                )
                group = []
            group.append(i)
        return stretches

    def _ends(self, first: int, last: int, off_at: Bools | None) -> tuple[int, int]:
        if off_at is None or not off_at[first : last + 1].any():
            return first, last
        at = first + np.flatnonzero(off_at[first : last + 1])
        return int(at[0]), int(at[-1])

    def _why(self, first: int, last: int) -> str:
        """Name the mistake that explains a window best."""
        if self._odo is None or self._turn is None:
            return ""
        one, other = np.array([first]), np.array([last])
        span, chord = self._chord(one, other)
        window = Window(
            float(span[0]),
            float(chord[0, 0] / span[0]),
            float(chord[0, 1] / span[0]),
            float(self._mean(self._odo, one, other, 0.0)[0]),
            float(self._mean(self._turn, one, other, 0.0)[0]),
        )
        speeds: Sequence[float] = (
            ()
            if self._course.speed_mps is None
            else np.abs(self._course.speed_mps[first : last + 1]).tolist()
        )
        bound = direction_bound_rad(self._course.object_class)
        why = kind_of(window, max(speeds, default=0.0), bound, signed=True)
        # Of a unit or another frame a whole recording is, not a stretch of it.
        return why if why in (EMPTY_TWIST, TURNED) else ""


def _integral(t_s: FloatArray, values: FloatArray) -> FloatArray:
    """Integrate a column from the first sample on."""
    steps = (values[1:] + values[:-1]) / 2.0 * np.diff(t_s)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _share(off: Bools) -> float:
    return float(off.mean()) if len(off) else 0.0


def twist_in_parent_axes(
    t_s: FloatArray, xy_m: FloatArray, yaw_rad: FloatArray, twist_mps: FloatArray
) -> tuple[float, float, int] | None:
    """Find where a twist that should be along the object's axes fits those of its poses' frame.

    Args:
        t_s: times of the samples, s, rising.
        xy_m: in the frame of the poses, of the point that is reported; shape (n, 2).
        yaw_rad: heading in that frame, rad.
        twist_mps: forwards and to the left as stated, shape (n, 2).

    Returns:
        Speed left over with the object's axes, with those of the parent, m/s, medians of the
        windows in which they differ, and the first sample of these; None: it fits as it should.
    """
    judge = _Judge(Course(ObjectClass.CAR, t_s, xy_m, xy_m, None, None))
    first, last = judge._first, judge._last
    if not len(first):
        return None
    span, chord = judge._chord(first, last)
    way = chord / span[:, None]
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    ahead, left = twist_mps.T
    columns = (c * ahead - s * left, s * ahead + c * left, ahead, left)
    means = [judge._mean(_integral(t_s, column), first, last, 0.0) for column in columns]
    own = np.hypot(means[0] - way[:, 0], means[1] - way[:, 1])
    parent = np.hypot(means[2] - way[:, 0], means[3] - way[:, 1])
    differ = np.hypot(means[0] - means[2], means[1] - means[3])
    larger = np.maximum(np.linalg.norm(way, axis=1), np.hypot(means[2], means[3]))
    bound = np.maximum(np.maximum(AXES_SHARE * larger, SPEED_MPS), judge._noise_m / span)
    # With a yaw that doesn't fit the way itself, no twist would.
    course = np.arctan2(way[:, 1], way[:, 0])
    yaw = judge._mean(_integral(t_s, np.unwrap(yaw_rad)), first, last, 0.0)
    course = course + math.pi * ((np.cos(course - yaw) < 0.0) & (means[2] < 0.0))
    agrees = np.abs(wrap_angles(course - yaw)) <= direction_bound_rad(ObjectClass.CAR)
    tells = (larger > DIRECTION_MPS) & (differ > bound)
    off = tells & agrees & (own > bound) & (parent < own / 2.0)
    if not off.any() or off.sum() <= tells.sum() / 2:
        return None
    return float(np.median(own[off])), float(np.median(parent[off])), int(first[off][0])
