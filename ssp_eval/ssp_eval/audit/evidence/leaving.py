"""The occluder that leaves the VUT's lane, against K*: to which side, and at which gap (cut-out).

Where it leaves is measured by the lanes of the road that is bound to the recording, from the clip's
first state to its last.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from ssp_core.motion.encounter import OBSERVABLE_LATERAL_MPS
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Series
from ssp_eval.audit.evidence.further import ahead_m, gap_slack_m
from ssp_eval.audit.evidence.paths import Lanes, Spot
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.events.kinds import KINDS


@dataclass(frozen=True)
class Leaving:
    """The lane change of an occluder.

    Args:
        object_id: its id.
        side: to which its middle leaves the lane that the VUT starts in; None: it stays in it.
        gap_m: bumper gap between the VUT and the initiator when its lateral motion begins; None: it
            stays, it is beside the lane from the first state, or one of both isn't there then.
    """

    object_id: str
    side: Literal["left", "right"] | None
    gap_m: float | None


def leaving_occluder(event: Event) -> str | None:
    """Return the id of the occluder that K* has leave the lane; None: its kind has none."""
    kind = KINDS.get(event.interaction.type)
    return event.interaction.occluder if kind is not None and kind.occluder_leaves else None


def leaving_of(
    object_id: str, series: Series, lanes: Lanes, ids: tuple[str, str], own_lane: int
) -> Leaving | None:
    """Measure where an occluder leaves the lane.

    Args:
        object_id: its id.
        series: states of the clip.
        lanes: of the road.
        ids: of the VUT and of the initiator.
        own_lane: in which the VUT starts.

    Returns:
        None: it isn't there.
    """
    side = 1.0 if lanes.forward else -1.0
    samples = [
        (t_s, now, spot)
        for t_s, now in series
        if object_id in now and (spot := lanes.spot(now[object_id])) is not None
    ]
    if not samples:
        return None
    out = next((i for i, (_, _, spot) in enumerate(samples) if spot.lane != own_lane), None)
    if out is None:
        return Leaving(object_id, None, None)
    l_m = samples[out][2].l_m
    to: Literal["left", "right"] = (
        "left" if (l_m - lanes.lanes[own_lane].y_m) * side > 0.0 else "right"
    )
    outwards = side if to == "left" else -side
    begins = out
    while begins > 0:
        _, now, spot = samples[begins - 1]
        if outwards * _left_of_line_mps(now[object_id], spot, lanes) <= OBSERVABLE_LATERAL_MPS:
            break
        begins -= 1
    states = samples[begins][1]
    gap_m = ahead_m(lanes, *(states.get(who) for who in ids)) if out > 0 else None
    return Leaving(object_id, to, gap_m)


def _left_of_line_mps(state: ObjectState, spot: Spot, lanes: Lanes) -> float:
    """Return the lateral speed by heading; differences of places are small beside their noise."""
    return state.speed_mps * math.sin(state.yaw_rad - lanes.line.pose(spot.s_m).yaw_rad)


def leaves_otherwise(event: Event, leaving: Leaving) -> Iterator[str]:
    """Yield where a lane change isn't that of K*, for people."""
    who, initiator = leaving.object_id, event.interaction.initiator
    lateral = event.motion[who]["trigger"].lateral
    if leaving.side is None:
        yield f"{who} stays in the VUT's lane, K* has it leave to the {lateral}"
        return
    if lateral in ("left", "right") and leaving.side != lateral:
        yield f"{who} leaves the VUT's lane to the {leaving.side}, K* has {lateral}"
    below = event.constraints.trigger.below
    if not isinstance(below, Interval):
        return
    span, gap_m = below.si, leaving.gap_m
    has = f"K* has it begin between {span.low:g} and {span.high:g} m"
    if gap_m is None:
        yield (
            f"{who} is beside the VUT's lane from the clip's first state, or {initiator} isn't "
            f"there when it leaves; {has} from {initiator}"
        )
    elif not span.low - gap_slack_m(gap_m) <= gap_m <= span.high + gap_slack_m(gap_m):
        yield f"{who} begins to leave when {initiator} is {gap_m:.1f} m ahead of the VUT, {has}"
