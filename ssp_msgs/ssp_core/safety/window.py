"""One window of an object's states, and the mistake that explains best what contradicts in it."""

from __future__ import annotations

import math

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
# Factor to m/s, and how far from it a ratio may be; a delay spoils ratios while the speed changes.
_UNITS = ((3.6, 0.25, "km/h"), (2.23694, 0.06, "miles per hour"), (1.94384, 0.06, "knots"))


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
        ratio = abs(w.speed_mps) / max(w.way_mps, 1e-9)
        for factor, share, unit in _UNITS:
            if abs(ratio / factor - 1.0) < share:
                return f"speed in {unit}"
        return "speed contradicts the way"
    bound = 0.5 * direction_rad
    meant = course + (math.pi if signed and w.speed_mps < 0.0 else 0.0)
    for kind, yaw in (
        (TURNED, w.yaw_rad + math.pi),
        (NED_YAW, math.pi / 2.0 - w.yaw_rad),
        (CLOCKWISE, -w.yaw_rad),
    ):
        if abs(wrap_angle(meant - yaw)) <= bound:
            return kind
    return "yaw contradicts the way"
