"""Whether a plan goes as K* says, by what was foreseen."""

from __future__ import annotations

import math

from ssp_core.geometry import Polyline
from ssp_core.run_file.model import EndCondition
from ssp_scenario_manager.interactions.base import PlaceLimits
from ssp_scenario_manager.interactions.choosing import in_si
from ssp_scenario_manager.interactions.foresight import Foresight
from ssp_scenario_manager.interactions.motions import Motions
from ssp_scenario_manager.interactions.travel import CRUISE_SHARE, stopping_m
from ssp_scenario_manager.interactions.wanted import (
    initiator_first,
    speed_bounds,
    wanted_passing,
)
from ssp_scenario_manager.spec.model import Event


def judge(event: Event, limits: PlaceLimits, told: Motions, seen: Foresight) -> list[str]:
    """What is wrong with a plan that was looked ahead; empty: it goes as K* says."""
    c = event.constraints
    wrong = []
    if seen.early_conflict:
        wrong.append("the conflict begins before the trigger")
    if seen.trigger_s is None:
        wrong.append("the manoeuvre never becomes observable")
    if seen.conflict_s is None:
        wrong.append("no conflict comes: TTC and arrival gap stay above their thresholds")
    elif seen.trigger_s is not None and seen.conflict_s < seen.trigger_s:
        wrong.append("the conflict begins before the trigger can be seen")
    if seen.resolution_s is None and seen.conflict_s is not None:
        wrong.append("the conflict isn't resolved")
    wrong += _wrong_gap(event, seen)
    low, high = speed_bounds(event, event.vut_id, ("approach", "trigger"))
    # A driver nears its cruise speed slowly.
    if not low * CRUISE_SHARE <= seen.fired_speed_mps <= high + 1e-9:
        wrong.append(
            f"the VUT would drive {seen.fired_speed_mps:.1f} m/s at the trigger, K* wants "
            f"{low:g} to {high:g} m/s"
        )
    least = max(limits.separation_m, in_si(c.safety.separation).min or 0.0)
    if seen.separation_m <= least:
        wrong.append(f"VUT and target come within {seen.separation_m:.2f} m, limit is {least:g} m")
    path = Polyline(told.vut.approach.path) if told.vut.approach is not None else None
    needed = seen.vut_station_end_m + stopping_m(
        seen.vut_end_mps, told.driver.comfortable_deceleration_mps2
    )
    if path is not None and needed > path.length_m:
        wrong.append(
            f"the VUT needs {needed:.0f} m from its start to the run's end and to a stop, the "
            f"block leaves it {path.length_m:.0f} m"
        )
    most = in_si(c.safety.duration).max
    end = EndCondition()
    longest = end.at_latest_s if most is None else min(most, end.at_latest_s)
    ends = (seen.resolution_s or 0.0) + end.after_resolution_s
    if ends > longest:
        wrong.append(f"the run takes {ends:.0f} s, limit is {longest:g} s")
    return wrong


def wrong_order(event: Event, still: Foresight) -> list[str]:
    """What is wrong with the passing order of a plan; ``still``: of a VUT that holds its speed."""
    if initiator_first(event) == still.initiator_first:
        return []
    first, other = event.interaction.passing_order[0], event.interaction.initiator
    own_s, vut_s = still.overlap_s - still.fired_s, still.vut_arrival_s - still.fired_s
    if math.isinf(own_s):
        return [f"{other} wouldn't come into the VUT's corridor"]
    return [
        f"{first} wouldn't reach the conflict point first: after the trigger {other} takes "
        f"{own_s:.1f} s to the VUT's corridor, the VUT at its approach speed {vut_s:.1f} s"
    ]


def _wrong_gap(event: Event, seen: Foresight) -> list[str]:
    least, most = wanted_passing(event).bounds_s
    if math.isinf(seen.vut_arrival_s) or least - 1e-9 <= seen.time_gap_s <= most + 1e-9:
        return []
    return [
        f"the time gap at the conflict point would be {seen.time_gap_s:.2f} s, K* wants "
        f"{least:g} to {most:g} s"
    ]
