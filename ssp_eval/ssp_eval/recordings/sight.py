"""The sight of a camera on the VUT of a box with others in the way, of participants and zone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray, Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Series
from ssp_core.world.camera import Intrinsics, Mounting, View, mounted_view, project, shown_box

# Heights at which points are taken, as shares of the box's height: feet, middle, head.
_HEIGHTS = (0.1, 0.5, 0.9)
# A box counts as seen when this share of its points is.
MIN_SHARE = 0.25


def surface_points(state: ObjectState) -> FloatArray:
    """Return points around a box in map, (24, 3): corners and middles of sides, at 3 heights."""
    corners = np.array(state.box.corners())
    ring = np.concatenate([corners, (corners + np.roll(corners, -1, axis=0)) / 2.0])
    rows = [np.column_stack([ring, np.full(len(ring), h * state.size.height_m)]) for h in _HEIGHTS]
    return np.concatenate(rows)


def blocked(
    eye_m: FloatArray, points_m: FloatArray, others: Iterable[ObjectState]
) -> NDArray[np.bool_]:
    """Tell which points can't be seen from the eye because a box stands in the way.

    Args:
        eye_m: shape (3,), map.
        points_m: shape (n, 3), map.
        others: boxes that may hide something; neither the one with the eye nor the one looked at.

    Returns:
        Shape (n,).
    """
    hidden = np.zeros(len(points_m), dtype=np.bool_)
    for other in others:
        hidden |= _behind(eye_m, points_m, other)
    return hidden


def _behind(eye_m: FloatArray, points_m: FloatArray, box: ObjectState) -> NDArray[np.bool_]:
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    rotation = np.array([[c, s], [-s, c]])
    centre = np.array([box.x_m, box.y_m])
    start = rotation @ (eye_m[:2] - centre)
    step = (points_m[:, :2] - centre) @ rotation.T - start
    low = np.array([-box.size.rear_m, -box.size.width_m / 2.0])
    high = np.array([box.size.front_m, box.size.width_m / 2.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / step, (high - start) / step
    # Along an axis in which the line doesn't move it is inside all the way, or never.
    inside = (low <= start) & (start <= high)
    enter = np.where(step != 0.0, np.minimum(a, b), np.where(inside, -np.inf, np.inf))
    leave = np.where(step != 0.0, np.maximum(a, b), np.where(inside, np.inf, -np.inf))
    first = np.maximum(enter.max(axis=1), 0.0)
    last = np.minimum(leave.min(axis=1), 1.0)
    crosses = first < last
    rise = points_m[:, 2] - eye_m[2]
    heights = np.minimum(
        eye_m[2] + rise * np.where(crosses, first, 0.0),
        eye_m[2] + rise * np.where(crosses, last, 0.0),
    )
    return np.asarray(crosses & (heights < box.size.height_m), dtype=np.bool_)


def clear_share(eye_m: FloatArray, state: ObjectState, others: Iterable[ObjectState]) -> float:
    """Share of a box's points that no other box hides from the eye, whatever the camera's field."""
    return float(1.0 - blocked(eye_m, surface_points(state), others).mean())


MIN_HEIGHT_PX = 8.0
_STALE_PERIODS = 1.5


@dataclass(frozen=True)
class Optics:
    """The forward camera as it was recorded: pinhole numbers and where it sits on the VUT."""

    lens: Intrinsics
    mounting: Mounting

    def view(self, pose: Pose2) -> View:
        """Return the camera of a VUT at a pose."""
        return mounted_view(pose, self.lens, self.mounting)


@dataclass(frozen=True)
class Sight:
    """The share of a time for which something is visible.

    Args:
        fraction: of that time; None: there is no such time.
        first_lost_s: clip time of the first frame that doesn't show it, None: all do.
    """

    fraction: float | None
    first_lost_s: float | None


@dataclass(frozen=True)
class Moment:
    """One frame: its clip time, and the states at that time."""

    t_s: float
    states: Mapping[str, ObjectState]


class Moments(Sequence[Moment]):
    """The frames of a clip, made of states in arrays when they are asked for.

    Args:
        series: clip time and states of each frame.
    """

    def __init__(self, series: Series) -> None:
        self._series = series

    def __len__(self) -> int:
        return len(self._series)

    @overload
    def __getitem__(self, at: int) -> Moment: ...
    @overload
    def __getitem__(self, at: slice) -> Moments: ...
    def __getitem__(self, at: int | slice) -> Moment | Moments:
        if isinstance(at, slice):
            return Moments(self._series[at])
        return Moment(*self._series[at])


def object_share(view: View, state: ObjectState, others: Sequence[ObjectState]) -> float:
    """Share of the points round a box that the image shows; 0 where it is too small to see."""
    points = surface_points(state)
    inside, heights = _in_image(view, points)
    if not inside.any() or np.ptp(heights[inside]) * 1.25 < MIN_HEIGHT_PX:
        # The points span the middle four fifths of the height.
        return 0.0
    return float((inside & ~blocked(view.position_m, points, others)).mean())


def object_height_px(view: View, state: ObjectState, others: Sequence[ObjectState]) -> float:
    """Return the height in px of what the image shows of a box.

    Returns:
        0 where it lies outside the image, or others hide all of it.
    """
    box = shown_box(view, state)
    if box is None or clear_share(view.position_m, state, others) == 0.0:
        return 0.0
    return box[3] - box[1]


def zone_share(
    view: View, outline: Sequence[tuple[float, float]], others: Sequence[ObjectState]
) -> float:
    """Share of a zone on the ground that the image shows.

    Args:
        view: camera in map.
        outline: one side of it, then the other in reverse (see measure.py).
        others: objects that may hide it.
    """
    half = len(outline) // 2
    right, left = np.array(outline[:half]), np.array(outline[half:])[::-1]
    ground = np.concatenate([right + (left - right) * k / 4.0 for k in range(5)])
    points = np.column_stack([ground, np.zeros(len(ground))])
    inside, _ = _in_image(view, points)
    return float((inside & ~blocked(view.position_m, points, others)).mean())


def _in_image(view: View, points: FloatArray) -> tuple[np.ndarray, FloatArray]:
    projection = project(view, points)
    lens = view.intrinsics
    with np.errstate(invalid="ignore"):
        inside = (
            projection.in_front
            & (projection.u_px >= -0.5)
            & (projection.u_px <= lens.width_px - 0.5)
            & (projection.v_px >= -0.5)
            & (projection.v_px <= lens.height_px - 0.5)
        )
    return inside, projection.v_px


def object_sight(
    moments: Sequence[Moment],
    span_s: tuple[float, float],
    period_s: float,
    optics: Optics,
    vut_id: str,
    object_id: str,
) -> Sight:
    """Compute how long one participant is visible.

    Args:
        moments: frames in time order.
        span_s: the critical phases.
        period_s: between frames.
        optics: lens and mount of the camera.
        vut_id: id of the VUT.
        object_id: id of the participant.
    """

    def visible(states: Mapping[str, ObjectState]) -> bool:
        if vut_id not in states or object_id not in states:
            return False
        others = [s for key, s in states.items() if key not in (vut_id, object_id)]
        view = optics.view(states[vut_id].pose)
        return object_share(view, states[object_id], others) >= MIN_SHARE

    return sight(moments, span_s, period_s, visible)


def zone_sight(
    moments: Sequence[Moment],
    span_s: tuple[float, float],
    period_s: float,
    optics: Optics,
    vut_id: str,
    in_it: str,
    outline: Sequence[tuple[float, float]],
) -> Sight:
    """Compute how long the conflict zone is visible; see object_sight.

    Args:
        moments: frames in time order.
        span_s: the critical phases.
        period_s: between frames.
        optics: lens and mount of the camera.
        vut_id: id of the VUT.
        in_it: id of the participant that the zone is shared with; it hides nothing.
        outline: of the zone, map.
    """

    def visible(states: Mapping[str, ObjectState]) -> bool:
        if vut_id not in states:
            return False
        others = [s for key, s in states.items() if key not in (vut_id, in_it)]
        return zone_share(optics.view(states[vut_id].pose), outline, others) >= MIN_SHARE

    return sight(moments, span_s, period_s, visible)


def sight(
    moments: Sequence[Moment],
    span_s: tuple[float, float],
    period_s: float,
    visible: Callable[[Mapping[str, ObjectState]], bool],
) -> Sight:
    """Share of a time in which the newest frame shows something, and is fresh enough."""
    start_s, end_s = span_s
    if end_s <= start_s:
        return Sight(None, None)
    seen_s, lost_s = 0.0, None
    upto_s = start_s
    for index, moment in enumerate(moments):
        following_s = moments[index + 1].t_s if index + 1 < len(moments) else end_s
        from_s = max(moment.t_s, start_s)
        until_s = min(following_s, end_s, moment.t_s + _STALE_PERIODS * period_s)
        if until_s <= from_s:
            continue
        if from_s > upto_s + 1e-9 and lost_s is None:
            lost_s = upto_s  # no frame at all
        if visible(moment.states):
            seen_s += until_s - from_s
        elif lost_s is None:
            lost_s = from_s
        upto_s = until_s
    if upto_s < end_s - 1e-9 and lost_s is None:
        lost_s = upto_s
    return Sight(min(1.0, seen_s / (end_s - start_s)), lost_s)
