"""One window of an object's states, and the mistake that explains best what contradicts in it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ssp_core.geometry import wrap_angle
from ssp_core.value_class import value_class

# A window lasts so long, or longer until it holds so many samples.
WINDOW_S = 0.5
LEAST_SAMPLES = 3
# Stated speed against the way travelled; a share is of the larger of both.
SPEED_SHARE = 0.25
SPEED_MPS = 0.5
# What is slower states that it stands.
_NO_SPEED_MPS = 0.05
# A way so near to the map's y axis has no speed along x, but for noise.
_ACROSS_SHARE = 0.05

MAP_AXES = "the twist looks like map axes"
EMPTY_TWIST = "empty twist"
TURNED = "yaw turned by 180°"
NED_YAW = "NED yaw"
CLOCKWISE = "clockwise yaw"
UNSTEADY_DELAY = "no one delay between place and motion fits"
OTHER_SPEED = "speed contradicts the way"
NOT_MPS = "speed not in m/s"
# Speeds of 1 m/s in the units that receivers and vehicles give.
UNITS = {"km/h": 3.6, "miles per hour": 2.23694, "knots": 1.94384}
# A sound source's speed may be off by this share, and a factor is known that is known to this one.
_SCALE_SHARE = 0.04
_KNOWN_SHARE = 0.12


@value_class(frozen=True, slots=True)
class Window:
    """Means over one window.

    Args:
        vx_mps: of the chord, along the parent's x; vy_mps: along its y.
        speed_mps: as stated, with its sign.
        yaw_rad: as stated.
    """

    span_s: float
    vx_mps: float
    vy_mps: float
    speed_mps: float
    yaw_rad: float

    @property
    def way_mps(self) -> float:
        return math.hypot(self.vx_mps, self.vy_mps)

    @property
    def speed_excess_mps(self) -> float:
        """Stated speed minus that of the way."""
        return abs(self.speed_mps) - self.way_mps

    def turned_rad(self, *, signed: bool) -> float:
        """Compute how far the way lies to the left of where the yaw leads."""
        turned = wrap_angle(math.atan2(self.vy_mps, self.vx_mps) - self.yaw_rad)
        if signed:
            return wrap_angle(turned + math.pi) if self.speed_mps < 0.0 else turned
        return math.remainder(turned, math.pi)


def speed_bound_mps(stated_mps: float, way_mps: float, noise_mps: float = 0.0) -> float:
    """Give how far the amount of a stated speed may be off that of the way.

    Args:
        stated_mps: with or without its sign.
        way_mps: of the way, >= 0.
        noise_mps: of the way, by what its places are uncertain.
    """
    return max(SPEED_SHARE * max(abs(stated_mps), way_mps), SPEED_MPS, noise_mps)


def known_factors(
    low: float, high: float, factors: Mapping[str, float]
) -> tuple[tuple[str, ...], bool]:
    """Name the known factors that may be the one between stated speeds and the way.

    Args:
        low: the least that it can be, but for the scale of a sound source.
        high: the most that it can be.
        factors: those that are known, by name.

    Returns:
        Their names; and whether it is known so well that it is the first one, and no other.
    """
    least, most = low * (1.0 - _SCALE_SHARE), high * (1.0 + _SCALE_SHARE)
    matches = tuple(name for name, factor in factors.items() if least <= factor <= most)
    if len(matches) != 1:
        return matches, False
    factor = factors[matches[0]]
    above = least >= factor * (1.0 - _KNOWN_SHARE)
    return matches, above and most <= factor * (1.0 + _KNOWN_SHARE)


def either(words: Sequence[str]) -> str:
    """Join words as an alternative."""
    return " or ".join(filter(None, (", ".join(words[:-1]), words[-1])))


class SpeedFactors:
    """The factors between stated speeds and the way that the windows so far allow.

    There is one factor, and one delay between place and motion: each delay has its own range.
    """

    def __init__(self) -> None:
        self._ranges: list[tuple[float, float]] = []

    def take(self, windows: Sequence[Window], noise_mps: float) -> None:
        """Take a window.

        Args:
            windows: it, with each delay that may be; in the same order each time.
            noise_mps: of its way, by what its places are uncertain.
        """
        before = self._ranges or [(0.0, math.inf)] * len(windows)
        self._ranges = []
        for (low, high), w in zip(before, windows, strict=True):
            stated, least = abs(w.speed_mps), w.way_mps - noise_mps
            low = max(low, stated / max(w.way_mps + noise_mps, 1e-9))
            high = min(high, stated / least if least > 0.0 else math.inf)
            self._ranges.append((low, high))

    @property
    def kind(self) -> str:
        """The unit that the speeds are in, or all those that it may be."""
        slack = (1.0 + _SCALE_SHARE) / (1.0 - _SCALE_SHARE)
        possible = [(low, high) for low, high in self._ranges if low <= high * slack]
        if not possible:
            return OTHER_SPEED
        low, high = min(low for low, _ in possible), max(high for _, high in possible)
        units, is_known = known_factors(low, high, UNITS)
        if is_known:
            return f"speed in {units[0]}"
        return f"{NOT_MPS}, maybe in {either(units)}" if units else OTHER_SPEED


def kind_of(
    w: Window,
    fastest: float,
    direction_rad: float,
    *,
    signed: bool,
    speed_fits: bool = False,
) -> str:
    """Name the mistake that explains a window best.

    Args:
        w: the window.
        fastest: amount of the speeds stated in it, m/s.
        direction_rad: that the way may lead off the yaw.
        signed: the sign of the speed says whether the object goes forwards.
        speed_fits: a delay explains the amount of the speed.
    """
    if w.way_mps > _NO_SPEED_MPS and fastest <= _NO_SPEED_MPS:
        # Due north or south a twist in map axes is nearly none, yet no field that nobody filled.
        # Where its places are uncertain the yaw leads there more exactly than they do.
        along_x_mps = min(abs(w.vx_mps), abs(w.way_mps * math.cos(w.yaw_rad)))
        across = along_x_mps <= max(_NO_SPEED_MPS, _ACROSS_SHARE * w.way_mps)
        return MAP_AXES if across and fastest > 0.0 else EMPTY_TWIST
    course = math.atan2(w.vy_mps, w.vx_mps)
    forwards = abs(wrap_angle(course - w.yaw_rad)) < math.pi / 2.0
    along = w.way_mps * math.cos(course - w.yaw_rad)
    in_parent = abs(w.speed_mps - w.vx_mps) < 0.5 * abs(w.speed_mps - along)
    bound_mps = max(SPEED_SHARE * w.way_mps, SPEED_MPS)
    is_other_speed = not speed_fits and abs(w.speed_excess_mps) > bound_mps
    if in_parent and (is_other_speed or (forwards and w.speed_mps < 0.0)):
        return MAP_AXES
    if is_other_speed:
        return OTHER_SPEED
    bound = 0.5 * direction_rad
    expected_yaw_rad = course + (math.pi if signed and w.speed_mps < 0.0 else 0.0)
    for kind, yaw in (
        (TURNED, w.yaw_rad + math.pi),
        (NED_YAW, math.pi / 2.0 - w.yaw_rad),
        (CLOCKWISE, -w.yaw_rad),
    ):
        if abs(wrap_angle(expected_yaw_rad - yaw)) <= bound:
            return kind
    return "yaw contradicts the way"
