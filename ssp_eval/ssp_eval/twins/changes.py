"""The difference of a twin: one change, as data, and its effect on recorded states.

A change is a function of recorded states. What it doesn't name stays as it was recorded, so that
nothing in a twin reacts to it.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

from ssp_core.clock import seconds_to_ns
from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.road import Road
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.reference_line import ReferenceLine


class Kind(StrEnum):
    """The kinds of changes, by the word of ``--change``, which the names of conditions hold."""

    WITHOUT = "without"  # the object isn't there
    CLASS = "class"  # another class in its place, with that class's typical extents
    MIRROR = "mirror"  # on the other side of the VUT
    SHIFT = "shift"  # the object moves so much later (+) or earlier (-)
    CONTROL = "control"  # a distant object that has nothing to do with the event is there
    CAMERA = "camera"  # the frames are taken from where the VUT was so much earlier
    HISTORY = "history"  # the VUT's own history tells of another speed


# The cause is one object, and the frames differ in what that object does to them.
OF_OBJECT = frozenset({Kind.WITHOUT, Kind.CLASS, Kind.MIRROR, Kind.SHIFT, Kind.CONTROL})
# The object's own states differ.
MOVED = frozenset({Kind.WITHOUT, Kind.CLASS, Kind.MIRROR, Kind.SHIFT})
# Their names end in an amount.
BY_AMOUNT = frozenset({Kind.SHIFT, Kind.CAMERA, Kind.HISTORY})
CONTROL_ID = "twin_control"
_CONTROL_AHEAD_M = 40.0  # of the VUT's last place
_CONTROL_ASIDE_M = 4.0  # of the outermost lane's edge
_LONGEST_S = 10.0
_ID = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
_FORMS = {
    Kind.WITHOUT: "without=ID",
    Kind.CLASS: "class=ID:CLASS",
    Kind.MIRROR: "mirror=ID",
    Kind.SHIFT: "shift=ID:SECONDS",
    Kind.CONTROL: "control",
    Kind.CAMERA: "camera=SECONDS",
    Kind.HISTORY: "history=SHARE",
}


@dataclass(frozen=True)
class Change:
    """One cause that differs.

    Args:
        object_id: whom it is about; of CAMERA and HISTORY empty, of CONTROL the added object.
        value: s of SHIFT (+ later) and CAMERA; of HISTORY the share of the speed that was driven.
        object_class: of CLASS and CONTROL.
    """

    kind: Kind
    object_id: str = ""
    value: float = 0.0
    object_class: ObjectClass | None = None

    @property
    def name(self) -> str:
        """A word for folders and conditions, such as ``shift.ot1.m0500``: milliseconds or ‰."""
        parts = [self.kind.value]
        if self.object_id and self.kind is not Kind.CONTROL:
            parts.append(self.object_id)
        if self.object_class is not None:
            parts.append(self.object_class.word)
        if self.kind in BY_AMOUNT:
            sign = ("m" if self.value < 0.0 else "p") if self.kind is Kind.SHIFT else ""
            parts.append(f"{sign}{round(abs(self.value) * 1000):04d}")
        return ".".join(parts)

    @property
    def words(self) -> str:
        """Describe the change for people."""
        who, what = self.object_id, self.object_class.word if self.object_class else ""
        return {
            Kind.WITHOUT: f"without {who}",
            Kind.CLASS: f"a {what} in the place of {who}",
            Kind.MIRROR: f"{who} on the other side of the VUT",
            Kind.SHIFT: f"{who} {abs(self.value):g} s {'later' if self.value > 0 else 'earlier'}",
            Kind.CONTROL: f"a distant {what} beside the road, which is irrelevant",
            Kind.CAMERA: f"frames from where the VUT was {self.value:g} s earlier, history kept",
            Kind.HISTORY: f"history at {self.value:g} of the speed, frames kept",
        }[self.kind]


def parse_change(text: str) -> Change:
    """Return the change that a ``--change`` names.

    Raises:
        InputError: saying which forms there are.
    """
    word, _, rest = text.partition("=")
    try:
        kind = Kind(word)
        return _parsed(kind, *rest.partition(":")[::2])
    except ValueError as error:
        usage = next((form for one, form in _FORMS.items() if one.value == word), None)
        raise InputError(
            f"is no change{'' if usage is None else f': {error}'}",
            field="--change",
            value=text,
            remedy=f"write {usage or ', '.join(_FORMS.values())}",
        ) from error


def _parsed(kind: Kind, first: str, second: str) -> Change:
    if kind is Kind.CONTROL:
        return Change(kind, CONTROL_ID, object_class=_class(first or "car"))
    if kind is Kind.CAMERA:
        return Change(kind, value=_seconds(first, 0.0))
    if kind is Kind.HISTORY:
        share = decimal(first)
        if not 0.0 <= share < 1.0:
            raise ValueError("the share lies from 0 up to, but not including, 1")
        return Change(kind, value=share)
    if not _ID.fullmatch(first) or first == CONTROL_ID:
        raise ValueError("an object's id is missing")
    if kind is Kind.CLASS:
        return Change(kind, first, object_class=_class(second))
    if kind is Kind.SHIFT:
        return Change(kind, first, value=_seconds(second, -_LONGEST_S))
    if second:
        raise ValueError("there is too much after the id")
    return Change(kind, first)


def _class(word: str) -> ObjectClass:
    object_class = next((one for one in DEFAULT_SIZES if one.word == word), None)
    if object_class is None:
        raise ValueError(f"a class is one of {', '.join(one.word for one in DEFAULT_SIZES)}")
    return object_class


def _seconds(text: str, least: float) -> float:
    value = decimal(text)
    # What a name holds is what is done: whole milliseconds.
    whole = math.isfinite(value) and abs(value * 1000.0 - round(value * 1000.0)) < 1e-6
    if not whole or not least <= value <= _LONGEST_S or round(value * 1000.0) == 0:
        raise ValueError(f"a time has whole milliseconds, {least:g} to {_LONGEST_S:g} s, not 0")
    return round(value, 3)


def usual_changes(targets: dict[str, ObjectClass]) -> list[Change]:
    """List the changes that ``--change all`` stands for.

    Args:
        targets: class of each object target, by id.
    """
    changes = []
    for key, now in targets.items():
        instead = ObjectClass.CYCLIST if now is ObjectClass.PEDESTRIAN else ObjectClass.PEDESTRIAN
        if now in (ObjectClass.CAR, ObjectClass.TRUCK, ObjectClass.BUS):
            instead = ObjectClass.TRUCK if now is ObjectClass.CAR else ObjectClass.CAR
        changes += [
            Change(Kind.WITHOUT, key),
            Change(Kind.CLASS, key, object_class=instead),
            Change(Kind.MIRROR, key),
            Change(Kind.SHIFT, key, -0.5),
            Change(Kind.SHIFT, key, 0.5),
        ]
    control = Change(Kind.CONTROL, CONTROL_ID, object_class=ObjectClass.CAR)
    return [*changes, control, Change(Kind.CAMERA, value=0.5), Change(Kind.HISTORY, value=0.5)]


class Series:
    """The recorded states of one object by time.

    Args:
        states: one or more, in the order of their stamps; of equal stamps the last counts.
    """

    def __init__(self, states: Sequence[ObjectState]) -> None:
        by_stamp = {state.stamp_ns: state for state in states}
        self._stamps_ns = sorted(by_stamp)
        self._states = [by_stamp[stamp] for stamp in self._stamps_ns]

    def at(self, stamp_ns: int) -> ObjectState:
        """Return the state at a time: the newest one then, carried on with speed and yaw rate held.

        Before the first one it is carried back. The stamp is the wanted one.
        """
        index = bisect_right(self._stamps_ns, stamp_ns) - 1
        return self._states[max(0, index)].extrapolated(stamp_ns)


def changed_state(
    change: Change, state: ObjectState, own: Series, vut: Series
) -> ObjectState | None:
    """Change a state of the changed object; None: it isn't there.

    Args:
        change: of the twin.
        state: as it was recorded.
        own: states of the object from the same source.
        vut: states of the VUT.
    """
    match change.kind:
        case Kind.WITHOUT:
            return None
        case Kind.CLASS if change.object_class is not None:
            kind = change.object_class
            return replace(state, object_class=kind, size=DEFAULT_SIZES[kind])
        case Kind.MIRROR:
            return mirrored(state, vut.at(state.stamp_ns).pose)
        case Kind.SHIFT:
            then = own.at(state.stamp_ns - seconds_to_ns(change.value))
            return replace(then, stamp_ns=state.stamp_ns, sequence=state.sequence)
        case _:
            return state


def mirrored(state: ObjectState, vut: Pose2) -> ObjectState:
    """Return the state on the other side of the VUT's axis at the same instant."""
    x_m, y_m = vut.to_local(state.x_m, state.y_m)
    x_m, y_m = vut.to_parent(x_m, -y_m)
    yaw_rad = wrap_angle(2.0 * vut.yaw_rad - state.yaw_rad)
    return replace(state, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, yaw_rate_radps=-state.yaw_rate_radps)


def control_object(change: Change, road: Road, last_vut: ObjectState) -> ObjectState:
    """Return the object that CONTROL adds, beside the road ahead of the VUT's last place.

    So it is in view, and far, in every frame; no participant ever meets it.
    """
    if change.object_class is None:
        raise ValueError("a control has a class")
    line = ReferenceLine.of_road(road)
    s_m, _ = line.to_local(last_vut.x_m, last_vut.y_m)
    pose = line.pose(s_m)
    along = 1.0 if math.cos(last_vut.yaw_rad - pose.yaw_rad) >= 0.0 else -1.0
    # On the VUT's own side, where oncoming traffic doesn't hide it.
    right, left = road.right_edge_m - _CONTROL_ASIDE_M, road.left_edge_m + _CONTROL_ASIDE_M
    place_m = right if along > 0.0 else left
    x_m, y_m = line.to_map(s_m + along * _CONTROL_AHEAD_M, place_m)
    yaw_rad = line.pose(s_m + along * _CONTROL_AHEAD_M).yaw_rad
    return ObjectState(
        change.object_id,
        change.object_class,
        Role.TRAFFIC,
        0,
        x_m,
        y_m,
        wrap_angle(yaw_rad if along > 0.0 else yaw_rad + math.pi),
        0.0,
        0.0,
        0.0,
        DEFAULT_SIZES[change.object_class],
    )


def slowed(states: Sequence[ObjectState], share: float) -> list[ObjectState]:
    """Return the states of the same drive at a share of the speed, with their stamps.

    Place and heading are those of the recorded way at ``share`` of the distance from its begin;
    speed and acceleration are multiplied by the share, and the yaw rate follows from the
    curvature there.
    """
    way_m = [0.0]
    for before, after in pairwise(states):
        step = math.hypot(after.x_m - before.x_m, after.y_m - before.y_m)
        way_m.append(way_m[-1] + step)
    slow_states = []
    for state, done_m in zip(states, way_m, strict=True):
        wanted_m = share * done_m
        index = min(bisect_right(way_m, wanted_m), len(states) - 1)
        before, after = states[max(0, index - 1)], states[index]
        length_m = way_m[index] - way_m[max(0, index - 1)]
        part = 0.0 if length_m <= 0.0 else (wanted_m - way_m[index - 1]) / length_m
        speed_mps = share * state.speed_mps
        bend = before.yaw_rate_radps / before.speed_mps if abs(before.speed_mps) > 0.1 else 0.0
        slow_states.append(
            replace(
                state,
                x_m=before.x_m + part * (after.x_m - before.x_m),
                y_m=before.y_m + part * (after.y_m - before.y_m),
                yaw_rad=wrap_angle(
                    before.yaw_rad + part * wrap_angle(after.yaw_rad - before.yaw_rad)
                ),
                speed_mps=speed_mps,
                acceleration_mps2=share * state.acceleration_mps2,
                yaw_rate_radps=bend * speed_mps,
            )
        )
    return slow_states
