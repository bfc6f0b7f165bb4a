"""Does the forward camera show the participants and the conflict zone (METHOD 4.4)?

An object is projected as a box with its height. At the time of a frame it is visible when at least
a quarter of the points round its box lie in the image with nothing in the way (sight.py), and its
image is at least 8 px high. The zone lies on the ground; what stands in it doesn't hide it. Time
counts as covered up to 1.5 frame periods from a frame: what no frame shows, nobody sees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.world.camera import Intrinsics, Mounting, View, mounted_view, project
from ssp_eval.sight import MIN_SHARE, blocked, surface_points

MIN_HEIGHT_PX = 8.0
_STALE_PERIODS = 1.5


@dataclass(frozen=True)
class Optics:
    """The forward camera as it was recorded: pinhole numbers and where it sits on the VUT."""

    lens: Intrinsics
    mounting: Mounting

    def view(self, pose: Pose2) -> View:
        """The camera of a VUT at a pose."""
        return mounted_view(pose, self.lens, self.mounting)


@dataclass(frozen=True)
class Sight:
    """How much of a time something is visible for.

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


def object_share(view: View, state: ObjectState, others: Sequence[ObjectState]) -> float:
    """Share of the points round a box that the image shows; 0 where it is too small to see."""
    points = surface_points(state)
    inside, heights = _in_image(view, points)
    if not inside.any() or np.ptp(heights[inside]) * 1.25 < MIN_HEIGHT_PX:
        # The points span the middle four fifths of the height.
        return 0.0
    return float((inside & ~blocked(view.position_m, points, others)).mean())


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
    seen = project(view, points)
    lens = view.intrinsics
    with np.errstate(invalid="ignore"):
        inside = (
            seen.in_front
            & (seen.u_px >= -0.5)
            & (seen.u_px <= lens.width_px - 0.5)
            & (seen.v_px >= -0.5)
            & (seen.v_px <= lens.height_px - 0.5)
        )
    return inside, seen.v_px


def object_sight(
    moments: Sequence[Moment],
    span_s: tuple[float, float],
    period_s: float,
    optics: Optics,
    vut_id: str,
    object_id: str,
) -> Sight:
    """How long one participant is visible.

    Args:
        moments: frames in time order.
        span_s: the critical phases.
        period_s: between frames.
        optics: the camera.
        vut_id: id of the VUT.
        object_id: that is looked for.
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
    """How long the conflict zone is visible; arguments as object_sight.

    Args:
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
