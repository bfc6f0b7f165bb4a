"""The questions of one driven run to its driver: asked one at a time, and answered after L.

This file owns which question is open, what it is asked about, and why the driver has ended: a
driver that ended is not asked again. The world holds while a question is asked. Reads no clock.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import SspError
from ssp_core.geometry import Point
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import (
    Answer,
    EffectiveAnswer,
    GivenAnswer,
    PlanDriver,
    PrivilegedTruth,
    Question,
    SeeingDriver,
    SeenFrame,
    history_of,
)
from ssp_ot_controller.driving.frames import FreshFrames, QuestionFrames
from ssp_ot_controller.driving.plan import MapPlan, plan_of

HISTORY_S = 1.7


def _words(error: BaseException) -> str:
    return str(error) if isinstance(error, SspError) else f"{type(error).__name__}: {error}"


@dataclass(frozen=True, slots=True)
class _Open:
    """A question whose answer isn't effective yet."""

    question: Question
    answer: GivenAnswer
    vut: ObjectState
    latency_ns: int


class Questions:
    """One driver, what it is shown, and the question that is open.

    Args:
        run: with its ``driven``.
        frame_period_s: of the frames that it is asked about, in whole steps.
        frames: of a driver that sees; None: it sees nothing.

    Attributes:
        ended: why the driver has ended; empty while it goes on.
    """

    def __init__(
        self,
        run: RunSpec,
        driven: Driven,
        driver: PlanDriver | SeeingDriver,
        frame_period_s: float,
        frames: QuestionFrames | None = None,
    ) -> None:
        self.ended = ""
        self._run = run
        self._seed = driven.sampling_seed(run.seed)
        self._observable_s = driven.observable_s
        self._driver = driver
        # None: it is measured.
        latency = driven.latency
        self._latency_ns = None if latency.measured else seconds_to_ns(latency.seconds)
        self._frames, self._fresh = frames, FreshFrames()
        kept_s = HISTORY_S
        if isinstance(driver, SeeingDriver):
            kept_s = max(kept_s, driver.history_s, driver.frame_span_s)
        self._vut_states: deque[ObjectState] = deque(
            maxlen=1 + math.ceil(kept_s / frame_period_s - 1e-6)
        )
        self._question_count = 0
        self._open: _Open | None = None

    @property
    def may_ask(self) -> bool:
        """True while no question is open and the driver goes on."""
        return self._open is None and not self.ended

    @property
    def ends_with(self) -> str:
        """Reason for which the driver ends once the open answer is due; empty: it goes on."""
        return "" if self._open is None else self._open.answer.ended

    def see(self, step: int, now_ns: int, truths: Sequence[ObjectState]) -> None:
        """Take the true states of a step, of which a frame may be drawn."""
        if self._frames is not None:
            self._frames.see(step, now_ns, truths)

    def remember(self, vut: ObjectState) -> None:
        """Take the VUT's state at a frame; the world repeats its first step while it holds."""
        if not self._vut_states or self._vut_states[-1].stamp_ns < vut.stamp_ns:
            self._vut_states.append(vut)

    def ask(
        self,
        now_ns: int,
        vut: ObjectState,
        route_m: tuple[Point, ...],
        truths: Sequence[ObjectState],
    ) -> tuple[Question, GivenAnswer]:
        """Ask about the frame of now, and wait for what comes of it: the world holds.

        Args:
            now_ns: session time.
            vut: its newest reported state.
            route_m: places ahead on its path, in its own frame.
            truths: true states of everything; privileged drivers alone see them.
        """
        self._question_count += 1
        frames = self._question_frames(now_ns)
        question = Question(
            number=self._question_count,
            stamp_ns=now_ns,
            history=history_of(self._vut_states),
            route_m=route_m,
            frames=frames,
            camera=self._run.camera if frames else None,
            pose=vut.pose,
            seed=self._seed,
        )
        driver = self._driver
        if isinstance(driver, SeeingDriver):
            answer = driver.give(question)
        else:
            answer = self._computed(driver, question, truths)
        latency_ns = answer.latency.total_ns if self._latency_ns is None else self._latency_ns
        self._open = _Open(question, answer, vut, latency_ns)
        return question, answer

    def _computed(
        self, driver: PlanDriver, question: Question, truths: Sequence[ObjectState]
    ) -> GivenAnswer:
        """Ask a driver that computes here: it takes no time."""
        driver_question = question
        if driver.privileged:
            observable_s = self._observable_s
            observable_ns = None if observable_s is None else seconds_to_ns(observable_s)
            driver_question = replace(
                question, privileged=PrivilegedTruth(tuple(truths), observable_ns)
            )
        try:
            return GivenAnswer(driver.answer(driver_question))
        except (Exception, SystemExit) as error:  # whatever a driver raises is the driver's end
            return GivenAnswer(None, ended=_words(error))

    def _question_frames(self, now_ns: int) -> tuple[SeenFrame, ...]:
        """Return the frames of a question, which are held against the VUT's way."""
        if not isinstance(self._driver, SeeingDriver) or self._frames is None:
            return ()
        frames = self._frames.show(self._driver.choose(self._frames.stamps_ns))
        self._fresh.check(frames, now_ns, self._vut_states)
        return frames

    def due(self, now_ns: int) -> tuple[EffectiveAnswer, MapPlan | None] | None:
        """Take the open answer if it is effective now, with its plan in the map frame.

        The plan is None where it is refused; the answer says why.
        """
        due = self._open
        if due is None or now_ns < due.question.stamp_ns + due.latency_ns:
            return None
        self._open, question, answer = None, due.question, due.answer.answer
        if due.answer.ended:
            self.ended = due.answer.ended
            return None
        try:
            plan = self._read(question, answer, due.vut)
        except (SspError, AttributeError, TypeError, ValueError, IndexError) as error:
            self.ended = f"its answer can't be read: {_words(error)}"
            return None
        if answer is None:
            raise ValueError("an answer that was read is there")
        refused = plan if isinstance(plan, str) else ""
        latency_s = ns_to_seconds(due.latency_ns)
        answered = EffectiveAnswer(question.number, question.stamp_ns, latency_s, answer, refused)
        return answered, None if isinstance(plan, str) else plan

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
