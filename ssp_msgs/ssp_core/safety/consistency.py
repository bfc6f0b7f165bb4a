"""The motion that an object states, held against its places (METHOD 4.3b).

A source that gives the twist in other axes than it says, another unit, another heading or no twist
at all contradicts itself as soon as its object moves. Each window of places gives a way: the chord
between its ends. Stated speed and yaw must fit it, after one constant delay of each against the
places (ssp_core.safety.delays). Reads no clock, and needs no state of an object: recordings are
judged by the same rules.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety.delays import DELAYS_S, Delays
from ssp_core.safety.window import (
    LEAST_SAMPLES,
    MAP_AXES,
    SPEED_MPS,
    UNSTEADY_DELAY,
    WINDOW_S,
    Window,
    kind_of,
    speed_bound_mps,
)
from ssp_core.vocabulary import ObjectClass

# A twist that fits map axes is told from here on.
AXES_SHARE = 0.1
# A direction needs so long a way and counts above so fast a motion.
LEAST_WAY_M = 1.0
DIRECTION_MPS = 1.0
DIRECTION_RAD = math.radians(20.0)
_DIRECTION_RAD = {
    ObjectClass.CYCLIST: math.radians(30.0),
    ObjectClass.PEDESTRIAN: math.radians(60.0),
}
# Three sigma of the distance between two places.
SIGMAS = 3.0 * math.sqrt(2.0)
# A contradiction ends a session when it holds for so long on end; a shorter one is kept in mind
# from so many windows on: single places may be wrong by more than three sigma.
HOLDS_S = 0.5
_DOUBT_S = 0.1
_DOUBT_WINDOWS = 3
# A place that steps again so soon after it stepped doesn't step: it moves.
_STEP_APART_S = 1.0
# Without a state for longer than this a window begins anew.
_PAUSE_S = 0.5
# A stamp that lies so far before the newest one comes of a clock that was set back.
_SET_BACK_S = 1.0
# So much is remembered.
_REMEMBERED_S = 3.0
# A window this near to its bound, or beyond it, is worth a look before a day on the track.
NEAR_SHARE = 0.8


def direction_bound_rad(object_class: ObjectClass) -> float:
    """Give how far the way of an object may lead off its yaw."""
    return _DIRECTION_RAD.get(object_class, DIRECTION_RAD)


@dataclass(frozen=True, slots=True)
class Bounds:
    """The bounds by which an object's stated motion is judged.

    Args:
        direction_rad: between its yaw and the way that it goes; None: not judged.
        signed: the sign of its speed says whether it goes forwards; False: it may go either way.
        jump_m: a place may step so far at once, as corrections of a receiver do.
        position_std_m: no place counts as less certain than this.
        pause_s: between two states of one window.
    """

    direction_rad: float | None = DIRECTION_RAD
    signed: bool = True
    jump_m: float = 1.0
    position_std_m: float = 0.5
    pause_s: float = _PAUSE_S

    @staticmethod
    def of(object_id: str, object_class: ObjectClass, limits: Limits) -> Bounds:
        """Give the bounds of an object on a site."""
        any_way = object_id in limits.omnidirectional
        return Bounds(
            None if any_way else direction_bound_rad(object_class),
            object_class is not ObjectClass.PEDESTRIAN,
            limits.jump_m,
            limits.position_std_m,
            max(_PAUSE_S, 1.5 * limits.state_age_s),
        )


@dataclass(frozen=True, slots=True)
class Contradiction:
    """Windows on end in which what is stated doesn't fit the places.

    Args:
        kind: what explains it best, for people.
        text: kind, with the newest window's figures.
        held_s: from the first of them to the newest.
        windows: how many.
        moving: the object moved meanwhile, by its places.
    """

    kind: str
    text: str
    held_s: float
    windows: int
    moving: bool

    @property
    def holds(self) -> bool:
        """It has held long enough to end a session."""
        return self.held_s >= HOLDS_S


_NEVER = Contradiction("", "", 0.0, 0, False)


class _Sample(NamedTuple):
    """One state; a tuple, since one is made for each state of each object.

    Args:
        t_s: since the first.
        yaw_rad: without jumps by a whole turn.
        way_m: integral of the stated speed.
        turn_rads: integral of the yaw.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    std_m: float
    way_m: float
    turn_rads: float


class ConsistencyWatch:
    """The states of one object, as they come; each is judged by those before it.

    Attributes:
        contradiction: of the newest windows; None: they agree, or there is none yet.
        doubt: the last contradiction, until the same object has moved without one for as long as
            a contradiction takes to hold.
        windows: judged so far; moving_windows: those of them in which it moved.
        near_misses: windows of them that came near to their bound, or passed it.
        nearest: the largest share of its bound that a window reached.
    """

    def __init__(self, bounds: Bounds) -> None:
        self.windows = self.moving_windows = self.near_misses = 0
        self.nearest = 0.0
        self._bounds = bounds
        self._direction_rad = bounds.direction_rad
        self._least_cosine = math.cos(NEAR_SHARE * (bounds.direction_rad or 0.0))
        self.clear()

    def clear(self) -> None:
        """Forget all states."""
        self.contradiction: Contradiction | None = None
        self.doubt: Contradiction | None = None
        self._zero_ns = 0
        self._t: list[float] = []
        self._samples: list[_Sample] = []
        self._begin = self._speed_from = self._way_from = 0
        self._since = 0.0
        self._kinds: dict[str, float] = {}
        self._speed_delays, self._yaw_delays = Delays(), Delays()
        self._fits_alone = False  # a delay fits the newest window, and didn't fit those before
        self._agrees_since: float | None = None
        self._stepped_s = -math.inf

    # -- what arrives --------------------------------------------------------------------------

    def see(self, state: ObjectState) -> None:
        """Take a state whose values are finite; see ``take``."""
        self.take(
            state.stamp_ns,
            state.x_m,
            state.y_m,
            state.yaw_rad,
            state.speed_mps,
            state.position_std_m,
        )

    def take(
        self,
        stamp_ns: int,
        x_m: float,
        y_m: float,
        yaw_rad: float,
        speed_mps: float,
        position_std_m: float = 0.0,
    ) -> None:
        """Judge a state by those before it; an older one has no effect.

        Args:
            stamp_ns: of the state.
            x_m: place of the reference point, under the rear axle of a vehicle, m.
            y_m: see x_m.
            yaw_rad: of the object, counter-clockwise.
            speed_mps: along the yaw, backwards is negative; all values are finite.
            position_std_m: as stated; not finite: unknown.
        """
        if self._t:
            t = ns_to_seconds(stamp_ns - self._zero_ns)
            if t <= self._t[-1]:
                if self._t[-1] - t <= _SET_BACK_S:
                    return
                self.clear()
        if not self._t:
            self._zero_ns, t = stamp_ns, 0.0
        self._append(t, x_m, y_m, yaw_rad, speed_mps, position_std_m)
        self._judge()

    def _append(
        self, t: float, x_m: float, y_m: float, yaw_rad: float, speed_mps: float, std_m: float
    ) -> None:
        most, samples = self._bounds.position_std_m, self._samples
        way = turn = 0.0
        if samples:
            last_t, _, _, last_yaw, last_speed, _, way, turn = samples[-1]
            yaw_rad = last_yaw + math.remainder(yaw_rad - last_yaw, math.tau)
            dt = t - last_t
            way += 0.5 * (last_speed + speed_mps) * dt
            turn += 0.5 * (last_yaw + yaw_rad) * dt
            if dt > self._bounds.pause_s:
                self._restart(len(samples))
        std_m = std_m if std_m <= most else most
        samples.append(_Sample(t, x_m, y_m, yaw_rad, speed_mps, std_m, way, turn))
        self._t.append(t)
        # Now and then, so that it costs nothing.
        if len(samples) >= 64 and self._t[len(samples) // 2] < t - _REMEMBERED_S:
            self._forget(len(samples) // 2)

    def _forget(self, number: int) -> None:
        del self._t[:number], self._samples[:number]
        self._begin = max(self._begin - number, 0)
        self._speed_from = max(self._speed_from - number, 0)
        self._way_from = max(self._way_from - number, 0)

    def _restart(self, at: int) -> None:
        """Let windows begin with the sample of this number at the earliest."""
        self._begin = self._speed_from = self._way_from = at
        self.contradiction = None
        self._agrees_since = None
        self._speed_delays.begin_anew()
        self._yaw_delays.begin_anew()

    # -- judgement -----------------------------------------------------------------------------

    def _judge(self) -> None:
        n = len(self._t) - 1
        start = self._window_start(n)
        if start is None:
            return
        self.windows += 1
        share, moves, off = self._share(start, n)
        self.moving_windows += moves
        if off and share <= 1.0 and self._in_map_axes(start, n):
            self._contradicts(self._window(start, n), MAP_AXES)
            return
        if share > NEAR_SHARE:
            self.near_misses += 1
            self.nearest = max(self.nearest, share)
        if share <= 1.0 and self._speed_delays.is_at_rest and self._yaw_delays.is_at_rest:
            self._agrees(moves)
            return
        found = None
        if share <= 1.0 and self._fits_as_before(start):
            self._speed_delays.begin_anew()
            self._yaw_delays.begin_anew()
        else:
            found = self._found(start, n)
        if share <= 1.0:
            self._take_for_now(found, moves)
        elif found is None:
            # Only a delay explains it: no proof that the last contradiction is mended.
            self.contradiction = self._agrees_since = None
        elif not self._steps(start if self._direction_rad is None else self._way_from, n):
            kind = UNSTEADY_DELAY if self._fits_alone else self._kind(found)
            self._contradicts(found, kind)

    def _fits_as_before(self, start: int) -> bool:
        """Tell whether a window that fits without a delay fits with the believed one, if any."""
        if self._yaw_delays.believed_s != 0.0:
            return False  # Rare, and its window is another.
        delay_s = self._speed_delays.believed_s
        if delay_s == 0.0:
            return True
        window = self._shifted(start, delay_s)
        if window is None:
            return True
        return abs(window.speed_excess_mps) <= self._speed_bound(window, start)

    def _take_for_now(self, found: Window | None, moves: bool) -> None:
        """Take a window that fits without a delay, and maybe not with the one of those before."""
        if found is not None:
            self._contradicts(found, UNSTEADY_DELAY)
        else:
            self._agrees(moves)

    def _share(self, start: int, n: int) -> tuple[float, bool, bool]:
        """Give the larger share of their bounds that speed and direction reach, without a delay.

        Spelt out in numbers: it is asked for each state of each object.

        Returns:
            The share; whether the object moves, as it says or by its places; and whether its speed
            is off by more than AXES_SHARE.
        """
        t0, x0, y0, _, _, std0, way0, turn0 = self._samples[start]
        t1, x1, y1, _, _, std1, way1, turn1 = self._samples[n]
        span = t1 - t0
        dx, dy = x1 - x0, y1 - y0
        way = math.hypot(dx, dy) / span
        speed = (way1 - way0) / span
        stated = abs(speed)
        larger = stated if stated > way else way
        noise = max(std0, std1) * SIGMAS / span
        excess = abs(stated - way)
        share = excess / speed_bound_mps(larger, larger, noise)
        off = excess > SPEED_MPS and excess > AXES_SHARE * larger and excess > noise
        moves = larger >= DIRECTION_MPS
        if not moves or self._direction_rad is None:
            return share, moves, False
        if way * span < LEAST_WAY_M:
            window = self._direction_window(start, n)
            turned = 0.0 if window is None else self._direction_share(window, self._way_from)
            return max(share, turned), moves, off
        self._way_from = start
        if self._bounds.signed and stated < SPEED_MPS:
            return share, moves, off
        yaw = (turn1 - turn0) / span
        c, s = math.cos(yaw), math.sin(yaw)
        along = c * dx + s * dy
        if speed < 0.0 or not self._bounds.signed:
            along = -along if self._bounds.signed else abs(along)
        if along > self._least_cosine * way * span or noise >= way:
            return share, moves, off
        return max(share, self._direction_share(self._window(start, n), start)), moves, off

    def _in_map_axes(self, start: int, n: int) -> bool:
        """Tell whether the twist fits the parent's frame, and with no delay the object's.

        It may be off by less than a speed may be: on a road that leads a little off the map's x.
        """
        window = self._window(start, n)
        if abs(window.speed_mps - window.vx_mps) >= 0.5 * abs(window.speed_excess_mps):
            return False
        for delay_s in self._speed_delays.possible(self._t[-1]):
            w = self._shifted(start, delay_s)
            if w is None:
                return False
            bound = max(AXES_SHARE * w.way_mps, SPEED_MPS, self._noise_m(start) / w.span_s)
            if abs(w.speed_excess_mps) <= bound:
                return False
        return True

    def _found(self, start: int, n: int) -> Window | None:
        """Give the window in which no delay explains what is stated; None: one does."""
        way = self._direction_window(start, n)
        fast = self._window(start, n)
        is_off = abs(fast.speed_excess_mps) > self._speed_bound(fast, start)
        if self._is_off(self._speed_delays, is_off, start, self._speed_fit(start)):
            return way or fast
        if way is None:
            return None
        first = self._way_from
        is_off = self._direction_share(way, first) > 1.0
        fit = self._direction_fit(first)
        return way if self._is_off(self._yaw_delays, is_off, first, fit) else None

    def _window_start(self, n: int) -> int | None:
        """Give the newest sample from which a window ends now; None: there is none."""
        latest = self._t[n] - WINDOW_S + 1e-9
        first = self._speed_from
        while first + 1 <= n - (LEAST_SAMPLES - 1) and self._t[first + 1] <= latest:
            first += 1
        self._speed_from = first
        fits = first <= n - (LEAST_SAMPLES - 1) and self._t[first] <= latest
        return first if fits else None

    def _window(self, first: int, last: int) -> Window:
        a, b = self._samples[first], self._samples[last]
        span = b.t_s - a.t_s
        return Window(
            span,
            (b.x_m - a.x_m) / span,
            (b.y_m - a.y_m) / span,
            (b.way_m - a.way_m) / span,
            (b.turn_rads - a.turn_rads) / span,
        )

    def _speed_bound(self, window: Window, first: int) -> float:
        noise_mps = self._noise_m(first) / window.span_s
        return speed_bound_mps(window.speed_mps, window.way_mps, noise_mps)

    def _noise_m(self, first: int) -> float:
        return SIGMAS * max(self._samples[first].std_m, self._samples[-1].std_m)

    def _direction_window(self, start: int, n: int) -> Window | None:
        """Give the shortest window that is long enough to say where the object goes, if any."""
        if self._direction_rad is None:
            return None
        first = min(self._way_from, start)
        while first < start and self._chord_m(first + 1, n) >= LEAST_WAY_M:
            first += 1
        self._way_from = first
        window = self._window(first, n)
        way_m = window.way_mps * window.span_s
        if not (window.way_mps > DIRECTION_MPS and way_m >= LEAST_WAY_M):
            return None
        # Without a speed of which the sign could be told the speed itself is what contradicts.
        if self._bounds.signed and abs(window.speed_mps) < SPEED_MPS:
            return None
        return window if self._noise_m(first) < way_m else None

    def _chord_m(self, first: int, last: int) -> float:
        a, b = self._samples[first], self._samples[last]
        return math.hypot(b.x_m - a.x_m, b.y_m - a.y_m)

    def _direction_share(self, way: Window, first: int) -> float:
        return abs(way.turned_rad(signed=self._bounds.signed)) / self._direction_bound(way, first)

    def _direction_bound(self, way: Window, first: int) -> float:
        noise_rad = math.atan2(self._noise_m(first), way.way_mps * way.span_s)
        return max(self._direction_rad or 0.0, noise_rad)

    # -- a delay between place and motion ------------------------------------------------------

    def _speed_fit(self, first: int) -> Callable[[Window], tuple[float, float]]:
        return lambda w: (w.speed_excess_mps, self._speed_bound(w, first))

    def _direction_fit(self, first: int) -> Callable[[Window], tuple[float, float]]:
        def fit(window: Window) -> tuple[float, float]:
            turned = window.turned_rad(signed=self._bounds.signed)
            return turned, self._direction_bound(window, first)

        return fit

    def _is_off(
        self,
        delays: Delays,
        is_off: bool,
        first: int,
        fit: Callable[[Window], tuple[float, float]],
    ) -> bool:
        """Tell whether no delay that fits the window fitted those before it.

        Args:
            delays: those of the same check; they take the result.
            is_off: it doesn't fit without a delay.
            first: index of the sample with which the window begins.
            fit: gives what is left over, and what may be.
        """
        if delays.believed_s != 0.0:
            window = self._shifted(first, delays.believed_s)
            if window is None:
                return False
            left, bound = fit(window)
            is_off = abs(left) > bound
        if not is_off:
            delays.begin_anew()
            return False
        windows = [w for d in DELAYS_S if (w := self._shifted(first, d)) is not None]
        if len(windows) < len(DELAYS_S):
            # Nobody knows yet.
            return False
        fits = [abs(left) <= bound for left, bound in map(fit, windows)]
        self._fits_alone = any(fits)
        return not delays.take(self._t[-1], fits)

    def _shifted(self, first: int, delay_s: float) -> Window | None:
        """Give the window with its motion, or its places, so much older; both end by now."""
        begin, end = self._t[first], self._t[-1]
        older = abs(delay_s)
        if begin - older < self._t[self._begin]:
            return None
        span = end - begin
        old, new = (begin - older, end - older), (begin, end)
        places, motion = (new, old) if delay_s > 0.0 else (old, new)

        (ax, ay, _, _), (bx, by, _, _) = map(self._at, places)
        (_, _, a_way, a_turn), (_, _, b_way, b_turn) = map(self._at, motion)
        return Window(
            span,
            (bx - ax) / span,
            (by - ay) / span,
            (b_way - a_way) / span,
            (b_turn - a_turn) / span,
        )

    def _at(self, t: float) -> tuple[float, float, float, float]:
        """Give x, y, way and turn between two samples."""
        i = min(max(bisect_right(self._t, t) - 1, 0), len(self._t) - 2)
        a, b = self._samples[i], self._samples[i + 1]
        share = (t - a.t_s) / (b.t_s - a.t_s)
        return (
            a.x_m + share * (b.x_m - a.x_m),
            a.y_m + share * (b.y_m - a.y_m),
            a.way_m + share * (b.way_m - a.way_m),
            a.turn_rads + share * (b.turn_rads - a.turn_rads),
        )

    # -- places that step ----------------------------------------------------------------------

    def _steps(self, first: int, n: int) -> bool:
        """Tell whether one step of the place explains what was found.

        Windows then begin after it.

        A receiver that gets a better fix moves its place at once. One that does so again and again
        is one that moves.
        """
        whole = self._window(first, n)
        span, vx, vy = whole.span_s, whole.vx_mps, whole.vy_mps

        def step(k: int) -> tuple[float, float, float]:
            a, b = self._samples[k - 1], self._samples[k]
            return b.t_s - a.t_s, b.x_m - a.x_m, b.y_m - a.y_m

        def off_m(k: int) -> float:
            dt, step_x, step_y = step(k)
            return math.hypot(step_x - vx * dt, step_y - vy * dt)

        k = max(range(first + 1, n + 1), key=off_m)
        dt, step_x, step_y = step(k)
        share = span / (span - dt)
        vx, vy = (vx - step_x / span) * share, (vy - step_y / span) * share
        if math.hypot(step_x - vx * dt, step_y - vy * dt) > self._bounds.jump_m:
            return False
        left = Window(span, vx, vy, whole.speed_mps, whole.yaw_rad)
        excess = abs(left.speed_excess_mps) > self._speed_bound(left, first)
        if excess or (self._judges_direction(left) and self._direction_share(left, first) > 1.0):
            return False
        again = self._t[k] - self._stepped_s < _STEP_APART_S
        self._stepped_s = self._t[k]
        if again:
            return False
        self._restart(k)
        return True

    def _judges_direction(self, window: Window) -> bool:
        if self._direction_rad is None or window.way_mps <= DIRECTION_MPS:
            return False
        return not self._bounds.signed or abs(window.speed_mps) >= SPEED_MPS

    # -- findings ------------------------------------------------------------------------------

    def _agrees(self, moves: bool) -> None:
        now = self._t[-1]
        self.contradiction = None
        doubt = self.doubt
        if doubt is None:
            return
        if doubt.moving and not moves:
            self._agrees_since = None
        elif self._agrees_since is None:
            self._agrees_since = now
        elif now - self._agrees_since >= HOLDS_S:
            self.doubt = None

    def _contradicts(self, window: Window, kind: str) -> None:
        before, now = self.contradiction, self._t[-1]
        if before is None:
            self._since = now
            self._kinds.clear()
        # A delay hides the mistake while the speed changes; the faster the clearer.
        self._kinds[kind] = self._kinds.get(kind, 0.0) + window.way_mps
        kind = max(self._kinds, key=self._kinds.__getitem__)
        self.contradiction = Contradiction(
            kind,
            f"{kind}: {self._figures(window)}",
            now - self._since,
            1 if before is None else before.windows + 1,
            window.way_mps >= DIRECTION_MPS or (before or self.doubt or _NEVER).moving,
        )
        self._agrees_since = None
        found = self.contradiction
        if found.holds:
            # None of them explains what came so far.
            self._speed_delays, self._yaw_delays = Delays(), Delays()
        if found.windows >= _DOUBT_WINDOWS and found.held_s >= _DOUBT_S:
            self.doubt = found

    def _figures(self, window: Window) -> str:
        turned = math.degrees(window.turned_rad(signed=self._bounds.signed))
        text = f"{window.speed_mps:.2f} m/s stated, way of {window.way_mps:.2f} m/s"
        if window.way_mps > DIRECTION_MPS and self._direction_rad is not None:
            text += f" at {turned:+.0f}° to the yaw"
        return f"{text} in {window.span_s:.2f} s"

    def _kind(self, window: Window) -> str:
        newest = self._t[-1] - window.span_s - 1e-9
        fastest = max(abs(one.speed_mps) for one in self._samples if one.t_s >= newest)
        direction_rad = self._direction_rad or DIRECTION_RAD
        return kind_of(window, fastest, direction_rad, signed=self._bounds.signed)

    # -- standstill ----------------------------------------------------------------------------

    def net_way_m(self, span_s: float) -> tuple[float, float]:
        """Give the chord of the last seconds, and how many of them the states cover.

        Returns:
            Way in m and time in s, at most ``span_s``; 0 and 0 where there is no state.
        """
        if not self._t:
            return 0.0, 0.0
        since = self._t[-1] - span_s
        first = max(bisect_right(self._t, since + 1e-9) - 1, 0)
        covered = min(self._t[-1] - self._t[first], span_s)
        return self._chord_m(first, len(self._t) - 1), covered

    @property
    def position_std_m(self) -> float:
        """Return how uncertain the newest place is; no more than counts."""
        return self._samples[-1].std_m if self._samples else 0.0
