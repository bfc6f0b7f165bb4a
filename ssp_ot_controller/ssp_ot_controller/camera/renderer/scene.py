"""The content of a picture at one instant, and the indicators that blink then.

A motor vehicle indicates while it moves sideways along the road: no picture shows a lane change
before it can be observed.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from ssp_core.clock import NS_PER_S, seconds_to_ns
from ssp_core.geometry import wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine

_PERIOD_NS = 2 * NS_PER_S // 3  # 1.5 Hz
_SIDEWAYS_MPS = 0.3
_ALONG_RAD = 0.4  # more than this is a turn, or a way across
_SLOWEST_MPS = 1.0
_LINGER_S = 0.4
_WITH_INDICATORS = frozenset(
    {ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS, ObjectClass.MOTORCYCLE}
)


class Indicator(Enum):
    """The side that blinks."""

    LEFT = "left"
    RIGHT = "right"


def is_lit(stamp_ns: int) -> bool:
    """Tell whether a blinking lamp shines at this time; all blink together."""
    return stamp_ns % _PERIOD_NS < _PERIOD_NS // 2


def sideways_mps(state: ObjectState, line: ReferenceLine) -> float:
    """Return a vehicle's speed across its way along the road, + to its own left; 0 in a turn."""
    if state.object_class not in _WITH_INDICATORS or state.speed_mps < _SLOWEST_MPS:
        return 0.0
    s, _ = line.to_local(state.x_m, state.y_m)
    turn = wrap_angle(state.yaw_rad - line.pose(s).yaw_rad)
    if abs(turn) > math.pi / 2:
        turn = wrap_angle(turn + math.pi)
    return state.speed_mps * math.sin(turn) if abs(turn) < _ALONG_RAD else 0.0


class Indicators:
    """The indicators, frame by frame."""

    def __init__(self, road: Road) -> None:
        self._line = ReferenceLine.of_road(road)
        self._on: dict[str, tuple[Indicator, int]] = {}

    def update(self, states: Iterable[ObjectState], now_ns: int) -> Mapping[str, Indicator]:
        """Take the states of the next frame; return the blinking sides by object id."""
        present = {state.object_id: state for state in states}
        for key, state in present.items():
            sideways = sideways_mps(state, self._line)
            if abs(sideways) >= _SIDEWAYS_MPS:
                side = Indicator.LEFT if sideways > 0.0 else Indicator.RIGHT
                self._on[key] = (side, now_ns + seconds_to_ns(_LINGER_S))
        self._on = {k: v for k, v in self._on.items() if v[1] > now_ns and k in present}
        return {key: side for key, (side, _) in sorted(self._on.items())}


@dataclass(frozen=True)
class Scene:
    """The content of the world at one instant.

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
        """Return the scene a moment earlier, within one exposure; speeds and yaw rates are held."""
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
