"""What there is to draw at one instant, and which indicators blink then.

A vehicle indicates while it moves sideways in its lane's direction, and for a while before: in a
session from when the trigger of its lane change is about to fire if everybody goes on as now, in a
clip from shortly before it moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from ssp_core.clock import NS_PER_S, ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.motion.encounter import encounter
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    AllOf,
    AnyOf,
    Condition,
    ElapsedTime,
    LaneChange,
    RelativeDistance,
    TimeHeadway,
    TimeToArrival,
    TimeToCollision,
)
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine

AHEAD_S = 1.2  # a driver indicates so long before the wheel is turned
_PERIOD_NS = 2 * NS_PER_S // 3  # 1.5 Hz
_SIDEWAYS_MPS = 0.3
_ALONG_RAD = 0.4  # more than this is a turn, or a way across
_SLOWEST_MPS = 1.0
_LINGER_S = 0.4
_PATIENCE_S = 4.0  # without a lane change after all
_WITH_INDICATORS = frozenset(
    {ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS, ObjectClass.MOTORCYCLE}
)


class Indicator(Enum):
    """Which side blinks."""

    OFF = "off"
    LEFT = "left"
    RIGHT = "right"
    BOTH = "both"


OFF = Indicator.OFF


def is_lit(stamp_ns: int) -> bool:
    """Whether a blinking lamp shines at this time; all blink together."""
    return stamp_ns % _PERIOD_NS < _PERIOD_NS // 2


def sideways_mps(state: ObjectState, line: ReferenceLine) -> float:
    """Speed of a vehicle across its direction along the road, + to its own left; 0 in a turn."""
    if state.object_class not in _WITH_INDICATORS or state.speed_mps < _SLOWEST_MPS:
        return 0.0
    s, _ = line.to_local(state.x_m, state.y_m)
    turn = wrap_angle(state.yaw_rad - line.pose(s).yaw_rad)
    if abs(turn) > math.pi / 2:
        turn = wrap_angle(turn + math.pi)
    return state.speed_mps * math.sin(turn) if abs(turn) < _ALONG_RAD else 0.0


def side_of(state: ObjectState, line: ReferenceLine) -> Indicator:
    """The side to which a vehicle moves along a road."""
    sideways = sideways_mps(state, line)
    if abs(sideways) < _SIDEWAYS_MPS:
        return OFF
    return Indicator.LEFT if sideways > 0.0 else Indicator.RIGHT


def _holds(
    condition: Condition, states: Mapping[str, ObjectState], vut_id: str, path: Polyline, t_s: float
) -> bool:
    """Whether a trigger's condition holds in these states; False for those not foreseen."""
    match condition:
        case AllOf(of=parts):
            return all(_holds(part, states, vut_id, path, t_s) for part in parts)
        case AnyOf(of=parts):
            return any(_holds(part, states, vut_id, path, t_s) for part in parts)
        case ElapsedTime(after_s=after_s):
            return t_s >= after_s
        case TimeToArrival(anchor=anchor, below_s=below_s):
            vut = states[vut_id]
            at, _ = path.project(*anchor)
            here, _ = path.project_beyond(vut.x_m, vut.y_m)
            return 0.0 <= at - here - vut.size.front_m < below_s * vut.speed_mps
        case RelativeDistance() | TimeHeadway() | TimeToCollision():
            vut, other = states[vut_id], states.get(condition.object_id)
            if other is None:
                return False
            met = encounter(vut, other, path)
            match condition:
                case RelativeDistance(below_m=below_m):
                    return 0.0 <= met.gap_m < below_m
                case TimeHeadway(below_s=below_s):
                    return 0.0 <= met.gap_m < below_s * vut.speed_mps
                case TimeToCollision(below_s=below_s):
                    closing = vut.speed_mps - met.along_mps
                    return 0.0 <= met.gap_m < below_s * closing
    return False


class Indicators:
    """What blinks, frame by frame.

    Args:
        soon: the side to which an object is about to move, given the present states.
    """

    def __init__(
        self,
        road: Road,
        soon: Callable[[Mapping[str, ObjectState], int], Mapping[str, Indicator]],
    ) -> None:
        self._line = ReferenceLine.of_road(road)
        self._soon = soon
        self._on: dict[str, tuple[Indicator, int]] = {}
        self._foreseen: set[tuple[str, Indicator]] = set()

    def update(self, states: Iterable[ObjectState], now_ns: int) -> Mapping[str, Indicator]:
        """Takes the states of the next frame; sides by object id, those that blink only."""
        present = {state.object_id: state for state in states}
        moving = {key: side_of(state, self._line) for key, state in present.items()}
        for key, side in self._soon(present, now_ns).items():
            # Once only: the condition of a trigger goes on to hold after the lane change.
            if moving.get(key) is OFF and side is not OFF and (key, side) not in self._foreseen:
                self._foreseen.add((key, side))
                self._on.setdefault(key, (side, now_ns + seconds_to_ns(_PATIENCE_S)))
        for key, side in moving.items():
            if side is not OFF:
                self._foreseen.add((key, side))
                self._on[key] = (side, now_ns + seconds_to_ns(_LINGER_S))
        self._on = {k: v for k, v in self._on.items() if v[1] > now_ns and k in present}
        return {key: side for key, (side, _) in sorted(self._on.items())}


class Foreseen:
    """The lane changes of a run whose triggers are about to fire."""

    def __init__(self, run: RunSpec) -> None:
        self._run = run
        self._path = Polyline(run.vut.approach.path) if run.vut.approach is not None else None
        self._start_ns: int | None = None

    def __call__(self, states: Mapping[str, ObjectState], now_ns: int) -> Mapping[str, Indicator]:
        """Sides by object id; times count from the first call."""
        if self._start_ns is None:
            self._start_ns = now_ns
        if self._path is None or self._run.vut.id not in states:
            return {}
        later_ns = now_ns + seconds_to_ns(AHEAD_S)
        ahead = {key: state.extrapolated(later_ns) for key, state in states.items()}
        t_s = ns_to_seconds(later_ns - self._start_ns)
        found: dict[str, Indicator] = {}
        for trigger in self._run.triggers:
            change = trigger.manoeuvre
            if not isinstance(change, LaneChange) or t_s < trigger.not_before_s:
                continue
            if _holds(trigger.condition, ahead, self._run.vut.id, self._path, t_s):
                left = change.lateral_shift_m > 0.0
                found[trigger.object_id] = Indicator.LEFT if left else Indicator.RIGHT
        return found


@dataclass(frozen=True)
class Scene:
    """What is there at one instant.

    Args:
        vut: state of the vehicle that carries the camera; it isn't drawn, but casts a shadow.
        objects: ground truth of all others, frame map; the VUT may be among them.
        travelled_m: distance travelled so far by object id, which moves legs, pedals and wheels.
        indicators: those that blink, by object id.
    """

    road: Road
    vut: ObjectState
    objects: tuple[ObjectState, ...]
    travelled_m: Mapping[str, float] = field(default_factory=dict)
    indicators: Mapping[str, Indicator] = field(default_factory=dict)

    @property
    def others(self) -> list[ObjectState]:
        """All but the VUT."""
        return [o for o in self.objects if o.object_id != self.vut.object_id]

    def before(self, by_s: float) -> Scene:
        """The same a moment earlier, with speeds and yaw rates held: for one exposure's length."""
        shift_ns = round(by_s * 1e9)
        # Lamps don't change within an exposure: states keep their stamps.
        earlier = {
            o.object_id: replace(o.extrapolated(o.stamp_ns - shift_ns), stamp_ns=o.stamp_ns)
            for o in (*self.objects, self.vut)
        }
        return Scene(
            self.road,
            earlier[self.vut.object_id],
            tuple(earlier[o.object_id] for o in self.objects),
            {
                key: way - by_s * (earlier[key].speed_mps if key in earlier else 0.0)
                for key, way in self.travelled_m.items()
            },
            self.indicators,
        )
