"""The pacing of the simulated world without ROS: its steps, its holds, whom it gives up.

This file owns the session's phase as the world knows it, the answers that the present step still
needs, and how long they have been missing. It reads no clock: each call brings the time of a
steady one. A session that is over, with everything at a standstill, doesn't run again.
"""

from __future__ import annotations

from collections.abc import Iterator

from ssp_core import names
from ssp_core.cdr.steps import BodyCommand, StepDone
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.plant import LimitFact
from ssp_ot_controller.sil.patience import BUSY_LIMIT_S, DriverHold, Patience
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S
from ssp_ot_controller.sil.world import OVER, StepBarrier, World

# An external driver that is heard while the world holds is one that may drive.
DRIVER_FRESH_S = 1.0
# A hold at a step for a model's answer is told so often; nobody's limit is near it.
HOLD_TOLD_S = 1.0
# Realtime: falling behind the wall clock by more than this makes the run invalid.
OVERRUN_S = 0.1


class Pacing:
    """The steps of one session's world.

    Args:
        run: its run file.
        now_ns: the steady clock, ns.

    Attributes:
        session: phase of the session.
        heartbeat: number of the manager's last heartbeat; in lockstep only.
        running: the world steps; otherwise it holds.
    """

    def __init__(self, run: RunSpec, now_ns: int) -> None:
        self._run = run
        self._barrier = _barrier_of(run)
        self._patience = Patience(now_ns)
        driven = run.driven
        is_asked_later = driven is not None and driven.first_request_s > 0.0
        self._hold = DriverHold(BUSY_LIMIT_S, HOLD_TOLD_S, int(is_asked_later))
        self.session = SessionPhase.UNKNOWN
        self.heartbeat = 0
        self.running = False
        self._over = False
        self._heard_manager_ns = now_ns
        self._started_ns = 0
        self._overrun_reported = False
        self._driver_loss_reported = False

    @property
    def lockstep(self) -> bool:
        """True where the world waits for every answer; otherwise it steps in real time."""
        return self._run.mode == "lockstep"

    # -- what arrives --------------------------------------------------------------------------

    def on_command(self, command: BodyCommand) -> None:
        """Take an object's command as part of the answer to its step."""
        self._barrier.on_command(command.object_id, command.step)

    def on_driver(self, command: BodyCommand, is_finite: bool, now_ns: int) -> bool:
        """Take a command of an external driver, which in lockstep answers its step.

        Args:
            command: the command.
            is_finite: False: the driver is there, and waits for the VUT's first state or for its
                model's answer.
            now_ns: the steady clock, ns.

        Returns:
            Whether the VUT is to be driven by it.
        """
        self._hold.hear(now_ns)
        if self._run.driven is not None and not is_finite:
            self._hold.wait(command.step)
            return False
        self._barrier.on_done(names.VUT_DRIVER, command.step)
        # Of the state before the start there are any number, and none is driven by.
        return not (self.lockstep and command.step == 0 and self._run.driven is None)

    def on_heartbeat(self, now_ns: int) -> None:
        """Take a sign of life of the manager."""
        self._heard_manager_ns = now_ns

    def on_done(self, step_done: StepDone, now_ns: int) -> None:
        """Take a participant's answer to a step; in lockstep the manager's brings the session."""
        self._barrier.on_done(step_done.participant, step_done.step)
        if step_done.participant == names.SCENARIO_MANAGER and self.lockstep:
            self.heartbeat = max(self.heartbeat, step_done.heartbeat)
            self.take_session(step_done.session_state, now_ns)

    def take_session(self, session: SessionPhase, now_ns: int) -> None:
        """Take the session's phase; the world steps from when it first says ``RUNNING``."""
        self.session = session
        if session is SessionPhase.RUNNING and not self.running and not self._over:
            self.running = True
            self._started_ns = now_ns
            self._patience.begin(now_ns)

    # -- what may happen now -------------------------------------------------------------------

    def may_start(self, now_ns: int) -> bool:
        """Tell whether a session may start; until then the VUT reports nothing of itself.

        Its driver is heard; in lockstep also everybody whom the world is going to wait for.
        """
        # A driver that waits for the VUT's first state is heard, though it has answered nothing.
        if self.lockstep and set(self._barrier.unheard()) - {names.VUT_DRIVER}:
            return False
        if not self._run.has_driver_node:
            return True
        heard_ns = self._hold.last_sign_ns
        return heard_ns is not None and now_ns - heard_ns <= DRIVER_FRESH_S * NS_PER_S

    def may_step(self, step: int) -> bool:
        """Tell whether everything that is waited for at a step is there, in lockstep."""
        return self.lockstep and self.running and not self._barrier.waiting_for(step)

    def manager_lost(self, now_ns: int) -> bool:
        """Tell whether the manager is lost; the VUT's driver stops then."""
        if self.lockstep:
            return names.SCENARIO_MANAGER in self._barrier.dropped
        silence_s = (now_ns - self._heard_manager_ns) / NS_PER_S
        return silence_s > self._run.limits.heartbeat_s

    def has_dropped(self) -> bool:
        """Tell whether the world goes on without somebody, whose answer makes it step no more."""
        return bool(self._barrier.dropped)

    # -- what a step and the time passed change ------------------------------------------------

    def on_step(self, world: World, manager_lost: bool, now_ns: int) -> list[LimitFact]:
        """Take that the world made a step; return what it shows of the VUT's external driver.

        Args:
            world: after the step.
            manager_lost: it was made without a manager.
            now_ns: the steady clock, ns.
        """
        self._patience.begin(now_ns)
        if (manager_lost or self.session in OVER) and world.all_stand():
            self.running = False
            self._over = True
        driver = world.driver
        if self._driver_loss_reported or not driver.external_is_silent:
            return []
        self._driver_loss_reported = True
        silence_s = driver.external_silence_s
        return [_lost(names.VUT_DRIVER, silence_s, DRIVER_TIMEOUT_S, world.now_ns)]

    def overrun(self, world_ns: int, now_ns: int) -> LimitFact | None:
        """Return that the world fell behind the wall clock in real time, the first time only.

        Args:
            world_ns: the world's own time, ns.
            now_ns: the steady clock, ns.
        """
        behind_s = ns_to_seconds(now_ns - self._started_ns - world_ns)
        if behind_s <= OVERRUN_S or self._overrun_reported:
            return None
        self._overrun_reported = True
        world = names.SIL_WORLD
        return LimitFact(SafetyCode.OVERRUN, world, world, behind_s, OVERRUN_S, world_ns)

    def look(self, now_ns: int, idle_s: float | None) -> None:
        """Count the time since the last look; see ``Patience.look``."""
        self._patience.look(now_ns, idle_s)

    def drop_the_lost(self, step: int, world_ns: int, now_ns: int) -> Iterator[LimitFact]:
        """Drop those whose answer to a step is overdue, in lockstep, and yield each.

        The recorder isn't among them: the manager watches it by itself, and knows more of it.

        Args:
            step: the present step.
            world_ns: the world's own time, ns.
            now_ns: the steady clock, ns.
        """
        if not (self.lockstep and self._patience.may_end):
            return
        lost = self._barrier.lost(step)
        if self.driver_waits(step, now_ns):
            lost.remove(names.VUT_DRIVER)
        waited_s = self._patience.waited_s
        for participant, limit_s in self._patience.overdue(
            lost, names.FRONT_CAMERA, now_ns
        ).items():
            self._barrier.drop(participant)
            self._driver_loss_reported = (
                self._driver_loss_reported or participant == names.VUT_DRIVER
            )
            if participant != names.MONITOR:
                yield _lost(participant, waited_s, limit_s, world_ns)

    def driver_waits(self, step: int, now_ns: int) -> bool:
        """Tell whether the driver's node says that it waits for the answer to this step's frame.

        A model is as slow as it is; a node that is silent is lost.
        """
        return self._hold.is_at(step, now_ns) and names.VUT_DRIVER in self._barrier.lost(step)

    def is_hold_report_due(self, step: int, now_ns: int) -> bool:
        """Tell whether the step is said again while a model is waited for: a hold is no silence."""
        return self._hold.is_report_due(now_ns, holds=self.driver_waits(step, now_ns))


def _barrier_of(run: RunSpec) -> StepBarrier:
    camera = run.camera
    external = (names.VUT_DRIVER,) if run.has_driver_node else ()
    return StepBarrier(
        (names.OBJECT_TARGET, names.SCENARIO_MANAGER, *external),
        [t.id for t in run.targets],
        names.OBJECT_TARGET,
        names.FRONT_CAMERA if camera is not None else None,
        max(1, round(1.0 / (camera.rate_hz * run.step_s))) if camera is not None else 1,
        names.SCENARIO_MANAGER,
        names.MONITOR,
    )


def _lost(participant: str, waited_s: float, limit_s: float, world_ns: int) -> LimitFact:
    code, source = SafetyCode.PARTICIPANT_LOST, names.SIL_WORLD
    return LimitFact(code, source, participant, waited_s, limit_s, world_ns)
