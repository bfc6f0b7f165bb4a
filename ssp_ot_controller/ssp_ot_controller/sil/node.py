"""The sil_world node: owns the simulated world, paces it, publishes its truth."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg

from ssp_core import names, ros
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.conversions import state_to_msg
from ssp_core.run_spec import load_run
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.vocab import SessionPhase
from ssp_msgs.msg import (
    ActuatorCommand,
    Heartbeat,
    ObjectState,
    SafetyEvent,
    SessionState,
    StepDone,
    WorldTick,
)
from ssp_ot_controller.core.bodies import Command
from ssp_ot_controller.sil.barrier import Barrier
from ssp_ot_controller.sil.disturbance import Localisation, make_link
from ssp_ot_controller.sil.sumo_world import SumoWorld
from ssp_ot_controller.sil.world import World

HOLD_PERIOD_S = 0.1
# Lockstep: a participant that keeps the world waiting this long on the steady clock is dropped.
HANG_LIMIT_S = 1.5
# Realtime: falling behind the wall clock by more than this makes the run invalid.
OVERRUN_S = 0.1
_OVER = (SessionPhase.FINISHED, SessionPhase.ABORTED, SessionPhase.IDLE)


class SilWorld(Node):
    """Thin node around sil.world.World."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.SIL_WORLD, namespace=names.NAMESPACE)
        run_file = self.declare_parameter("run_file", "").value
        self._run = load_run(run_file)
        self._work_dir = tempfile.TemporaryDirectory(prefix="ssp-sumo-")
        self._sumo = SumoWorld(self._run, Path(self._work_dir.name))
        self._sumo.__enter__()
        self._world = World(self._run, self._sumo)
        self._lockstep = self._run.mode == "lockstep"
        self._localisation = Localisation(self._run.disturbance, self._run.seed, names.VUT_ID)
        self._link = make_link(
            self._run.disturbance, self._run.seed, names.VUT_ID, self._run.step_s
        )
        camera = self._run.camera
        self._barrier = Barrier(
            (names.OBJECT_TARGET, names.SCENARIO_MANAGER),
            [t.id for t in self._run.targets],
            names.OBJECT_TARGET,
            names.FRONT_CAMERA if camera is not None else None,
            max(1, round(1.0 / (camera.rate_hz * self._run.step_s))) if camera is not None else 1,
            names.SCENARIO_MANAGER,
        )
        self._commands: dict[str, tuple[int, Command]] = {}
        self._session = SessionPhase.UNKNOWN
        self._heartbeat = 0
        self._heartbeat_arrived_ns = time.monotonic_ns()
        self._vut_states_sent = 0
        self._running = False
        self._over = False
        self._waiting_since_ns = time.monotonic_ns()
        self._started_ns = 0
        self._overrun_told = False
        self._vut_reported = self._localisation.measure(self._world.vut())
        self._make_endpoints()

    def _make_endpoints(self) -> None:
        pub, sub = self.create_publisher, self.create_subscription
        self._pub_clock = pub(ClockMsg, names.CLOCK, ros.STATE)
        self._pub_tick = pub(WorldTick, names.WORLD_TICK, ros.STATE)
        self._pub_vut = pub(ObjectState, names.state_topic(names.VUT_ID), ros.STATE)
        self._pub_safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        sub(StepDone, names.STEP_DONE, self._on_done, ros.STATE)
        sub(ActuatorCommand, names.ACTUATOR_COMMAND, self._on_command, ros.COMMAND)
        sub(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(HOLD_PERIOD_S, self._on_hold_timer, clock=steady)
        if not self._lockstep:
            sub(Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.STATE)
            self.create_timer(self._run.step_s, self._on_pace_timer, clock=steady)

    # -- what arrives --------------------------------------------------------------------------

    def _on_command(self, message: ActuatorCommand) -> None:
        self._commands[message.object_id] = (
            message.step,
            Command(
                message.acceleration, message.curvature, message.heading, message.emergency_stop
            ),
        )
        self._barrier.on_command(message.object_id, message.step)
        self._go_on()

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self._heartbeat_arrived_ns = time.monotonic_ns()

    def _on_done(self, message: StepDone) -> None:
        self._barrier.on_done(message.participant, message.step)
        if message.participant == names.SCENARIO_MANAGER and self._lockstep:
            self._heartbeat = max(self._heartbeat, message.heartbeat)
            self._take_session(SessionPhase(message.session_state))
        self._go_on()

    def _on_session(self, message: SessionState) -> None:
        """Realtime only: in lockstep the manager's answers carry the state, in step order."""
        if not self._lockstep:
            self._take_session(SessionPhase(message.state))

    def _take_session(self, session: SessionPhase) -> None:
        self._session = session
        if session is SessionPhase.RUNNING and not self._running and not self._over:
            self._running = True
            self._started_ns = self._waiting_since_ns = time.monotonic_ns()

    # -- stepping ------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Lockstep: steps as soon as nobody is waited for."""
        if not (self._lockstep and self._running):
            return
        if not self._barrier.waiting_for(self._world.step_index):
            self._step()

    def _step(self) -> None:
        manager_lost = self._manager_lost()
        drive_vut = self._session is SessionPhase.RUNNING and not manager_lost
        self._world.advance(self._commands, drive_vut)
        self._waiting_since_ns = time.monotonic_ns()
        over = manager_lost or self._session in _OVER
        if over and self._world.all_stand():
            self._running = False
            self._over = True
        vut = self._localisation.measure(self._world.vut())
        arrived = self._link.pass_on(vut)
        if arrived is not None:
            self._vut_states_sent += 1
            self._vut_reported = arrived
            self._pub_vut.publish(state_to_msg(arrived))
        self._publish_tick()

    def _manager_lost(self) -> bool:
        """The VUT's driver stops when nobody leads the session any more."""
        if self._lockstep:
            return names.SCENARIO_MANAGER in self._barrier.dropped
        silence_s = (time.monotonic_ns() - self._heartbeat_arrived_ns) / NS_PER_S
        return silence_s > self._run.limits.heartbeat_s

    def _on_pace_timer(self) -> None:
        """Realtime: one step a period, and the truth about falling behind."""
        if not self._running:
            return
        behind_s = ns_to_seconds(time.monotonic_ns() - self._started_ns - self._world.now_ns)
        if behind_s > OVERRUN_S and not self._overrun_told:
            self._overrun_told = True
            self._announce(SafetyCode.OVERRUN, names.SIL_WORLD, behind_s, OVERRUN_S)
        self._step()

    def _on_hold_timer(self) -> None:
        """While holding: repeats the present state. While stepping: watches for the silent."""
        if not self._running:
            self._pub_vut.publish(state_to_msg(self._vut_reported))
            self._publish_tick()
            return
        waited_s = (time.monotonic_ns() - self._waiting_since_ns) / NS_PER_S
        if self._lockstep and waited_s > HANG_LIMIT_S:
            for participant in self._barrier.lost(self._world.step_index):
                self._barrier.drop(participant)
                self._announce(SafetyCode.PARTICIPANT_LOST, participant, waited_s, HANG_LIMIT_S)
            self._waiting_since_ns = time.monotonic_ns()
        if self._lockstep and self._barrier.dropped:
            # Those that were dropped send nothing that would make the world go on.
            for _ in range(round(HOLD_PERIOD_S / self._run.step_s)):
                self._go_on()

    # -- sending -------------------------------------------------------------------------------

    def _publish_tick(self) -> None:
        stamp = ros.stamp_from_ns(self._world.now_ns)
        self._pub_clock.publish(ClockMsg(clock=stamp))
        message = WorldTick(
            step=self._world.step_index,
            running=self._running,
            lockstep=self._lockstep,
            heartbeat=self._heartbeat,
            vut_states_sent=self._vut_states_sent,
            objects=[state_to_msg(s) for s in self._world.objects()],
        )
        message.header.stamp = stamp
        message.header.frame_id = names.MAP_FRAME
        self._pub_tick.publish(message)

    def _announce(self, code: SafetyCode, who: str, measured: float, limit: float) -> None:
        meaning = MEANINGS[code]
        message = SafetyEvent(
            code=int(code),
            limit_name=meaning.limit_name,
            source=self.get_name(),
            object_id=who,
            measured=measured,
            limit=limit,
            unit=meaning.unit,
            reaction="abort",
        )
        message.header.stamp = ros.stamp_from_ns(self._world.now_ns)
        message.header.frame_id = names.MAP_FRAME
        self._pub_safety.publish(message)
        self.get_logger().error(f"{meaning.limit_name}: {who} after {measured:.2f} s")

    def close(self) -> None:
        self._sumo.__exit__(None, None, None)
        self._work_dir.cleanup()


def main() -> None:
    """Entry point of the node."""
    sys.exit(ros.run_node(SilWorld, lambda node: node.close()))


if __name__ == "__main__":
    main()
