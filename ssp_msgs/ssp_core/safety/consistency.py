"""The motion that an object states, held against its places (METHOD 4.3b).

A source that gives the twist in other axes than it says, another unit, another heading or no twist
at all contradicts itself as soon as its object moves. Each window of places gives a way: the chord
between its ends. Stated speed and yaw must fit it, after one constant delay of each against the
places (ssp_core.safety.delays). Reads no clock, and needs no state of an object: recordings are
judged by the same rules.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety.contradiction import Contradiction, MotionFindings
from ssp_core.safety.delays import DELAYS_S, Delays
from ssp_core.safety.samples import SIGMAS, MotionSamples
from ssp_core.safety.window import (
    MAP_AXES,
    OTHER_SPEED,
    SPEED_MPS,
    UNSTEADY_DELAY,
    SpeedFactors,
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
# A place that steps again so soon after it stepped doesn't step: it moves.
_STEP_APART_S = 1.0
# Without a state for longer than this a window begins anew.
_PAUSE_S = 0.5
# A stamp that lies so far before the newest one comes of a clock that was set back.
_SET_BACK_S = 1.0
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


@dataclass(slots=True)
class WindowCounts:
    """The windows that were judged, since the watch was made.

    Args:
        total: how many.
        moving: those of them in which the object moved.
        near_misses: those that came near to their bound, or passed it.
        nearest: the largest share of its bound that one of them reached.
    """

    total: int = 0
    moving: int = 0
    near_misses: int = 0
    nearest: float = 0.0

    def see_share(self, share: float) -> None:
        """Count a window by the share of its bound that it reached."""
        if share > NEAR_SHARE:
            self.near_misses += 1
            self.nearest = max(self.nearest, share)


class ConsistencyWatch:
    """The states of one object, as they come; each is judged by those before it.

    Attributes:
        counts: of the windows that were judged.
    """

    def __init__(self, bounds: Bounds) -> None:
        self.counts = WindowCounts()
        self._bounds = bounds
        self._direction_rad = bounds.direction_rad
        self._least_cosine = math.cos(NEAR_SHARE * (bounds.direction_rad or 0.0))
        self._findings = MotionFindings()
        self.clear()

    def clear(self) -> None:
        """Forget all states; what was counted stays, and so does the doubt."""
        self._samples = MotionSamples(self._bounds.position_std_m, self._bounds.pause_s)
        self._findings.interrupt()
        self._speed_delays, self._yaw_delays = Delays(), Delays()
        self._fits_alone = False  # a delay fits the newest window, and didn't fit those before
        self._stepped_s = -math.inf
        self._factors = SpeedFactors()  # of the present contradiction

    @property
    def contradiction(self) -> Contradiction | None:
        """The contradiction of the newest windows; None: they agree, or there is none yet."""
        return self._findings.contradiction

    @property
    def doubt(self) -> Contradiction | None:
        """The last contradiction, until the object has moved without one for long enough."""
        return self._findings.doubt

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
        lag_s = self._samples.lag_s(stamp_ns)
        if lag_s >= 0.0:
            if lag_s <= _SET_BACK_S:
                return
            self.clear()
        if self._samples.append(stamp_ns, x_m, y_m, yaw_rad, speed_mps, position_std_m):
            self._begin_anew()
        self._judge()

    def _begin_anew(self) -> None:
        """Judge the windows that follow without those before."""
        self._findings.interrupt()
        self._speed_delays.begin_anew()
        self._yaw_delays.begin_anew()

    # -- judgement -----------------------------------------------------------------------------

    def _judge(self) -> None:
        samples = self._samples
        start = samples.window_start()
        if start is None:
            return
        self.counts.total += 1
        share, moves, off = self._share(start)
        self.counts.moving += moves
        if off and share <= 1.0 and self._in_map_axes(start):
            self._contradicts(samples.window(start), MAP_AXES)
            return
        self.counts.see_share(share)
        if share <= 1.0 and self._speed_delays.is_at_rest and self._yaw_delays.is_at_rest:
            self._findings.agree(samples.t_s[-1], moves=moves)
            return
        window, by_speed = None, False
        if share <= 1.0 and self._fits_as_before(start):
            self._speed_delays.begin_anew()
            self._yaw_delays.begin_anew()
        else:
            window, by_speed = self._unexplained_window(start)
        if share <= 1.0:
            self._take_for_now(window, moves)
        elif window is None:
            # Only a delay explains it: no proof that the last contradiction is mended.
            self._findings.interrupt()
        elif not self._steps(start if self._direction_rad is None else samples.way_from):
            kind = UNSTEADY_DELAY if self._fits_alone else self._kind(window, by_speed)
            self._contradicts(window, kind, start)

    def _fits_as_before(self, start: int) -> bool:
        """Tell whether a window that fits without a delay fits with the believed one, if any."""
        if self._yaw_delays.believed_s != 0.0:
            return False  # Rare, and its window is another.
        delay_s = self._speed_delays.believed_s
        if delay_s == 0.0:
            return True
        window = self._samples.shifted(start, delay_s)
        if window is None:
            return True
        return abs(window.speed_excess_mps) <= self._speed_bound(window, start)

    def _take_for_now(self, window: Window | None, moves: bool) -> None:
        """Take a window that fits without a delay, and maybe not with the one of those before."""
        if window is not None:
            self._contradicts(window, UNSTEADY_DELAY)
        else:
            self._findings.agree(self._samples.t_s[-1], moves=moves)

    def _share(self, start: int) -> tuple[float, bool, bool]:
        """Give the larger share of their bounds that speed and direction reach, without a delay.

        Spelt out in numbers: it is asked for each state of each object.

        Returns:
            The share; whether the object moves, as it says or by its places; and whether its speed
            is off by more than AXES_SHARE.
        """
        samples = self._samples
        t0, x0, y0, _, _, std0, way0, turn0 = samples.rows[start]
        t1, x1, y1, _, _, std1, way1, turn1 = samples.rows[-1]
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
            window = self._direction_window(start)
            turned = 0.0 if window is None else self._direction_share(window, samples.way_from)
            return max(share, turned), moves, off
        samples.way_from = start
        if self._bounds.signed and stated < SPEED_MPS:
            return share, moves, off
        yaw = (turn1 - turn0) / span
        c, s = math.cos(yaw), math.sin(yaw)
        along = c * dx + s * dy
        if speed < 0.0 or not self._bounds.signed:
            along = -along if self._bounds.signed else abs(along)
        if along > self._least_cosine * way * span or noise >= way:
            return share, moves, off
        return max(share, self._direction_share(samples.window(start), start)), moves, off

    def _in_map_axes(self, start: int) -> bool:
        """Tell whether the twist fits the parent's frame, and with no delay the object's.

        It may be off by less than a speed may be: on a road that leads a little off the map's x.
        """
        window = self._samples.window(start)
        if abs(window.speed_mps - window.vx_mps) >= 0.5 * abs(window.speed_excess_mps):
            return False
        for delay_s in self._speed_delays.possible(self._samples.t_s[-1]):
            w = self._samples.shifted(start, delay_s)
            if w is None:
                return False
            bound = max(AXES_SHARE * w.way_mps, SPEED_MPS, self._samples.noise_m(start) / w.span_s)
            if abs(w.speed_excess_mps) <= bound:
                return False
        return True

    def _unexplained_window(self, start: int) -> tuple[Window | None, bool]:
        """Give the window in which no delay explains what is stated; None: one does.

        Returns:
            It; and whether it is the speed that no delay explains.
        """
        way = self._direction_window(start)
        fast = self._samples.window(start)
        is_off = abs(fast.speed_excess_mps) > self._speed_bound(fast, start)
        if self._is_off(self._speed_delays, is_off, start, self._speed_fit(start)):
            return way or fast, True
        if way is None:
            return None, False
        first = self._samples.way_from
        is_off = self._direction_share(way, first) > 1.0
        fit = self._direction_fit(first)
        return (way if self._is_off(self._yaw_delays, is_off, first, fit) else None), False

    def _speed_bound(self, window: Window, first: int) -> float:
        noise_mps = self._samples.noise_m(first) / window.span_s
        return speed_bound_mps(window.speed_mps, window.way_mps, noise_mps)

    def _direction_window(self, start: int) -> Window | None:
        """Give the shortest window that is long enough to say where the object goes, if any."""
        if self._direction_rad is None:
            return None
        samples = self._samples
        first = min(samples.way_from, start)
        while first < start and samples.chord_m(first + 1) >= LEAST_WAY_M:
            first += 1
        samples.way_from = first
        window = samples.window(first)
        way_m = window.way_mps * window.span_s
        if not (window.way_mps > DIRECTION_MPS and way_m >= LEAST_WAY_M):
            return None
        # Without a speed of which the sign could be told the speed itself is what contradicts.
        if self._bounds.signed and abs(window.speed_mps) < SPEED_MPS:
            return None
        return window if self._samples.noise_m(first) < way_m else None

    def _direction_share(self, way: Window, first: int) -> float:
        return abs(way.turned_rad(signed=self._bounds.signed)) / self._direction_bound(way, first)

    def _direction_bound(self, way: Window, first: int) -> float:
        noise_rad = math.atan2(self._samples.noise_m(first), way.way_mps * way.span_s)
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
            window = self._samples.shifted(first, delays.believed_s)
            if window is None:
                return False
            left, bound = fit(window)
            is_off = abs(left) > bound
        if not is_off:
            delays.begin_anew()
            return False
        windows = [w for d in DELAYS_S if (w := self._samples.shifted(first, d)) is not None]
        if len(windows) < len(DELAYS_S):
            # Nobody knows yet.
            return False
        fits = [abs(left) <= bound for left, bound in map(fit, windows)]
        self._fits_alone = any(fits)
        return not delays.take(self._samples.t_s[-1], fits)

    # -- places that step ----------------------------------------------------------------------

    def _steps(self, first: int) -> bool:
        """Tell whether one step of the place explains what was found.

        Windows then begin after it.

        A receiver that gets a better fix moves its place at once. One that does so again and again
        is one that moves.
        """
        samples = self._samples
        whole = samples.window(first)
        span, vx, vy = whole.span_s, whole.vx_mps, whole.vy_mps

        def off_m(k: int) -> float:
            dt, step_x, step_y = samples.step(k)
            return math.hypot(step_x - vx * dt, step_y - vy * dt)

        k = max(range(first + 1, len(samples.rows)), key=off_m)
        dt, step_x, step_y = samples.step(k)
        share = span / (span - dt)
        vx, vy = (vx - step_x / span) * share, (vy - step_y / span) * share
        if math.hypot(step_x - vx * dt, step_y - vy * dt) > self._bounds.jump_m:
            return False
        left = Window(span, vx, vy, whole.speed_mps, whole.yaw_rad)
        excess = abs(left.speed_excess_mps) > self._speed_bound(left, first)
        if excess or (self._judges_direction(left) and self._direction_share(left, first) > 1.0):
            return False
        again = samples.t_s[k] - self._stepped_s < _STEP_APART_S
        self._stepped_s = samples.t_s[k]
        if again:
            return False
        samples.restart(k)
        self._begin_anew()
        return True

    def _judges_direction(self, window: Window) -> bool:
        if self._direction_rad is None or window.way_mps <= DIRECTION_MPS:
            return False
        return not self._bounds.signed or abs(window.speed_mps) >= SPEED_MPS

    # -- findings ------------------------------------------------------------------------------

    def _contradicts(self, window: Window, kind: str, start: int | None = None) -> None:
        if self._findings.contradiction is None:
            self._factors = SpeedFactors()
        if kind == OTHER_SPEED and start is not None:
            shifted = [self._samples.shifted(start, delay_s) for delay_s in DELAYS_S]
            windows = [w for w in shifted if w is not None]
            if len(windows) == len(DELAYS_S):
                self._factors.take(windows, self._samples.noise_m(start) / windows[0].span_s)
        # A delay hides the mistake while the speed changes; the faster the clearer.
        contradiction = self._findings.contradict(
            self._samples.t_s[-1],
            kind,
            window.way_mps,
            self._figures(window),
            moves=window.way_mps >= DIRECTION_MPS,
            other_speed=self._factors.kind,
        )
        if contradiction.holds:
            # None of them explains what came so far.
            self._speed_delays, self._yaw_delays = Delays(), Delays()

    def _figures(self, window: Window) -> str:
        turned = math.degrees(window.turned_rad(signed=self._bounds.signed))
        text = f"{window.speed_mps:.2f} m/s stated, way of {window.way_mps:.2f} m/s"
        if window.way_mps > DIRECTION_MPS and self._direction_rad is not None:
            text += f" at {turned:+.0f}° to the yaw"
        return f"{text} in {window.span_s:.2f} s"

    def _kind(self, window: Window, by_speed: bool) -> str:
        return kind_of(
            window,
            self._samples.fastest_mps(self._samples.t_s[-1] - window.span_s - 1e-9),
            self._direction_rad or DIRECTION_RAD,
            signed=self._bounds.signed,
            speed_fits=not by_speed,
        )

    # -- standstill ----------------------------------------------------------------------------

    def net_way_m(self, span_s: float) -> tuple[float, float]:
        """Give the chord of the last seconds, and how many of them the states cover.

        Returns:
            Way in m and time in s, at most ``span_s``; 0 and 0 where there is no state.
        """
        return self._samples.net_way_m(span_s)

    @property
    def position_std_m(self) -> float:
        """Return how uncertain the newest place is; no more than counts."""
        return self._samples.position_std_m
