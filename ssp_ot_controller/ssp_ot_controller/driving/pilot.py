"""The driver's place in a session in one process: it asks, waits for L, and tracks what is due.

One question is open at a time. The frame of stamp t is asked about at t; the answer is effective at
the first step at or after t + L; the next question is that of the first frame at which none is open
(METHOD 8.3). The plan that is effective is tracked by time (8.4).

Up to the hand-over the VUT tracks its approach, as an object target does: a car-following driver
nears its speed so slowly that no run-up would be long enough for it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import SspError
from ssp_core.geometry import Polyline
from ssp_core.motion.approach import approach_points
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import (
    BUILT_IN,
    Answer,
    Answered,
    DriveMode,
    DriveReport,
    GivenAnswer,
    PlanDriver,
    Privileged,
    Question,
    SeeingDriver,
    SeenFrame,
    history_of,
)
from ssp_ot_controller.bodies.dynamics import LIMITS, Command
from ssp_ot_controller.control.tracker import Tracker
from ssp_ot_controller.driving.frames import FreshFrames, QuestionFrames
from ssp_ot_controller.driving.plan import MapPlan, fallback_of, plan_of
from ssp_ot_controller.sil.vut_driver import steer

HISTORY_S = 1.7
ROUTE_M = 80.0
_ROUTE_STEP_M = 2.0
# Speed is held with this gain; its loop with the drive's lag doesn't overshoot.
_HOLD_1PS = 1.0


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, SspError) else f"{type(error).__name__}: {error}"


@dataclass(frozen=True, slots=True)
class _Open:
    """A question whose answer isn't effective yet."""

    question: Question
    given: GivenAnswer
    vut: ObjectState
    latency_ns: int


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
        self._run = run
        self._driven = driven
        self._driver = driver
        self._path = Polyline(run.vut.approach.path)
        points = approach_points(run.vut.approach)
        end_ns = seconds_to_ns(float(points.columns[0, -1])) + 1
        self._approach = Reference(
            "approach", run.vut.id, run.event_version, "approach", 0, 0, end_ns, points
        )
        self._tracker = Tracker(run.vut.cls, dt_s=run.step_s)
        self._step_ns = seconds_to_ns(run.step_s)
        self._frame_steps = max(1, round(driven.frame_period_s / run.step_s))
        self._first_ns = seconds_to_ns(driven.first_request_s)
        self._hand_over_ns = seconds_to_ns(driven.hand_over_s)
        # None: it is measured.
        given = driven.latency
        self._latency_ns = None if given.measured else seconds_to_ns(given.seconds)
        self._frames, self._fresh = frames, FreshFrames()
        self._seeing = driver if isinstance(driver, SeeingDriver) else None
        kept_s = HISTORY_S
        if self._seeing is not None:
            kept_s = max(kept_s, self._seeing.history_s, self._seeing.frame_span_s)
        self._seen: deque[ObjectState] = deque(
            maxlen=1 + math.ceil(kept_s / (self._frame_steps * run.step_s) - 1e-6)
        )
        self._asked = 0
        self._open: _Open | None = None
        self._plan: MapPlan | None = None
        self._fallback: Reference | None = None
        self._tracked: Reference | None = None
        self._stale = False
        self._held_mps: float | None = None
        self._died = ""

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
        if self._driver is None:
            return self._commanded(now_ns, vut)
        if self._frames is not None:
            self._frames.see(step, now_ns, truths)
        answered, asked, given = self._due(now_ns), None, None
        if step % self._frame_steps == 0:
            # The world repeats its first step while it holds.
            if not self._seen or self._seen[-1].stamp_ns < vut.stamp_ns:
                self._seen.append(vut)
            if self._open is None and now_ns >= self._first_ns and not self._died:
                asked, given = self._ask(self._driver, now_ns, vut, truths)
                # Without latency it is effective in the step of its frame.
                answered = self._due(now_ns) or answered
        mode, reference, fresh = DriveMode.COMMAND, self._approach, None
        if now_ns >= self._hand_over_ns:
            mode, reference = self._effective(now_ns, vut)
            fresh = None if reference is self._tracked else reference
            self._tracked = reference
        command, _ = self._tracker.track(vut, reference, now_ns)
        dies = "" if self._open is None else self._open.given.ended
        return command, DriveReport(mode, answered, fresh, asked, given, self._died, dies)

    def _commanded(self, now_ns: int, vut: ObjectState) -> tuple[Command | None, DriveReport]:
        if now_ns < self._hand_over_ns:
            command, _ = self._tracker.track(vut, self._approach, now_ns)
            return command, DriveReport(DriveMode.COMMAND)
        if self._driven.driver == BUILT_IN:
            return None, DriveReport(DriveMode.BUILT_IN)
        if self._held_mps is None:
            self._held_mps = vut.speed_mps
        bounds = LIMITS[vut.object_class]
        wanted = _HOLD_1PS * (self._held_mps - vut.speed_mps)
        acceleration = min(max(wanted, -bounds.deceleration_mps2), bounds.acceleration_mps2)
        station, _ = self._path.project_beyond(vut.x_m, vut.y_m)
        curvature = steer(vut, self._path, station)
        return Command(acceleration, curvature, vut.yaw_rad), DriveReport(DriveMode.COMMAND)

    def _ask(
        self,
        driver: PlanDriver | SeeingDriver,
        now_ns: int,
        vut: ObjectState,
        truths: Sequence[ObjectState],
    ) -> tuple[Question, GivenAnswer]:
        """Ask about the frame of now, and wait for what comes of it: the world holds."""
        self._asked += 1
        frames = self._shown(now_ns)
        question = Question(
            number=self._asked,
            stamp_ns=now_ns,
            history=history_of(self._seen),
            route_m=self._route(vut),
            frames=frames,
            camera=self._run.camera if frames else None,
        )
        if isinstance(driver, SeeingDriver):
            given = driver.give(question)
        else:
            given = self._computed(driver, question, truths)
        latency_ns = given.latency.total_ns if self._latency_ns is None else self._latency_ns
        self._open = _Open(question, given, vut, latency_ns)
        return question, given

    def _computed(
        self, driver: PlanDriver, question: Question, truths: Sequence[ObjectState]
    ) -> GivenAnswer:
        """Ask a driver that computes here: it takes no time."""
        shown = question
        if driver.privileged:
            observable_s = self._driven.observable_s
            observable_ns = None if observable_s is None else seconds_to_ns(observable_s)
            shown = replace(question, privileged=Privileged(tuple(truths), observable_ns))
        try:
            return GivenAnswer(driver.answer(shown))
        except (Exception, SystemExit) as error:  # whatever a driver raises is the driver's end
            return GivenAnswer(None, ended=_words(error))

    def _shown(self, now_ns: int) -> tuple[SeenFrame, ...]:
        """Return the frames of a question, which are held against the VUT's way."""
        if self._seeing is None or self._frames is None:
            return ()
        frames = self._frames.show(self._seeing.choose(self._frames.stamps_ns))
        self._fresh.check(frames, now_ns, self._seen)
        return frames

    def _due(self, now_ns: int) -> Answered | None:
        """Take the open answer if it is effective now."""
        due = self._open
        if due is None or now_ns < due.question.stamp_ns + due.latency_ns:
            return None
        self._open, question, answer = None, due.question, due.given.answer
        if due.given.ended:
            self._died = due.given.ended
            return None
        try:
            plan = self._read(question, answer, due.vut)
        except (SspError, AttributeError, TypeError, ValueError, IndexError) as error:
            self._died = f"its answer can't be read: {_words(error)}"
            return None
        if answer is None:
            raise ValueError("an answer that was read is there")
        refused = plan if isinstance(plan, str) else ""
        if not isinstance(plan, str):
            self._plan = plan
        self._stale = bool(refused)
        latency_s = ns_to_seconds(due.latency_ns)
        return Answered(question.number, question.stamp_ns, latency_s, answer, refused)

    def _read(self, question: Question, answer: Answer | None, vut: ObjectState) -> MapPlan | str:
        """Return the plan of an answer in the map frame, or why it is refused."""
        if answer is None:
            raise TypeError("it is None")
        if answer.trajectory is None or answer.refused:
            return answer.refused or "not_ready"
        return plan_of(
            answer.trajectory,
            vut.pose,
            question.stamp_ns,
            self._run.step_s,
            f"plan-{question.number}",
            self._run.event_version,
        )

    def _effective(self, now_ns: int, vut: ObjectState) -> tuple[DriveMode, Reference]:
        plan = self._plan
        if plan is None:
            if self._fallback is None:
                self._fallback = fallback_of(
                    vut.pose, vut.speed_mps, now_ns, self._run.step_s, self._run.event_version
                )
            return DriveMode.FALLBACK, self._fallback
        if now_ns >= plan.end_ns:
            return DriveMode.FALLBACK, plan.reference
        return DriveMode.STALE if self._stale else DriveMode.PLAN, plan.reference

    def _route(self, vut: ObjectState) -> tuple[tuple[float, float], ...]:
        station, _ = self._path.project_beyond(vut.x_m, vut.y_m)
        count = round(ROUTE_M / _ROUTE_STEP_M)
        places = (self._path.pose(station + i * _ROUTE_STEP_M) for i in range(count + 1))
        return tuple(vut.pose.to_local(place.x_m, place.y_m) for place in places)
