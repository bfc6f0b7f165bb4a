"""The sil_world node: owns the simulated world, paces it, publishes its truth."""

from __future__ import annotations

import faulthandler
import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMsg
from std_msgs.msg import String

from ssp_core import names, ros
from ssp_core.carla.acceptance import ServerOfRun
from ssp_core.cdr import steps
from ssp_core.cdr.states import encode_state
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.hashing import canonical_json
from ssp_core.run_file.model import load_run
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.event_messages import encode_fault, encode_limit
from ssp_core.world.plant import LimitFact
from ssp_msgs.msg import (
    ActuatorCommand,
    ActuatorCommands,
    FaultEvent,
    Heartbeat,
    ObjectState,
    SafetyEvent,
    SessionState,
    StepDone,
    WorldTick,
)
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.driving.commanded import WorldsVut
from ssp_ot_controller.ros.parameters import SIL_WORLD
from ssp_ot_controller.sil.disturbance import FaultChange
from ssp_ot_controller.sil.patience import BUSY_LIMIT_S, DriverHold, Patience, idle_s
from ssp_ot_controller.sil.plant import BodyPlant, OwnBodies
from ssp_ot_controller.sil.scene import scene_of
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S
from ssp_ot_controller.sil.world import OVER, StepBarrier, World

HOLD_PERIOD_S = 0.1
# An external driver that is heard while the world holds is one that may drive.
DRIVER_FRESH_S = 1.0
# A hold at a step for a model's answer is told so often; nobody's limit is near it.
HOLD_TOLD_S = 1.0
CLOSE_LIMIT_S = 4.0
# Realtime: falling behind the wall clock by more than this makes the run invalid.
OVERRUN_S = 0.1


class SilWorld(Node):
    """Thin node around sil.world.World."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__(names.SIL_WORLD, namespace=names.NAMESPACE)
        given = ros.declare(self, SIL_WORLD)
        run_file = given["run_file"]
        self._run = load_run(run_file)
        if self._run.mode == "live":
            raise InputError(
                "a live session has no simulated world",
                file=run_file,
                field="mode",
                value="live",
                remedy="start it without sil_world, or run it in mode lockstep or realtime",
            )
        # Connecting to a server takes seconds: do it before anybody can see this node.
        self._plant = self._make_plant(given["carla"], given["map_file"])
        self._surroundings = ExitStack()
        scene = self._surroundings.enter_context(scene_of(self._run))
        self._world = World(self._run, scene, self._plant)
        self._lockstep = self._run.mode == "lockstep"
        self._vut = WorldsVut(self._run)
        camera = self._run.camera
        external = (names.VUT_DRIVER,) if self._run.has_driver_node else ()
        self._barrier = StepBarrier(
            (names.OBJECT_TARGET, names.SCENARIO_MANAGER, *external),
            [t.id for t in self._run.targets],
            names.OBJECT_TARGET,
            names.FRONT_CAMERA if camera is not None else None,
            max(1, round(1.0 / (camera.rate_hz * self._run.step_s))) if camera is not None else 1,
            names.SCENARIO_MANAGER,
            names.MONITOR,
        )
        self._commands: dict[str, tuple[int, Command]] = {}
        self._session = SessionPhase.UNKNOWN
        self._heartbeat = 0
        self._heartbeat_arrived_ns = time.monotonic_ns()
        self._vut_states_sent = 0
        self._running = False
        self._over = False
        self._patience = Patience(time.monotonic_ns())
        self._started_ns = 0
        self._overrun_told = False
        self._driver_told = False
        driven = self._run.driven
        is_asked_later = driven is not None and driven.first_request_s > 0.0
        self._hold = DriverHold(BUSY_LIMIT_S, HOLD_TOLD_S, int(is_asked_later))
        self._make_endpoints()

    def _make_plant(self, carla: str, map_file: str) -> BodyPlant:
        if self._run.plant == "bodies":
            return OwnBodies(self._run)
        server = ServerOfRun.of_parameters(carla, map_file, "--plant")

        def tell(record: Mapping[str, Any]) -> None:
            said = self.create_publisher(String, names.WORLD_PLANT, ros.LATCHED)
            said.publish(String(data=canonical_json(record).decode()))

        from ssp_ot_controller.sil.carla_bodies import CarlaBodies

        return CarlaBodies(self._run, server.address, server.map_sha256, tell)

    def _make_endpoints(self) -> None:
        pub, raw = self.create_publisher, partial(ros.subscribe_raw, self)
        self._pub_clock = pub(ClockMsg, names.CLOCK, ros.STATE)
        self._pub_tick = pub(WorldTick, names.WORLD_TICK, ros.STATE)
        self._pub_vut = pub(ObjectState, names.state_topic(names.VUT_ID), ros.STATE)
        self._pub_safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._pub_fault = pub(FaultEvent, names.FAULT_EVENT, ros.LATCHED)
        raw(StepDone, names.STEP_DONE, steps.decode_done, self._on_done, ros.STATE)
        commands = names.ACTUATOR_COMMANDS
        raw(ActuatorCommands, commands, steps.decode_commands, self._on_commands, ros.COMMAND)
        if not self._lockstep:
            # There the manager's answers carry the state, in step order.
            state, take = names.SESSION_STATE, self._take_session
            raw(SessionState, state, _session_of, take, ros.LATCHED, raw=False)
        if self._run.has_driver_node:
            topic, decode = names.VUT_COMMAND, steps.decode_command
            raw(ActuatorCommand, topic, decode, self._on_vut_command, ros.COMMAND)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(HOLD_PERIOD_S, self._on_hold_timer, clock=steady)
        if not self._lockstep:
            raw(Heartbeat, names.HEARTBEAT, steps.decode_heartbeat, self._on_heartbeat, ros.STATE)
            self.create_timer(self._run.step_s, self._on_pace_timer, clock=steady)

    # -- what arrives --------------------------------------------------------------------------

    def _on_commands(self, message: steps.BodyCommands) -> None:
        for one in message.commands:
            if one.object_id != names.VUT_ID:
                self._commands[one.object_id] = one.step, _command(one)
                self._barrier.on_command(one.object_id, one.step)
        self._go_on()

    def _on_vut_command(self, message: steps.BodyCommand) -> None:
        """Take a command of an external driver; in lockstep it answers its step."""
        self._hold.hear(time.monotonic_ns())
        command = _command(message)
        if self._run.driven is not None and not command.is_finite:
            # It is there, and waits: for the VUT's first state, or for its model's answer.
            self._hold.wait(message.step)
            return
        self._barrier.on_done(names.VUT_DRIVER, message.step)
        if self._lockstep and message.step == 0 and self._run.driven is None:
            # Of the state before the start there are any number, and none is driven by.
            return
        self._commands[names.VUT_ID] = message.step, command
        self._go_on()

    def _on_heartbeat(self, _beat: steps.Heartbeat) -> None:
        self._heartbeat_arrived_ns = time.monotonic_ns()

    def _on_done(self, message: steps.StepDone) -> None:
        self._barrier.on_done(message.participant, message.step)
        if message.participant == names.SCENARIO_MANAGER and self._lockstep:
            self._heartbeat = max(self._heartbeat, message.heartbeat)
            self._take_session(message.session_state)
        self._go_on()

    def _take_session(self, session: SessionPhase) -> None:
        self._session = session
        if session is SessionPhase.RUNNING and not self._running and not self._over:
            self._running = True
            self._started_ns = time.monotonic_ns()
            self._patience.begin(self._started_ns)

    # -- stepping ------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Step as soon as everything that is waited for is there, in lockstep."""
        if not (self._lockstep and self._running):
            return
        if not self._barrier.waiting_for(self._world.step_index):
            self._step()

    def _step(self) -> None:
        manager_lost = self._manager_lost()
        drive_vut = self._session is SessionPhase.RUNNING and not manager_lost
        before_ns = self._world.now_ns
        self._vut.lead(self._world, self._commands)
        self._world.advance(self._commands, drive_vut)
        self._patience.begin(time.monotonic_ns())
        self._report_driver(before_ns)
        over = manager_lost or self._session in OVER
        if over and self._world.all_stand():
            self._running = False
            self._over = True
        self._vut_states_sent += self._report_vut(running=True)
        self._publish_tick()

    def _report_driver(self, now_ns: int) -> None:
        """Publish faults of the VUT's driver that began or ended, and an external one's silence."""
        driver = self._world.driver
        self._publish_faults(driver.fault_changes, now_ns)
        driver.fault_changes.clear()
        if driver.external_is_silent and not self._driver_told:
            self._driver_told = True
            self._announce(
                SafetyCode.PARTICIPANT_LOST,
                names.VUT_DRIVER,
                driver.external_silence_s,
                DRIVER_TIMEOUT_S,
            )

    def _may_start(self) -> bool:
        """Tell whether a session may start; until then the VUT reports nothing of itself.

        Its driver is heard; in lockstep also everybody whom the world is going to wait for.
        """
        # A driver that waits for the VUT's first state is heard, though it has answered nothing.
        if self._lockstep and set(self._barrier.unheard()) - {names.VUT_DRIVER}:
            return False
        if not self._run.has_driver_node:
            return True
        heard_ns = self._hold.heard_ns
        return heard_ns is not None and time.monotonic_ns() - heard_ns <= DRIVER_FRESH_S * NS_PER_S

    def _publish_faults(self, changes: Iterable[FaultChange], now_ns: int) -> None:
        for change in changes:
            self._pub_fault.publish(encode_fault(change.fact(self.get_name(), now_ns)))

    def _report_vut(self, running: bool) -> int:
        """Send what the VUT reports of itself; return the number of states that arrive now."""
        now_ns, armed = self._world.now_ns, self._session is SessionPhase.ARMED
        changes = self._vut.channel.begin(now_ns, running=running, armed=armed)
        self._publish_faults(changes, now_ns)
        arrived = self._vut.report(self._world)
        for state in arrived:
            self._pub_vut.publish(encode_state(state))
        return len(arrived)

    def _manager_lost(self) -> bool:
        """Tell whether the manager is lost; the VUT's driver stops then."""
        if self._lockstep:
            return names.SCENARIO_MANAGER in self._barrier.dropped
        silence_s = (time.monotonic_ns() - self._heartbeat_arrived_ns) / NS_PER_S
        return silence_s > self._run.limits.heartbeat_s

    def _on_pace_timer(self) -> None:
        """Make one step a period in real time, and tell of falling behind."""
        if not self._running:
            return
        behind_s = ns_to_seconds(time.monotonic_ns() - self._started_ns - self._world.now_ns)
        if behind_s > OVERRUN_S and not self._overrun_told:
            self._overrun_told = True
            self._announce(SafetyCode.OVERRUN, names.SIL_WORLD, behind_s, OVERRUN_S)
        self._step()

    def _on_hold_timer(self) -> None:
        """Repeat the present state while holding; watch for the silent while stepping."""
        self._patience.look(time.monotonic_ns(), idle_s())
        if not self._running:
            if self._may_start():
                self._report_vut(running=False)
            self._publish_tick()
            return
        self._tell_hold(time.monotonic_ns())
        if self._lockstep and self._patience.may_end:
            self._drop_the_lost()
        if self._lockstep and self._barrier.dropped:
            # Those that were dropped send nothing that would make the world go on.
            for _ in range(round(HOLD_PERIOD_S / self._run.step_s)):
                self._go_on()

    def _drop_the_lost(self) -> None:
        lost = self._barrier.lost(self._world.step_index)
        if self._driver_waits(time.monotonic_ns()):
            lost.remove(names.VUT_DRIVER)
        waited_s = self._patience.waited_s
        overdue = self._patience.overdue(lost, names.FRONT_CAMERA, time.monotonic_ns())
        for participant, limit_s in overdue.items():
            self._barrier.drop(participant)
            self._driver_told = self._driver_told or participant == names.VUT_DRIVER
            if participant == names.MONITOR:
                # The manager watches the recorder by itself, and knows more of it.
                continue
            self._announce(SafetyCode.PARTICIPANT_LOST, participant, waited_s, limit_s)

    def _driver_waits(self, now_ns: int) -> bool:
        """Tell whether the driver's node says that it waits for the answer to this step's frame.

        A model is as slow as it is; a node that is silent is lost.
        """
        step = self._world.step_index
        return self._hold.is_at(step, now_ns) and names.VUT_DRIVER in self._barrier.lost(step)

    def _tell_hold(self, now_ns: int) -> None:
        """Say the present step again while a model is waited for: a hold is no silence."""
        if self._hold.is_to_be_told(now_ns, holds=self._driver_waits(now_ns)):
            self._publish_tick()

    # -- sending -------------------------------------------------------------------------------

    def _publish_tick(self) -> None:
        now_ns = self._world.now_ns
        tick = steps.WorldTick(
            stamp_ns=now_ns,
            step=self._world.step_index,
            running=self._running,
            lockstep=self._lockstep,
            heartbeat=self._heartbeat,
            vut_states_sent=self._vut_states_sent,
            objects=tuple(self._world.objects()),
        )
        self._pub_tick.publish(steps.encode_tick(tick))
        # Last: others work on the tick meanwhile.
        self._pub_clock.publish(steps.encode_clock(now_ns))

    def _announce(self, code: SafetyCode, who: str, measured: float, limit: float) -> None:
        passed = LimitFact(code, self.get_name(), who, measured, limit, self._world.now_ns)
        self._pub_safety.publish(encode_limit(passed))
        self.get_logger().error(f"{MEANINGS[code].limit_name}: {who} after {measured:.2f} s")

    def close(self) -> None:
        # A SUMO that doesn't come to its end has nothing left to write.
        faulthandler.dump_traceback_later(CLOSE_LIMIT_S, exit=True)
        for line in self._plant.close():
            self.get_logger().error(line)
        self._surroundings.close()


def _session_of(message: SessionState) -> SessionPhase:
    return SessionPhase(message.state)


def _command(command: steps.BodyCommand) -> Command:
    return Command(
        command.acceleration_mps2,
        command.curvature_1pm,
        command.heading_rad,
        command.emergency_stop,
    )


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(SilWorld, lambda node: node.close()))


if __name__ == "__main__":
    main()
