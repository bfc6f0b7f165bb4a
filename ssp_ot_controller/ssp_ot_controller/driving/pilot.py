"""The driver's place in a session in one process: it asks, waits for L, and tracks what is due.

One question is open at a time. The frame of stamp t is asked about at t; the answer is effective at
the first step at or after t + L; the next question is that of the first frame at which none is open
(METHOD 8.3). The plan that is effective is tracked by time (8.4).

Up to the hand-over the VUT tracks its approach, as an object target does: a car-following driver
nears its speed so slowly that no run-up would be long enough for it.

``questions.Questions`` owns what is asked and answered, ``PlansInEffect`` what is tracked of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.geometry import Point, Polyline, wrap_angle
from ssp_core.motion.approach import approach_points
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import BUILT_IN, Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import (
    ROUTE_STEP_M,
    DriveMode,
    DriveReport,
    EffectiveAnswer,
    PlanDriver,
    SeeingDriver,
)
from ssp_ot_controller.bodies.dynamics import LIMITS, Command
from ssp_ot_controller.control.tracker import Tracker
from ssp_ot_controller.driving.frames import QuestionFrames
from ssp_ot_controller.driving.plan import MapPlan, fallback_of
from ssp_ot_controller.driving.questions import Questions
from ssp_ot_controller.sil.vut_driver import lookahead_m, steer
from ssp_ot_controller.sil.world import World

ROUTE_M = 80.0
# Speed is held with this gain; its loop with the drive's lag doesn't overshoot.
_HOLD_1PS = 1.0
# A path's heading and curvature are those over this length to either side.
_BEND_M = 1.0


class PlansInEffect:
    """The newest accepted plan of a driver, and what the VUT tracks without a good one."""

    def __init__(self, run: RunSpec) -> None:
        self._run = run
        self._plan: MapPlan | None = None
        self._fallback: Reference | None = None
        self._is_stale = False
        self._tracked: Reference | None = None

    def take(self, plan: MapPlan | None) -> None:
        """Take the plan of an answer that is effective now; None: it was refused."""
        self._is_stale = plan is None
        if plan is not None:
            self._plan = plan

    def effective(self, now_ns: int, vut: ObjectState) -> tuple[DriveMode, Reference]:
        """Return what the VUT tracks after the hand-over, and by what right."""
        plan = self._plan
        if plan is None:
            if self._fallback is None:
                self._fallback = fallback_of(
                    vut.pose, vut.speed_mps, now_ns, self._run.step_s, self._run.event_version
                )
            return DriveMode.FALLBACK, self._fallback
        if now_ns >= plan.end_ns:
            return DriveMode.FALLBACK, plan.reference
        return DriveMode.STALE if self._is_stale else DriveMode.PLAN, plan.reference

    def if_new(self, reference: Reference) -> Reference | None:
        """Return a reference that is tracked now; None where it was tracked in the step before."""
        previous, self._tracked = self._tracked, reference
        return None if reference is previous else reference


class Cruise:
    """A VUT without plans after its hand-over: it keeps its path, and the speed that it had.

    It keeps the speed that a driver sees first, as `constant_velocity` does: a difference of 2 mm/s
    would be a step of the time of contact after some seconds.
    """

    def __init__(self, path: Polyline) -> None:
        self._path = path
        self._held_mps: float | None = None

    def see(self, vut: ObjectState) -> float:
        """Return the speed that is held, which is that of the first call."""
        if self._held_mps is None:
            self._held_mps = vut.speed_mps
        return self._held_mps

    def command(self, vut: ObjectState) -> Command:
        """Return the command that holds the speed."""
        held_mps = self.see(vut)
        bounds = LIMITS[vut.object_class]
        target_mps2 = _HOLD_1PS * (held_mps - vut.speed_mps)
        acceleration = min(max(target_mps2, -bounds.deceleration_mps2), bounds.acceleration_mps2)
        station_m, _ = self._path.project_beyond(vut.x_m, vut.y_m)
        curvature = steer(vut, self._path, station_m) + self._bend_1pm(vut, station_m)
        return Command(acceleration, curvature, vut.yaw_rad)

    def _bend_1pm(self, vut: ObjectState, station_m: float) -> float:
        """Return what pure pursuit lacks to stay on the path in a bend, 1/m; 0 on a straight.

        Pure pursuit turns in before the bend. What it would give on the path itself is replaced by
        the path's curvature, ahead of the steering's lag.
        """
        path, bounds = self._path, LIMITS[vut.object_class]
        farthest_m = station_m + max(lookahead_m(vut.speed_mps), _BEND_M)
        if path.pose(station_m - _BEND_M).yaw_rad == path.pose(farthest_m).yaw_rad:
            return 0.0
        here = path.pose(station_m)
        heading_rad = self._chord_rad(station_m - _BEND_M, station_m + _BEND_M)
        beside = replace(vut, x_m=here.x_m, y_m=here.y_m, yaw_rad=heading_rad)
        soon_m = station_m + vut.speed_mps * bounds.curvature_lag_s
        turn_rad = self._chord_rad(soon_m, soon_m + _BEND_M) - self._chord_rad(
            soon_m - _BEND_M, soon_m
        )
        return wrap_angle(turn_rad) / _BEND_M - steer(beside, path, station_m)

    def _chord_rad(self, from_m: float, to_m: float) -> float:
        """Return the direction from one place of the path to another."""
        a, b = self._path.pose(from_m), self._path.pose(to_m)
        return math.atan2(b.y_m - a.y_m, b.x_m - a.x_m)


class Pilot:
    """Leads the VUT of one driven run. Reads no clock.

    Args:
        run: with its ``driven``.
        driver: that answers; None for a driver that is commanded without plans.
        frames: of a driver that sees; None: it sees nothing.
    """

    def __init__(
        self,
        run: RunSpec,
        driven: Driven,
        driver: PlanDriver | SeeingDriver | None,
        frames: QuestionFrames | None = None,
    ) -> None:
        if run.vut.approach is None:
            raise ValueError("a driven run without a path for the VUT passed the checks")
        self._driven = driven
        self._path = Polyline(run.vut.approach.path)
        points = approach_points(run.vut.approach)
        end_ns = seconds_to_ns(float(points.columns[0, -1])) + 1
        self._approach = Reference(
            "approach", run.vut.id, run.event_version, "approach", 0, 0, end_ns, points
        )
        self._tracker = Tracker(run.vut.cls, dt_s=run.step_s)
        self._frame_steps = max(1, round(driven.frame_period_s / run.step_s))
        self._first_ns = seconds_to_ns(driven.first_request_s)
        self._hand_over_ns = seconds_to_ns(driven.hand_over_s)
        period_s = self._frame_steps * run.step_s
        self._questions = (
            None if driver is None else Questions(run, driven, driver, period_s, frames)
        )
        self._plans = PlansInEffect(run)
        self._cruise = Cruise(self._path)

    def step(
        self, step: int, now_ns: int, vut: ObjectState, truths: Sequence[ObjectState]
    ) -> tuple[Command | None, DriveReport]:
        """Return the command until the next step, None while the built-in driver leads.

        Args:
            step: of the world.
            now_ns: session time.
            vut: its newest reported state.
            truths: true states of everything; privileged drivers alone see them.
        """
        questions = self._questions
        if questions is None:
            return self._commanded(now_ns, vut)
        questions.see(step, now_ns, truths)
        answered, question, answer = self._take_due(questions, now_ns), None, None
        if step % self._frame_steps == 0:
            questions.remember(vut)
            if questions.may_ask and now_ns >= self._first_ns:
                question, answer = questions.ask(now_ns, vut, self._route(vut), truths)
                # Without latency it is effective in the step of its frame.
                answered = self._take_due(questions, now_ns) or answered
        mode, reference, fresh = DriveMode.COMMAND, self._approach, None
        if now_ns >= self._hand_over_ns:
            mode, reference = self._plans.effective(now_ns, vut)
            fresh = self._plans.if_new(reference)
        command, _ = self._tracker.track(vut, reference, now_ns)
        ended, ends_with = questions.ended, questions.ends_with
        return command, DriveReport(mode, answered, fresh, question, answer, ended, ends_with)

    def lead(
        self,
        world: World,
        vut: ObjectState,
        truths: Sequence[ObjectState],
        commands: dict[str, tuple[int, Command]],
    ) -> DriveReport:
        """Lead the VUT until the next step, from where it reported to be.

        Args:
            world: in its present state.
            vut: its newest reported state.
            truths: true states of everything.
            commands: takes the VUT's; the built-in driver leads where it has none.
        """
        command, report = self.step(world.step_index, world.now_ns, vut, truths)
        commands.pop(vut.object_id, None)
        if command is not None:
            commands[vut.object_id] = world.step_index, command
        return report

    def _take_due(self, questions: Questions, now_ns: int) -> EffectiveAnswer | None:
        """Take the open answer if it is effective now, and its plan."""
        due = questions.due(now_ns)
        if due is None:
            return None
        answered, plan = due
        self._plans.take(plan)
        return answered

    def _commanded(self, now_ns: int, vut: ObjectState) -> tuple[Command | None, DriveReport]:
        if now_ns >= self._first_ns:
            self._cruise.see(vut)
        if now_ns < self._hand_over_ns:
            command, _ = self._tracker.track(vut, self._approach, now_ns)
            return command, DriveReport(DriveMode.COMMAND)
        if self._driven.driver == BUILT_IN:
            return None, DriveReport(DriveMode.BUILT_IN)
        return self._cruise.command(vut), DriveReport(DriveMode.COMMAND)

    def _route(self, vut: ObjectState) -> tuple[Point, ...]:
        station, _ = self._path.project_beyond(vut.x_m, vut.y_m)
        count = round(ROUTE_M / ROUTE_STEP_M)
        places = (self._path.pose(station + i * ROUTE_STEP_M) for i in range(count + 1))
        return tuple(vut.pose.to_local(place.x_m, place.y_m) for place in places)


def pilot_of(run: RunSpec, driven: Driven, driver: PlanDriver | SeeingDriver | None) -> Pilot:
    """Return the pilot of a driven run, with the frames of a driver that sees.

    Raises:
        InputError: the driver sees, and the run has no camera, or one that a server draws.
    """
    if not isinstance(driver, SeeingDriver):
        return Pilot(run, driven, driver)
    if run.camera is None or run.camera.renderer != "raster":
        raise InputError(
            "its driver sees, and gets the frames of our own renderer",
            field="camera",
            value=None if run.camera is None else run.camera.renderer,
            remedy="give --camera raster, and not --no-camera",
        )
    return Pilot(run, driven, driver, QuestionFrames(run, driver.frame_span_s))
