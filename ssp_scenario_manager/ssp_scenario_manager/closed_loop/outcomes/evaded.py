"""A VUT that isn't where the event would meet it: it evaded the event (METHOD 8.5).

METHOD bounds how far it may be off its twin at T_obs. Within these bounds a VUT that is slower all
the way can still pass behind what its twin hits. So an event counts as met, too, only if the VUT
would have had a contact had it gone on from T_obs as its twin does.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.plant import StepReport
from ssp_scenario_manager.closed_loop.contact import first_contact, until, with_vut
from ssp_scenario_manager.closed_loop.starts.start import path_of
from ssp_scenario_manager.closed_loop.values import LIMITS
from ssp_scenario_manager.run.in_process import Record

Twin = Mapping[int, ObjectState]


@dataclass(frozen=True, slots=True)
class _Along:
    """A state on the VUT's path.

    Args:
        station_m: along the path.
        offset_m: to its left.
        yaw_rad: against the path's direction.
    """

    station_m: float
    offset_m: float
    yaw_rad: float
    speed_mps: float

    @classmethod
    def of(cls, path: Polyline, state: ObjectState) -> _Along:
        station_m, offset_m = path.project_beyond(state.x_m, state.y_m)
        yaw_rad = state.yaw_rad - path.pose(station_m).yaw_rad
        return cls(station_m, offset_m, yaw_rad, state.speed_mps)


def evaded(run: RunSpec, driven: Driven, record: Record, twin: Twin) -> str:
    """Say why the event can't have met the VUT; empty: it did, or there was none.

    Args:
        run: as it was driven.
        driven: its driver.
        record: of a run without a contact until T_end.
        twin: true states of the twin's VUT by stamp, ns.
    """
    if driven.observable_s is None:
        return ""
    at_ns = seconds_to_ns(driven.observable_s)
    vut = next((s for s in record.truths(run.vut.id) if s.stamp_ns == at_ns), None)
    twin_state = twin.get(at_ns)
    if vut is None or twin_state is None:
        return ""
    path = path_of(run)
    own, its = _Along.of(path, vut), _Along.of(path, twin_state)
    slower = 1.0 - own.speed_mps / its.speed_mps if its.speed_mps > 0.0 else 0.0
    behind_m, beside_m = its.station_m - own.station_m, abs(own.offset_m - its.offset_m)
    words = (
        f"at T_obs {100 * slower:.0f} % slower than the twin, {behind_m:.2f} m behind it, "
        f"{beside_m:.2f} m beside it"
    )
    if (
        slower > LIMITS.evaded_share
        or behind_m > LIMITS.evaded_behind_m
        or beside_m > LIMITS.evaded_beside_m
    ):
        return words
    would_touch = [
        first_contact(_continued_drive(run, driven, record, twin, begin, its), run.vut.id)
        is not None
        for begin in (its, own)
    ]
    return f"{words}: going on so it has no contact" if would_touch == [True, False] else ""


def _continued_drive(
    run: RunSpec, driven: Driven, record: Record, twin: Twin, begin: _Along, twin_along: _Along
) -> Iterator[StepReport]:
    """Yield the steps behind T_obs with a VUT that goes on from a state there as its twin does.

    It makes its own share of the twin's way, in proportion to their speeds at T_obs. Behind its
    contact or resolution the twin is braked by its session: its speed there is held.
    """
    path, share = path_of(run), 1.0
    if twin_along.speed_mps > LIMITS.standing_mps:
        share = begin.speed_mps / twin_along.speed_mps
    held_s = driven.end_s - LIMITS.after_s
    for report in until(record.reports, driven.observable_s or 0.0, driven.end_s):
        now_s = ns_to_seconds(report.now_ns)
        state = twin.get(report.now_ns if now_s <= held_s else seconds_to_ns(held_s))
        if state is None:
            continue
        along = _Along.of(path, state)
        way_m = along.station_m - twin_along.station_m + state.speed_mps * max(now_s - held_s, 0.0)
        pose = path.pose(begin.station_m + share * way_m)
        left_m = begin.offset_m + along.offset_m - twin_along.offset_m
        vut = replace(
            state,
            stamp_ns=report.now_ns,
            x_m=pose.x_m - left_m * math.sin(pose.yaw_rad),
            y_m=pose.y_m + left_m * math.cos(pose.yaw_rad),
            yaw_rad=pose.yaw_rad + along.yaw_rad + begin.yaw_rad - twin_along.yaw_rad,
        )
        yield with_vut(report, vut)
