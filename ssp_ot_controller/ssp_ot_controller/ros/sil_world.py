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
from ssp_core.errors import InputError
from ssp_core.hashing import canonical_json
from ssp_core.run_file.model import load_run
from ssp_core.safety.codes import MEANINGS
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
from ssp_ot_controller.sil.pacing import Pacing
from ssp_ot_controller.sil.patience import idle_s
from ssp_ot_controller.sil.plant import BodyPlant, OwnBodies
from ssp_ot_controller.sil.scene import scene_of
from ssp_ot_controller.sil.world import World

HOLD_PERIOD_S = 0.1
CLOSE_LIMIT_S = 4.0


class SilWorld(Node):
    """Thin node around ``sil.world.World`` and ``sil.pacing.Pacing``."""

    def __init__(self, _stop: ros.StopRequest) -> None:
        super().__init__(names.SIL_WORLD, namespace=names.NAMESPACE)
        parameters = ros.declare(self, SIL_WORLD)
        run_file = parameters["run_file"]
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
        self._plant = self._make_plant(parameters["carla"], parameters["map_file"])
        self._surroundings = ExitStack()
        scene = self._surroundings.enter_context(scene_of(self._run))
        self._world = World(self._run, scene, self._plant)
        self._pacing = Pacing(self._run, time.monotonic_ns())
        self._vut = WorldsVut(self._run)
        self._commands: dict[str, tuple[int, Command]] = {}
        self._vut_states_sent = 0
        self._make_endpoints()

    def _make_plant(self, carla: str, map_file: str) -> BodyPlant:
        if self._run.plant == "bodies":
            return OwnBodies(self._run)
        server = ServerOfRun.of_parameters(carla, map_file, "--plant")

        def tell(record: Mapping[str, Any]) -> None:
            publisher = self.create_publisher(String, names.WORLD_PLANT, ros.LATCHED)
            publisher.publish(String(data=canonical_json(record).decode()))

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
        if not self._pacing.lockstep:
            # There the manager's answers carry the state, in step order.
            state, take = names.SESSION_STATE, self._take_session
            raw(SessionState, state, _session_of, take, ros.LATCHED, raw=False)
        if self._run.has_driver_node:
            topic, decode = names.VUT_COMMAND, steps.decode_command
            raw(ActuatorCommand, topic, decode, self._on_vut_command, ros.COMMAND)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(HOLD_PERIOD_S, self._on_hold_timer, clock=steady)
        if not self._pacing.lockstep:
            raw(Heartbeat, names.HEARTBEAT, steps.decode_heartbeat, self._on_heartbeat, ros.STATE)
            self.create_timer(self._run.step_s, self._on_pace_timer, clock=steady)

    # -- what arrives --------------------------------------------------------------------------

    def _on_commands(self, message: steps.BodyCommands) -> None:
        for one in message.commands:
            if one.object_id != names.VUT_ID:
                self._commands[one.object_id] = one.step, _command(one)
                self._pacing.on_command(one)
        self._go_on()

    def _on_vut_command(self, message: steps.BodyCommand) -> None:
        command = _command(message)
        if self._pacing.on_driver(message, command.is_finite, time.monotonic_ns()):
            self._commands[names.VUT_ID] = message.step, command
            self._go_on()

    def _on_heartbeat(self, _beat: steps.Heartbeat) -> None:
        self._pacing.on_heartbeat(time.monotonic_ns())

    def _on_done(self, message: steps.StepDone) -> None:
        self._pacing.on_done(message, time.monotonic_ns())
        self._go_on()

    def _take_session(self, session: SessionPhase) -> None:
        self._pacing.take_session(session, time.monotonic_ns())

    # -- stepping ------------------------------------------------------------------------------

    def _go_on(self) -> None:
        """Step as soon as everything that is waited for is there, in lockstep."""
        if self._pacing.may_step(self._world.step_index):
            self._step()

    def _step(self) -> None:
        world, manager_lost = self._world, self._pacing.manager_lost(time.monotonic_ns())
        drive_vut = self._pacing.session is SessionPhase.RUNNING and not manager_lost
        before_ns = world.now_ns
        self._vut.lead(world, self._commands)
        world.advance(self._commands, drive_vut)
        # Faults of the VUT's driver that began or ended.
        self._publish_faults(world.driver.fault_changes, before_ns)
        world.driver.fault_changes.clear()
        for limit in self._pacing.on_step(world, manager_lost, time.monotonic_ns()):
            self._announce(limit)
        self._vut_states_sent += self._report_vut(running=True)
        self._publish_tick()

    def _report_vut(self, running: bool) -> int:
        """Send what the VUT reports of itself; return the number of states that arrive now."""
        now_ns, armed = self._world.now_ns, self._pacing.session is SessionPhase.ARMED
        changes = self._vut.channel.begin(now_ns, running=running, armed=armed)
        self._publish_faults(changes, now_ns)
        arrived = self._vut.report(self._world)
        for state in arrived:
            self._pub_vut.publish(encode_state(state))
        return len(arrived)

    def _on_pace_timer(self) -> None:
        """Make one step a period in real time, and tell of falling behind."""
        if not self._pacing.running:
            return
        overrun = self._pacing.overrun(self._world.now_ns, time.monotonic_ns())
        if overrun is not None:
            self._announce(overrun)
        self._step()

    def _on_hold_timer(self) -> None:
        """Repeat the present state while holding; watch for the silent while stepping."""
        pacing, step, now_ns = self._pacing, self._world.step_index, time.monotonic_ns()
        pacing.look(now_ns, idle_s())
        if not pacing.running:
            if pacing.may_start(now_ns):
                self._report_vut(running=False)
            self._publish_tick()
            return
        if pacing.is_hold_report_due(step, now_ns):
            self._publish_tick()
        for limit in pacing.drop_the_lost(step, self._world.now_ns, now_ns):
            self._announce(limit)
        if pacing.has_dropped():
            # Those that were dropped send nothing that would make the world go on.
            for _ in range(round(HOLD_PERIOD_S / self._run.step_s)):
                self._go_on()

    # -- sending -------------------------------------------------------------------------------

    def _publish_tick(self) -> None:
        now_ns = self._world.now_ns
        tick = steps.WorldTick(
            stamp_ns=now_ns,
            step=self._world.step_index,
            running=self._pacing.running,
            lockstep=self._pacing.lockstep,
            heartbeat=self._pacing.heartbeat,
            vut_states_sent=self._vut_states_sent,
            objects=tuple(self._world.objects()),
        )
        self._pub_tick.publish(steps.encode_tick(tick))
        # Last: others work on the tick meanwhile.
        self._pub_clock.publish(steps.encode_clock(now_ns))

    def _publish_faults(self, changes: Iterable[FaultChange], now_ns: int) -> None:
        for change in changes:
            self._pub_fault.publish(encode_fault(change.fact(self.get_name(), now_ns)))

    def _announce(self, limit: LimitFact) -> None:
        self._pub_safety.publish(encode_limit(limit))
        name, who = MEANINGS[limit.code].limit_name, limit.object_id
        self.get_logger().error(f"{name}: {who} after {limit.measured:.2f} s")

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
