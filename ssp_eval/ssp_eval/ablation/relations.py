"""Arm ``relations``: compilation by the relations between objects alone.

Each object gets a place and a speed relative to the VUT, and where its motion changes, the gap at
which it does is the trigger. Nothing says what road this is on, which phase it is, or who passes
first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import wrap_angle
from ssp_core.motion.state_series import states_of
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    LaneChange,
    Manoeuvre,
    Motion,
    ParticipantSpec,
    RelativeDistance,
    TriggerSpec,
)
from ssp_core.world.reference_line import NotOneToOne
from ssp_eval.ablation.ground import VUT, ArmRun, Ground, NoRun, Trial, Trials, best_of
from ssp_eval.ablation.placing import (
    HEADWAYS_S,
    Body,
    Placement,
    approach_mps2,
    most_mps2,
    placements,
    run_up_s,
    size_of,
    slower_by,
    vut_of,
)
from ssp_eval.ablation.source import STANDS_MPS, Course, Relations
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.scenarios.base import BlockPoint
from ssp_scenario_manager.scenarios.block_places import ahead_of, end_of
from ssp_scenario_manager.scenarios.motions import (
    HOLD_S,
    driver_travel,
    reference_travel,
    start_pose,
)

_ENOUGH_M = 0.3
# Changes of a course that are none.
_SAME_M, _SAME_MPS = 0.1, 0.3
# Between the gap that fires and the begin of the motion.
_LEAD_S = 0.1
_RUN_OUT_S = 10.0
# Relations are compared from so long before the first change of a motion on, for so long after it.
_BEFORE_S, _AFTER_S = 1.0, 3.0
# A quintic's peak rate over its mean rate.
_QUINTIC_PEAK = 1.875
# Of a change of speed the middle part is measured, from the first to the second share.
_FROM, _TO = 0.1, 0.9


@dataclass(frozen=True)
class Change:
    """The change of an object's motion, as its course shows it.

    Args:
        at_s: clip time at which it begins.
        gap_m: from the VUT's front to the object's rear then, along the VUT's heading.
        shift_m: across the VUT's heading, + left; of one that stood, along its own way.
        duration_s: of the shift.
        to_mps: speed afterwards.
        rate_mps2: of the change of speed.
    """

    at_s: float
    gap_m: float
    shift_m: float
    duration_s: float
    to_mps: float
    rate_mps2: float


def _comes(course: Course) -> bool:
    """Tell whether an object heads against the VUT at first."""
    return abs(wrap_angle(float(course.heading_rad[0]))) > np.pi / 2


def change_of(course: Course, relations: Relations) -> Change | None:
    """Return the change of an object's motion; None: it goes on as it was seen first."""
    t, speed, left = relations.times_s, course.speed_mps, course.left_m
    is_standing = float(speed[0]) < STANDS_MPS
    shift_m = float(left[-1] - left[0])
    to_mps = float(speed[-1])
    changes_speed = abs(to_mps - float(speed[0])) > _SAME_MPS
    if not changes_speed and (is_standing or abs(shift_m) < _SAME_M):
        return None
    duration_s = 0.0
    middle_s = np.inf
    begins = []
    rate = 2.0
    if changes_speed:
        progress = (speed - speed[0]) / (to_mps - speed[0])
        first, last = (float(t[int(np.argmax(progress >= share))]) for share in (_FROM, _TO))
        rate = (_TO - _FROM) * abs(to_mps - float(speed[0])) / max(last - first, 1e-3)
        middle_s = 0.5 * (first + last)
        begins.append(middle_s - 0.5 * abs(to_mps - float(speed[0])) / rate)
    if not is_standing and abs(shift_m) >= _SAME_M:
        across = np.gradient(left, t)
        duration_s = _QUINTIC_PEAK * abs(shift_m) / float(np.abs(across).max())
        progress = (left - left[0]) / shift_m
        begins.append(float(t[int(np.argmax(progress >= 0.5))]) - 0.5 * duration_s)
    at_s = max(0.0, min(begins))
    ahead_m = float(np.interp(at_s - _LEAD_S, t, course.ahead_m))
    size = size_of(course.object_class)
    near_m = size.front_m if _comes(course) else size.rear_m
    gap_m = ahead_m - size_of(relations.vut_class).front_m - near_m
    return Change(at_s, gap_m, shift_m, duration_s, to_mps, rate)


def by_relations(relations: Relations, ground: Ground, trials: Trials) -> ArmRun:
    """Return the answer of compilation by relations for a place.

    Raises:
        NoRun: the relations fit onto no lane of it, or can't be driven there.
    """
    changes = {course.object_id: change_of(course, relations) for course in relations.courses}
    # Everything is laid out from the first instant at which some motion changes.
    at_s = min((one.at_s for one in changes.values() if one is not None), default=0.0)
    solver = _Solver(relations, changes, at_s, ground)
    candidates = placements(ground, solver.need_m, solver.bodies)
    return best_of(trials, solver.runs(candidates), solver.error_m, _ENOUGH_M)


@dataclass(frozen=True)
class _Solver:
    """The solution of relations on the lanes of a place."""

    relations: Relations
    changes: dict[str, Change | None]
    at_s: float
    ground: Ground

    def _share(self, block: Block) -> float:
        speeds = [self.relations.vut_speed_mps, *(c.speed_mps for c in self.relations.courses)]
        return slower_by(self.ground, block, speeds)

    def _fires(self, block: Block) -> tuple[float, float, float]:
        """Return the VUT's speed, and time and way at which the relations hold."""
        share = self._share(block)
        cruise_mps = share * float(self.relations.vut_speed_mps[0])
        limits = self.ground.limits
        a = approach_mps2(self.relations.vut_class, limits)
        fires_s = run_up_s(cruise_mps, a)
        for course in self.relations.courses:
            speed = share * float(course.speed_mps[0])
            if speed > STANDS_MPS:
                its = approach_mps2(course.object_class, limits)
                fires_s = max(fires_s, speed / its + 0.7 + HOLD_S)
        return cruise_mps, fires_s, driver_travel(cruise_mps, a, fires_s)[0]

    @property
    def need_m(self) -> float:
        """Way of the VUT from its start to the end of what was seen."""
        left = self.relations.times_s >= self.at_s
        t, speed = self.relations.times_s[left], self.relations.vut_speed_mps[left]
        after_m = float(np.trapezoid(speed, t))
        return after_m + max(self._fires(block)[2] for block in self.ground.blocks)

    def _at(self, course: Course) -> tuple[float, float, float]:
        """Return an object's place ahead and to the left, and its heading, at that instant."""
        t = self.relations.times_s
        return tuple(  # type: ignore[return-value]  # three of them
            float(np.interp(self.at_s - _LEAD_S, t, values))
            for values in (course.ahead_m, course.left_m, course.heading_rad)
        )

    def bodies(self, _block: Block, lane: BlockLane, _start_s_m: float) -> list[Body]:
        """Return the bodies beside the VUT's lane, first and last as they were seen."""
        end_bodies = []
        for course in self.relations.courses:
            for k in (0, -1):
                stands = float(course.speed_mps[k]) < STANDS_MPS
                if stands and k:
                    continue
                forward = abs(wrap_angle(float(course.heading_rad[k]))) < np.pi / 2
                l_m = lane.y_m + float(course.left_m[k])
                end_bodies.append(Body(course.object_class, l_m, forward, stands))
        return end_bodies

    def runs(self, candidates: list[Placement]) -> Iterator[ArmRun]:
        """Yield answers in the order in which they are tried."""
        for number, placement in enumerate(candidates):
            for headway_s in HEADWAYS_S[: None if number == 0 else 1]:
                try:
                    yield self._arm_run(placement, headway_s)
                except (NotOneToOne, NoRun):
                    continue

    def _arm_run(self, placement: Placement, headway_s: float) -> ArmRun:
        block, lane = placement.block, placement.lane
        cruise_mps, fires_s, way_m = self._fires(block)
        vut, driver = vut_of(placement, cruise_mps, headway_s, self.ground.limits)
        targets, triggers = [], []
        for course in self.relations.courses:
            ahead_m, left_m, heading = self._at(course)
            l_m = lane.y_m + left_m
            s_m = ahead_of(block, placement.start_s_m, way_m + ahead_m, l_m)
            speed = self._share(block) * float(course.speed_mps[0])
            a = approach_mps2(course.object_class, self.ground.limits)
            motion = None
            if speed > STANDS_MPS:
                along = -1.0 if _comes(course) else 1.0
                s_m = ahead_of(block, s_m, -along * reference_travel(speed, a, fires_s), l_m)
                size, last_m = size_of(course.object_class), block.length_m
                end_m = end_of(block, size)
                if along < 0.0:
                    end_m = last_m - end_m
                if not size.rear_m <= s_m <= last_m - size.rear_m or along * (end_m - s_m) <= 0.0:
                    raise NoRun(f"{course.object_id} would start beyond the lane's end")
                motion = Motion(
                    path=block.line.path(s_m, end_m, l_m), cruise_mps=speed, acceleration_mps2=a
                )
            if motion is not None:
                heading = np.pi if _comes(course) else 0.0
            start = start_pose(block.line, BlockPoint(s_m, l_m), heading)
            spec = ParticipantSpec(
                id=course.object_id,
                object_class=course.object_class.word,
                start=start,
                approach=motion,
            )
            targets.append(spec)
            change = self.changes[course.object_id]
            if change is not None:
                triggers.append(self._trigger(course, change, spec, block, fires_s))
        return ArmRun(block, vut, driver, tuple(targets), tuple(triggers), fires_s)

    def _trigger(
        self,
        course: Course,
        change: Change,
        spec: ParticipantSpec,
        block: Block,
        fires_s: float,
    ) -> TriggerSpec:
        if change.gap_m <= 0.0:
            raise NoRun(f"{course.object_id} isn't ahead where its motion changes")
        return TriggerSpec(
            id=f"{course.object_id}_relative_distance",
            condition=RelativeDistance(
                type="relative_distance",
                object_id=course.object_id,
                below_m=round(change.gap_m, 3),
            ),
            not_before_s=round(0.5 * fires_s, 1),
            object_id=course.object_id,
            manoeuvre=self._act(course, change, spec, block),
            lead_time_s=_LEAD_S,
        )

    def _act(
        self, course: Course, change: Change, spec: ParticipantSpec, block: Block
    ) -> Manoeuvre:
        share = self._share(block)
        to_mps = share * change.to_mps
        up, down = most_mps2(course.object_class, self.ground.limits)
        most = up if spec.approach is None or to_mps > spec.approach.cruise_mps else down
        rate = min(max(share * share * change.rate_mps2, 0.1), most)
        if spec.approach is None:
            t = self.relations.times_s
            way_m = float(np.trapezoid(course.speed_mps, t))
            yaw = spec.start.yaw_rad
            x, y = spec.start.x_m, spec.start.y_m
            goal = (x + way_m * np.cos(yaw), y + way_m * np.sin(yaw))
            return FollowPath(
                kind="follow_path",
                motion=Motion(
                    path=[(x, y), (float(goal[0]), float(goal[1]))],
                    cruise_mps=share * float(course.speed_mps.max()),
                    acceleration_mps2=rate,
                    deceleration_mps2=rate,
                ),
            )
        if abs(change.shift_m) < _SAME_M and to_mps < spec.approach.cruise_mps:
            return Brake(
                kind="brake",
                to_mps=to_mps if to_mps > STANDS_MPS else 0.0,
                deceleration_mps2=rate,
                run_out_s=_RUN_OUT_S,
            )
        return LaneChange(
            kind="lane_change",
            # To its own left.
            lateral_shift_m=-change.shift_m if _comes(course) else change.shift_m,
            duration_s=max(change.duration_s / share, 0.5),
            cruise_mps=max(to_mps, 0.5),
            deceleration_mps2=rate,
            run_out_s=_RUN_OUT_S,
        )

    def error_m(self, answer: ArmRun, trial: Trial) -> float:
        """Return the rms departure of executed from given relative places, from the change on, m.

        Instants count from the one at which a motion changed, and without one from the foreseen.
        """
        fired = [one.dispatched_ns * 1e-9 + _LEAD_S for one in trial.result.triggers]
        if not fired:
            return np.inf
        vut = states_of(trial.series, VUT)
        share = self._share(answer.block)
        squares = []
        for course in self.relations.courses:
            other = states_of(trial.series, course.object_id)
            for state, own in zip(other, vut, strict=False):
                at_s = self.at_s + share * (state.stamp_ns * 1e-9 - fired[0])
                if not self.at_s - _BEFORE_S <= at_s <= self.at_s + _AFTER_S:
                    continue
                ahead, left = own.pose.to_local(state.x_m, state.y_m)
                t = self.relations.times_s
                squares.append(
                    (ahead - float(np.interp(at_s, t, course.ahead_m))) ** 2
                    + (left - float(np.interp(at_s, t, course.left_m))) ** 2
                )
        return float(np.sqrt(np.mean(squares))) + trial.penalty_m if squares else np.inf
