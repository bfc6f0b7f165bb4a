"""Trigger to dispatch under load, beside a bare rclpy node that answers on the same topics.

This process plays the VUT, twenty object targets, the world and the recorder at 100 Hz. The
scenario_manager runs in a process of its own; afterwards the bare node takes its place and hears
the same messages. What is measured is the time from publishing the state that decides to receiving
the reference that it causes.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import rclpy
import rclpy.experimental
from measure import percentile, report
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ssp_core import names, ros
from ssp_core.conversions import reference_to_msg, state_to_msg
from ssp_core.domains import free_domain
from ssp_core.files import write_text
from ssp_core.geometry import Polyline
from ssp_core.processes import ProcessGroup, session_environment
from ssp_core.profile import drive_along
from ssp_core.reference import Reference
from ssp_core.run_spec import (
    FollowPath,
    Limits,
    Motion,
    ParticipantSpec,
    RunSpec,
    Start,
    TimeToArrival,
    TriggerSpec,
)
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, Role, SessionPhase
from ssp_msgs.msg import ObjectState as ObjectStateMsg
from ssp_msgs.msg import RecorderStatus, ReferenceAck, SessionState, WorldTick
from ssp_msgs.msg import Reference as ReferenceMsg
from ssp_msgs.srv import LoadScenario, ObjectCommand, SessionCommand
from ssp_scenario_manager.resolve import resolve_run
from ssp_scenario_manager.runner.session import PROFILE
from ssp_scenario_manager.scenario import load_scenario, load_site

TARGETS = 20
PERIOD_S = 0.01
VUT_MPS = 10.0
ROUNDS = 3
READY_TIMEOUT_S = 30.0


def crossing(k: int) -> list[tuple[float, float]]:
    """Path of target k: across the road, far from the VUT's."""
    return [(300.0 + 2.0 * k, -2.55), (300.0 + 2.0 * k, 13.0)]


def make_run() -> RunSpec:
    """The VUT drives at constant speed towards an anchor; every 0.1 s another trigger fires."""
    scenario, version = load_scenario("vru_crossing")
    site, site_version = load_site("boulevard")
    spec = resolve_run(
        scenario, version, site, site_version, run_id="bench", seed=1, mode="realtime"
    )
    targets, triggers = [], []
    for k in range(TARGETS):
        path = crossing(k)
        x, y = path[0]
        targets.append(
            ParticipantSpec(
                id=f"ot{k + 1}",
                object_class="pedestrian",
                start=Start(x_m=x, y_m=y, yaw_rad=1.5708),
            )
        )
        triggers.append(
            TriggerSpec(
                id=f"t{k + 1}",
                condition=TimeToArrival(
                    type="time_to_arrival", anchor=(250.0, 0.0), below_s=22.0 - 0.1 * k
                ),
                not_before_s=0.3,
                object_id=f"ot{k + 1}",
                manoeuvre=FollowPath(kind="follow_path", motion=Motion(path=path, cruise_mps=1.5)),
            )
        )
    return spec.model_copy(
        update={
            "targets": targets,
            "triggers": triggers,
            "camera": None,
            "traffic": [],
            "limits": Limits(speed_mps=16.0, acceleration_mps2=5.0, state_age_s=2.0),
        }
    )


class Track(Node):
    """Everything around the node under test."""

    def __init__(self, spec: RunSpec, context: rclpy.Context) -> None:
        super().__init__("bench_track", namespace=names.NAMESPACE, context=context)
        self.spec = spec
        self.sent_at: dict[int, float] = {}
        self.latencies_ms: list[float] = []
        self.session = SessionPhase.UNKNOWN
        self.armed = False
        self._step = 0
        pub, sub = self.create_publisher, self.create_subscription
        self.pub_vut = pub(ObjectStateMsg, names.state_topic("vut"), ros.STATE)
        self.pub_tick = pub(WorldTick, names.WORLD_TICK, ros.STATE)
        self.pub_recorder = pub(RecorderStatus, names.RECORDER_STATUS, ros.STATE)
        self.pub_states = {}
        self.pub_acks = {}
        for target in spec.targets:
            self.pub_states[target.id] = pub(
                ObjectStateMsg, names.state_topic(target.id), ros.STATE
            )
            self.pub_acks[target.id] = pub(ReferenceAck, names.ack_topic(target.id), ros.COMMAND)
            sub(ReferenceMsg, names.reference_topic(target.id), self.on_reference, ros.COMMAND)
            self.create_service(
                ObjectCommand, names.command_service(target.id), self.on_object_command
            )
        sub(SessionState, names.SESSION_STATE, self.on_session, ros.LATCHED)
        self.commands = {
            name: self.create_client(SessionCommand, name) for name in ("connect", "arm", "start")
        }
        self.load = self.create_client(LoadScenario, names.LOAD_SCENARIO)

    def on_session(self, message: SessionState) -> None:
        self.session = SessionPhase(message.state)

    def on_object_command(
        self, request: ObjectCommand.Request, response: ObjectCommand.Response
    ) -> ObjectCommand.Response:
        self.armed = request.command == ObjectCommand.Request.COMMAND_ARM
        response.accepted = True
        return response

    def on_reference(self, message: ReferenceMsg) -> None:
        received = time.perf_counter()
        sent = self.sent_at.get(ros.ns_from_stamp(message.header.stamp))
        if sent is not None:
            self.latencies_ms.append((received - sent) * 1e3)
        ack = ReferenceAck(
            reference_id=message.reference_id, object_id=message.object_id, accepted=True
        )
        ack.header.stamp = message.header.stamp
        self.pub_acks[message.object_id].publish(ack)

    def _state(self, participant: ParticipantSpec, role: Role, x_m: float) -> ObjectState:
        control = ControlState.ARMED if self.armed else ControlState.DISARMED
        if self.session is SessionPhase.RUNNING:
            control = ControlState.RUNNING
        return ObjectState(
            object_id=participant.id,
            object_class=participant.cls,
            role=role,
            stamp_ns=self._step * round(PERIOD_S * 1e9),
            x_m=x_m,
            y_m=participant.start.y_m,
            yaw_rad=participant.start.yaw_rad,
            speed_mps=0.0,
            acceleration_mps2=0.0,
            yaw_rate_radps=0.0,
            size=participant.size,
            sequence=self._step + 1,
            control_state=control,
        )

    def publish_all(self, running: bool) -> None:
        """One period of everybody's states."""
        if running:
            self._step += 1
        stamp = ros.stamp_from_ns(self._step * round(PERIOD_S * 1e9))
        tick = WorldTick(step=self._step, running=running, lockstep=False)
        tick.header.stamp = stamp
        self.pub_tick.publish(tick)
        for target in self.spec.targets:
            state = self._state(target, Role.OT, target.start.x_m)
            self.pub_states[target.id].publish(state_to_msg(state))
        start = self.spec.vut.start.x_m
        vut = self._state(self.spec.vut, Role.VUT, start + VUT_MPS * PERIOD_S * self._step)
        if running:
            vut = replace(vut, speed_mps=VUT_MPS)
        message = state_to_msg(vut)
        self.sent_at[vut.stamp_ns] = time.perf_counter()
        self.pub_vut.publish(message)
        if self._step % 50 == 0:
            self.pub_recorder.publish(RecorderStatus(ready=True))


class Echo(Node):
    """The bare node: hears the same topics and answers every tenth VUT state with a reference."""

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__("bench_echo", namespace=names.NAMESPACE)
        ids = [f"ot{k + 1}" for k in range(TARGETS)]
        self._publishers = [
            self.create_publisher(ReferenceMsg, names.reference_topic(i), ros.COMMAND) for i in ids
        ]
        motion = Motion(path=crossing(0), cruise_mps=1.5)
        points = drive_along(Polyline(motion.path), 0.0, 0.0, 1.5, 2.0, 2.0)
        self._answers = [
            reference_to_msg(Reference("r", i, "v", "manoeuvre", 0, 0, 0, tuple(points)))
            for i in ids
        ]
        self._count = 0
        for i in ids:
            self.create_subscription(
                ObjectStateMsg, names.state_topic(i), lambda message: None, ros.STATE
            )
            self.create_subscription(
                ReferenceAck, names.ack_topic(i), lambda message: None, ros.COMMAND
            )
        self.create_subscription(WorldTick, names.WORLD_TICK, lambda message: None, ros.STATE)
        self.create_subscription(ObjectStateMsg, names.state_topic("vut"), self._on_vut, ros.STATE)

    def _on_vut(self, message: ObjectStateMsg) -> None:
        if message.speed == 0.0:
            return
        self._count += 1
        if self._count % 10:
            return
        k = self._count // 10 % TARGETS
        answer = self._answers[k]
        answer.header.stamp = message.header.stamp
        self._publishers[k].publish(answer)


def wait_for(track: Track, executor: object, condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + READY_TIMEOUT_S
    while not condition():
        track.publish_all(running=False)
        until = time.monotonic() + PERIOD_S
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=PERIOD_S / 2)
        if time.monotonic() > deadline:
            raise RuntimeError(f"timed out waiting until {what}")


def start_session(track: Track, executor: object, run_file: Path) -> None:
    wait_for(track, executor, track.load.service_is_ready, "the manager is there")
    future = track.load.call_async(LoadScenario.Request(run_file=str(run_file)))
    wait_for(track, executor, future.done, "the run is loaded")
    for name, client in track.commands.items():
        accepted = False
        deadline = time.monotonic() + READY_TIMEOUT_S
        while not accepted:
            future = client.call_async(SessionCommand.Request(requested_by="bench"))
            wait_for(track, executor, future.done, f"{name} is answered")
            accepted = future.result().accepted
            if not accepted and time.monotonic() > deadline:
                raise RuntimeError(f"{name}: {future.result().error_msg}")


def play(track: Track, executor: object, seconds: float) -> None:
    """Publishes at the period, and takes in what comes back between."""
    started = time.perf_counter()
    for k in range(round(seconds / PERIOD_S)):
        track.publish_all(running=True)
        due = started + (k + 1) * PERIOD_S
        while (left := due - time.perf_counter()) > 0:
            executor.spin_once(timeout_sec=left)


def measure(spec: RunSpec, run_file: Path, manager: bool) -> list[float]:
    with free_domain() as domain_id, tempfile.TemporaryDirectory() as folder:
        context = rclpy.Context()
        rclpy.init(
            context=context, domain_id=domain_id, signal_handler_options=SignalHandlerOptions.NO
        )
        env = session_environment(domain_id, PROFILE)
        try:
            with ProcessGroup(env, Path(folder)) as group:
                track = Track(spec, context)
                executor = rclpy.experimental.EventsExecutor(context=context)
                executor.add_node(track)
                if manager:
                    group.start_node(names.SCENARIO_MANAGER, "ssp_scenario_manager.node", {})
                    start_session(track, executor, run_file)
                else:
                    group.start_node("bench_echo", "dispatch", {})
                    wait_for(
                        track,
                        executor,
                        lambda: track.count_subscribers(names.state_topic("vut")) > 0,
                        "the echo is there",
                    )
                play(track, executor, 3.6)
                executor.shutdown()
                track.destroy_node()
                return track.latencies_ms
        finally:
            rclpy.shutdown(context=context)


def main() -> None:
    spec = make_run()
    ours: list[float] = []
    bound: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        run_file = Path(folder) / "run.yaml"
        write_text(run_file, spec.model_dump_json(by_alias=True))
        for _ in range(ROUNDS):
            ours += measure(spec, run_file, manager=True)
            bound += measure(spec, run_file, manager=False)
    if len(ours) < ROUNDS * TARGETS:
        raise RuntimeError(f"only {len(ours)} of {ROUNDS * TARGETS} triggers were dispatched")
    for share in (0.5, 0.99):
        report(
            f"dispatch: p{share * 100:.0f}",
            percentile(ours, share),
            percentile(bound, share),
            "ms",
            f"{TARGETS + 1} objects at {1 / PERIOD_S:.0f} Hz, {len(ours)} triggers",
            lower=True,
        )


if __name__ == "__main__":
    if "--ros-args" in sys.argv:
        sys.exit(ros.run_node(Echo, lambda node: None))
    main()
