"""Whether a run has the room that it needs: fence, reach of the targets, safe-stop zones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ssp_core.geometry import Box, Polyline
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath, LaneChange, ParticipantSpec
from ssp_core.run_file.values import Point, Start
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.compile.ground import outside
from ssp_scenario_manager.interactions.base import CannotPlace, Drive, Plan
from ssp_scenario_manager.interactions.travel import stopping_m
from ssp_scenario_manager.topology.block import Block

# Paths are looked at in steps of this.
_STEP_M = 1.0
# A safe-stop zone can be reached from the VUT's path within this distance to a side.
SAFE_STOP_REACH_M = 8.0


def _swept(start: Start, path: Sequence[Point], spec: ParticipantSpec) -> Iterator[Point]:
    """Corners of a participant at its start and along a path."""
    yield from Box(start.pose, spec.size.front_m, spec.size.rear_m, spec.size.width_m).corners()
    line = Polyline(path)
    steps = max(1, round(line.length_m / _STEP_M))
    for i in range(steps + 1):
        pose = line.pose(line.length_m * i / steps)
        yield from Box(pose, spec.size.front_m, spec.size.rear_m, spec.size.width_m).corners()


def _paths(run: RunSpec, block: Block, plan: Plan) -> Iterator[tuple[ParticipantSpec, list[Point]]]:
    """Every path that VUT and OTs may drive or walk, the lane after a lane change included."""
    for spec in (run.vut, *run.targets):
        if spec.approach is not None:
            yield spec, spec.approach.path
        elif not any(t.object_id == spec.id for t in run.triggers):
            ahead = spec.start.pose.to_parent(0.01, 0.0)
            yield spec, [(spec.start.x_m, spec.start.y_m), ahead]
    for trigger in run.triggers:
        spec = next(t for t in run.targets if t.id == trigger.object_id)
        if isinstance(trigger.manoeuvre, FollowPath):
            yield spec, trigger.manoeuvre.motion.path
        elif isinstance(trigger.manoeuvre, LaneChange):
            drive = plan.targets[spec.id]
            if isinstance(drive, Drive):
                y = drive.start.l_m + trigger.manoeuvre.lateral_shift_m
                yield spec, block.line.path(plan.expected.s_m, drive.end_s_m, y)


def check_fence(run: RunSpec, block: Block, plan: Plan) -> None:
    """Nobody leaves the geofence.

    Raises:
        CannotPlace: somebody would leave the geofence.
    """
    for spec, path in _paths(run, block, plan):
        out = outside(list(_swept(spec.start, path, spec)), [run.geofence])
        if out is not None:
            raise CannotPlace(
                f"{spec.id} would leave the geofence at x {out[0]:.1f} m, y {out[1]:.1f} m"
            )


def check_reachable(run: RunSpec, block: Block, plan: Plan, regions: list[list[Point]]) -> None:
    """No target leaves what targets can reach.

    Raises:
        CannotPlace: a target would leave what targets can reach.
    """
    for spec, path in _paths(run, block, plan):
        if spec.id == VUT_ID:
            continue
        out = outside(list(_swept(spec.start, path, spec)), regions)
        if out is not None:
            raise CannotPlace(
                f"{spec.id} would leave what OTs can reach at x {out[0]:.1f} m, y {out[1]:.1f} m"
            )


def check_safe_stop(block: Block, plan: Plan, zones: list[list[Point]]) -> None:
    """A zone lies beside or ahead of the VUT where it stands after braking from the trigger.

    Raises:
        CannotPlace: none does.
    """
    brakes = stopping_m(plan.vut.cruise_mps, plan.vut.deceleration_mps2)
    earliest = plan.expected.s_m + brakes
    for zone in zones:
        for s in _stations(earliest, block.length_m):
            if _crosses(block, s, plan.vut.start.l_m, zone):
                return
    raise CannotPlace(
        f"no safe-stop zone can be reached from s = {earliest:.0f} m on, where the VUT can stop "
        f"after the trigger ({len(zones)} zone(s), {SAFE_STOP_REACH_M:g} m to either side)"
    )


def _stations(from_s_m: float, to_s_m: float) -> Iterator[float]:
    s = from_s_m
    while s <= to_s_m:
        yield s
        s += _STEP_M


def _crosses(block: Block, s_m: float, l_m: float, zone: list[Point]) -> bool:
    """Some place beside the path within reach lies in the zone."""
    steps = int(2 * SAFE_STOP_REACH_M)
    for i in range(steps + 1):
        try:
            point = block.line.to_map(s_m, l_m - SAFE_STOP_REACH_M + i)
        except NotOneToOne:
            continue
        if outside([point], [zone]) is None:
            return True
    return False
