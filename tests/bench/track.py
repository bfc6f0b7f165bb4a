"""The surroundings of the node under test in ``dispatch``: VUT, object targets, world, recorder.

One node plays them all at 100 Hz, with messages as bytes, so that little of what is measured is its
own. Twenty targets send their states as one message, as the product's do.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import rclpy
from rclpy.executors import Executor
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cdr.references import Acknowledgement, decode_reference, encode_ack
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.cdr.steps import WorldTick, encode_tick
from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.ros.conversions import rules_to_msg
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import (
    FollowPath,
    Motion,
    ParticipantSpec,
    TimeToArrival,
    TriggerSpec,
)
from ssp_core.run_file.values import Start
from ssp_core.safety.object_rules import rules_of
from ssp_core.vocabulary import ControlState, Role, SessionPhase
from ssp_msgs import msg
from ssp_msgs.srv import LoadScenario, ObjectCommand, SessionCommand
from ssp_scenario_manager.compile.compiler import Request, compile_task

TARGETS = 20
PERIOD_S = 0.01
PERIOD_NS = seconds_to_ns(PERIOD_S)
VUT_MPS = 10.0
TRIGGERS = 200
TRIGGER_SPACING_S = 0.05
FIRST_TRIGGER_S = 0.5
# From when a trigger watches the VUT to its firing: ten watch at any time.
WATCHED_S = 0.5
READY_TIMEOUT_S = 30.0


def crossing(k: int) -> list[tuple[float, float]]:
    """Path of target k: across the road, far from the VUT's."""
    return [(300.0 + 3.0 * k, -2.55), (300.0 + 3.0 * k, 13.0)]


def make_run() -> RunSpec:
    """The VUT drives at constant speed towards an anchor; every 0.05 s another trigger fires.

    Each falls due half a period after a state, so that the state that decides is never in doubt.
    """
    task = compile_task(Request(event="vru_crossing", target="sumo", site="boulevard")).task
    spec = task.run.model_copy(
        update={"run_id": "bench", "mode": "realtime", "step_s": PERIOD_S, "camera": None}
    )
    anchor_x_m = 390.0
    until_anchor_s = (anchor_x_m - spec.vut.start.x_m - spec.vut.size.front_m) / VUT_MPS
    targets = []
    for k in range(TARGETS):
        x, y = crossing(k)[0]
        start = Start(x_m=x, y_m=y, yaw_rad=1.5708)
        targets.append(ParticipantSpec(id=f"ot{k + 1}", object_class="pedestrian", start=start))
    triggers = []
    for k in range(TRIGGERS):
        due_s = FIRST_TRIGGER_S + TRIGGER_SPACING_S * k
        motion = Motion(path=crossing(k % TARGETS), cruise_mps=1.5)
        triggers.append(
            TriggerSpec(
                id=f"t{k + 1}",
                condition=TimeToArrival(
                    type="time_to_arrival",
                    anchor=(anchor_x_m, spec.vut.start.y_m),
                    below_s=until_anchor_s - due_s + 0.5 * PERIOD_S,
                ),
                not_before_s=max(0.0, due_s - WATCHED_S),
                object_id=f"ot{k % TARGETS + 1}",
                manoeuvre=FollowPath(kind="follow_path", motion=motion),
            )
        )
    return spec.model_copy(
        update={
            "targets": targets,
            "triggers": triggers,
            "traffic": [],
            # A busy machine shall show in the figures, and not end the session.
            "limits": Limits(
                speed_mps=16.0,
                acceleration_mps2=5.0,
                state_age_s=5.0,
                heartbeat_s=5.0,
                ack_s=5.0,
                link_delay_s=5.0,
                clock_offset_s=1.0,
            ),
        }
    )


@dataclass
class Heard:
    """The states that came back while the VUT drove.

    Args:
        latencies_ms: from each state that decided to its reference.
        records: decision records, one per trigger.
        sent: states of all objects since the run was loaded.
        received: those that the manager counts.
        lost: those that it reports as lost.
    """

    latencies_ms: list[float] = field(default_factory=list)
    records: int = 0
    sent: int = 0
    received: int = 0
    lost: int = 0


class Track(Node):
    """Everything around the node under test.

    Args:
        spec: the run.
        context: of this process.
    """

    def __init__(self, spec: RunSpec, context: rclpy.Context) -> None:
        super().__init__("bench_track", namespace=names.NAMESPACE, context=context)
        self.spec = spec
        self.heard = Heard()
        self.session = SessionPhase.UNKNOWN
        self.armed = False
        self.over = False
        self.reports = 0
        self._sent_at: dict[int, int] = {}
        self._step = 0
        self._sequence = 0
        self._ids = [target.id for target in spec.targets]
        pub, sub = self.create_publisher, self.create_subscription
        self._vut = pub(msg.ObjectState, names.state_topic(names.VUT_ID), ros.STATE)
        self._states = pub(msg.ObjectStates, names.OBJECT_STATES, ros.STATE)
        self._tick = pub(msg.WorldTick, names.WORLD_TICK, ros.STATE)
        self._recorder = pub(msg.RecorderStatus, names.RECORDER_STATUS, ros.STATE)
        self._replies = pub(msg.HeartbeatReply, names.HEARTBEAT_REPLY, ros.STATE)
        self._acks, self._rules = {}, {}
        for name in self._ids:
            self._rules[name] = pub(msg.ObjectRules, names.rules_topic(name), ros.LATCHED)
            self._rules[name].publish(rules_to_msg(rules_of(spec, name), name, self.get_name()))
            self._acks[name] = pub(msg.ReferenceAck, names.ack_topic(name), ros.COMMAND)
            topic = names.reference_topic(name)
            sub(msg.Reference, topic, self._on_reference, ros.COMMAND, raw=True)
            self.create_service(ObjectCommand, names.command_service(name), self._on_object_command)
        sub(msg.SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        sub(msg.Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.STATE)
        sub(msg.TriggerEvent, names.TRIGGER_EVENT, self._on_trigger, ros.LATCHED)
        sub(msg.LinkStatus, names.LINK_STATUS, self._on_links, ros.STATE)
        self.commands = {
            name: self.create_client(SessionCommand, name) for name in ("connect", "arm", "start")
        }
        self.load = self.create_client(LoadScenario, names.LOAD_SCENARIO)

    # -- what arrives --------------------------------------------------------------------------

    def _on_session(self, message: msg.SessionState) -> None:
        self.session = SessionPhase(message.state)
        if self.session is SessionPhase.ABORTING and not self.over:
            raise RuntimeError(f"the session aborts: {message.reason}")

    def _on_object_command(
        self, request: ObjectCommand.Request, response: ObjectCommand.Response
    ) -> ObjectCommand.Response:
        self.armed = request.command == ObjectCommand.Request.COMMAND_ARM
        response.accepted = True
        return response

    def _on_heartbeat(self, message: msg.Heartbeat) -> None:
        now = ros.stamp_from_ns(time.time_ns())
        reply = msg.HeartbeatReply(
            participant=names.OBJECT_TARGET,
            object_ids=self._ids,
            sequence=message.sequence,
            heartbeat_sent=message.sent,
            heartbeat_received=now,
        )
        reply.header.stamp = now
        self._replies.publish(reply)

    def _on_reference(self, data: bytes) -> None:
        received = time.perf_counter_ns()
        dispatched_ns = peek_stamp_ns(data)
        sent = self._sent_at.get(dispatched_ns)
        if sent is not None:
            self.heard.latencies_ms.append((received - sent) * 1e-6)
        reference = decode_reference(data)
        ack = Acknowledgement(dispatched_ns, reference.reference_id, reference.object_id, True)
        self._acks[reference.object_id].publish(encode_ack(ack))

    def _on_trigger(self, message: msg.TriggerEvent) -> None:
        self.heard.records += 1

    def _on_links(self, message: msg.LinkStatus) -> None:
        self.heard.received = sum(map(int, message.states_received))
        self.heard.lost = sum(map(int, message.states_lost))
        self.reports += 1

    # -- what is sent --------------------------------------------------------------------------

    def _state(self, participant: ParticipantSpec, role: Role) -> ObjectState:
        control = ControlState.ARMED if self.armed else ControlState.DISARMED
        if self.session is SessionPhase.RUNNING:
            control = ControlState.RUNNING
        return ObjectState(
            object_id=participant.id,
            object_class=participant.cls,
            role=role,
            stamp_ns=self._step * PERIOD_NS,
            x_m=participant.start.x_m,
            y_m=participant.start.y_m,
            yaw_rad=participant.start.yaw_rad,
            speed_mps=0.0,
            acceleration_mps2=0.0,
            yaw_rate_radps=0.0,
            size=participant.size,
            sequence=self._sequence,
            control_state=control,
        )

    def publish_all(self, running: bool) -> None:
        """One period of everybody's states, the VUT's last."""
        self._step += running
        self._sequence += 1
        now_ns = self._step * PERIOD_NS
        tick = WorldTick(now_ns, self._step, running, False, 0, 0)
        states = tuple(
            sorted((self._state(t, Role.OT) for t in self.spec.targets), key=lambda s: s.object_id)
        )
        vut = self._state(self.spec.vut, Role.VUT)
        if running:
            x_m = vut.x_m + VUT_MPS * PERIOD_S * self._step
            vut = replace(vut, x_m=x_m, speed_mps=VUT_MPS)
        array = encode_states(StateArray(now_ns, names.OBJECT_TARGET, states))
        data = encode_state(vut)
        self._tick.publish(encode_tick(tick))
        self._states.publish(array)
        self._sent_at[now_ns] = time.perf_counter_ns()
        self._vut.publish(data)
        self.heard.sent += 1 + len(states)
        if self._sequence % 50 == 0:
            self._recorder.publish(msg.RecorderStatus(ready=True))


def wait_for(track: Track, executor: Executor, condition: Callable[[], bool], what: str) -> None:
    """Keeps the track's states going until something holds.

    Raises:
        RuntimeError: it doesn't in time.
    """
    deadline = time.monotonic() + READY_TIMEOUT_S
    while not condition():
        track.publish_all(running=False)
        until = time.monotonic() + PERIOD_S
        while time.monotonic() < until:
            executor.spin_once(timeout_sec=PERIOD_S / 2)
        if time.monotonic() > deadline:
            raise RuntimeError(f"timed out waiting until {what}")


def start_session(track: Track, executor: Executor, run_file: str) -> None:
    """Loads the run and takes the session to RUNNING."""
    wait_for(track, executor, track.load.service_is_ready, "the manager is there")
    future = track.load.call_async(LoadScenario.Request(run_file=run_file))
    wait_for(track, executor, future.done, "the run is loaded")
    if not future.result().accepted:
        raise RuntimeError(f"load_scenario: {future.result().error_msg}")
    # The manager counts from here on; it has counted what came between its answer and now.
    track.heard.sent = 0
    for name, client in track.commands.items():
        accepted = False
        deadline = time.monotonic() + READY_TIMEOUT_S
        while not accepted:
            future = client.call_async(SessionCommand.Request(requested_by="bench"))
            wait_for(track, executor, future.done, f"{name} is answered")
            accepted = future.result().accepted
            if not accepted and time.monotonic() > deadline:
                raise RuntimeError(f"{name}: {future.result().error_msg}")


def play(track: Track, executor: Executor, seconds: float) -> None:
    """Publishes at the period, and takes in what comes back between."""
    started = time.perf_counter()
    for k in range(round(seconds / PERIOD_S)):
        track.publish_all(running=True)
        due = started + (k + 1) * PERIOD_S
        executor.spin_once(timeout_sec=0.0)
        while (left := due - time.perf_counter()) > 0:
            executor.spin_once(timeout_sec=left)


def take_last_counts(track: Track, executor: Executor) -> None:
    """Falls silent, and waits for the manager's report of what it had received by then."""
    track.over = True
    before, deadline = track.reports, time.monotonic() + READY_TIMEOUT_S
    while track.reports < before + 2:
        executor.spin_once(timeout_sec=0.1)
        if time.monotonic() > deadline:
            raise RuntimeError("timed out waiting for the manager's counts")
