"""Listens to whatever is connected to a session, for ``ssp doctor --session``; sends nothing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, CompressedImage, NavSatFix

from ssp_core import names, ros
from ssp_core.cdr.iso_frames import FrameBatch, decode_frames
from ssp_core.cdr.messages import object_state
from ssp_core.motion.state import ObjectState as State
from ssp_core.ros.conversions import body_status_of, rules_from_msg
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import recorder_lacks
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.object_rules import ReceivedRules
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.msg import BodyStatus as BodyStatusMsg
from ssp_msgs.msg import (
    Heartbeat,
    IsoFrames,
    LinkStatus,
    LocalisationStatus,
    ObjectRules,
    ObjectState,
    ObjectStates,
    RecorderStatus,
)
from ssp_scenario_manager.doctor.session import SessionObservation, Stream
from ssp_scenario_manager.ros.endpoints import DeclarationWatch, PublisherWatch
from ssp_scenario_manager.session.supervision import LivenessMonitor

# Endpoints find each other within this time; what is heard before doesn't count for rates.
DISCOVERY_S = 3.0
# Between two looks at who publishes what.
LOOK_S = 0.5


class SessionCounts:
    """Counts of a session from an instant on.

    Attributes:
        streams: by topic, or by object.
        lost: states that were sent and didn't come, by object.
        frames: of ISO 22133, by object.
        motion: what each object states, held against its places.
    """

    def __init__(self, spec: RunSpec, odometry: str | None, navsat: str | None) -> None:
        self.streams = {object_id: Stream(names.MAP_FRAME) for object_id in spec.object_ids}
        self.streams |= {names.CAMERA_IMAGE: Stream(), names.CAMERA_INFO: Stream()}
        if odometry is not None:
            self.streams[odometry] = Stream(names.MAP_FRAME)
        if navsat is not None:
            self.streams[navsat] = Stream()
        self.lost: dict[str, int] = {}
        self.frames: dict[str, Stream] = {}
        self.motion = {
            one.id: ConsistencyWatch(Bounds.of(one.id, one.cls, spec.limits))
            for one in (spec.vut, *spec.targets)
        }

    def see(self, state: State, before: State | None) -> None:
        """Take a state, before its message is counted.

        Args:
            state: of an object.
            before: the last one that was heard of it, counted or not.
        """
        if before is not None and self.streams[state.object_id].arrivals_ns:
            gap = state.sequence - before.sequence - 1
            self.lost[state.object_id] = self.lost.get(state.object_id, 0) + max(gap, 0)
        if state.is_finite:
            self.motion[state.object_id].see(state)


class SessionListener(Node):
    """Subscribes to all that a session is made of, and remembers what came."""

    def __init__(
        self, spec: RunSpec, context: rclpy.Context, odometry: str | None, navsat: str | None
    ) -> None:
        super().__init__("doctor_session", namespace=names.NAMESPACE, context=context)
        self._vut_refused = ""
        self._bodies: dict[str, BodyStatus] = {}
        self._spec = spec
        self._begin_counting = partial(SessionCounts, spec, odometry, navsat)
        self._counts = self._begin_counting()
        self._states: dict[str, State] = {}
        self._links: dict[str, LinkEstimate] = {}
        self._managers: set[str] = set()
        self._session = SessionPhase.UNKNOWN
        self._recorder: RecorderStatus | None = None
        self._rules = ReceivedRules()
        self._liveness = LivenessMonitor()
        receiver = [topic for topic in (odometry, navsat) if topic is not None]
        self._others = PublisherWatch(self, self._liveness, receiver)
        self._others.follow(spec, time.monotonic_ns())
        self._declarations = DeclarationWatch(self, self._liveness)
        self._declarations.follow(spec)
        self.create_timer(LOOK_S, self._look)
        sub = self.create_subscription
        for object_id in spec.object_ids:
            sub(ObjectState, names.state_topic(object_id), self._on_state, ros.DRIVER)
            topic = names.iso_frames_topic(object_id)
            ros.subscribe_raw(self, IsoFrames, topic, decode_frames, self._on_frames, ros.DRIVER)
        for target in spec.targets:
            topic, hear = names.rules_topic(target.id), self._rules.hear
            kind, qos = ObjectRules, ros.LATCHED
            ros.subscribe_raw(self, kind, topic, rules_from_msg, hear, qos, raw=False)
        sub(ObjectStates, names.OBJECT_STATES, self._on_states, ros.DRIVER)
        if odometry is not None:
            sub(Odometry, odometry, partial(self._hear, odometry), ros.DRIVER)
        if navsat is not None:
            sub(NavSatFix, navsat, partial(self._hear, navsat), ros.DRIVER)
        if spec.camera is not None:
            hear_image = partial(self._hear, names.CAMERA_IMAGE)
            hear_info = partial(self._hear, names.CAMERA_INFO)
            sub(CompressedImage, names.CAMERA_IMAGE, hear_image, ros.DRIVER)
            sub(CameraInfo, names.CAMERA_INFO, hear_info, ros.DRIVER)
        sub(Heartbeat, names.HEARTBEAT, self._on_heartbeat, ros.DRIVER)
        sub(LinkStatus, names.LINK_STATUS, self._on_links, ros.DRIVER)
        sub(RecorderStatus, names.RECORDER_STATUS, self._on_recorder, ros.DRIVER)
        status = names.LOCALISATION_STATUS
        sub(LocalisationStatus, status, self._on_localisation, ros.DRIVER)
        sub(BodyStatusMsg, names.BODY_STATUS, self._on_body, ros.STATE)

    def forget(self) -> None:
        """Start counting anew."""
        self._counts = self._begin_counting()

    def _look(self) -> None:
        self._others.look(time.monotonic_ns())

    def observation(self) -> SessionObservation:
        """Return all that was heard until now."""
        self._look()
        recorder, counted = self._recorder, self._counts
        return SessionObservation(
            streams=counted.streams,
            states=self._states,
            lost=counted.lost,
            links=self._links,
            vut_refused=self._vut_refused,
            bodies=dict(self._bodies),
            managers=frozenset(self._managers),
            recorder_ready=None if recorder is None else bool(recorder.ready),
            recorder_missing=()
            if recorder is None
            else recorder_lacks(recorder.missing_topics, recorder.failure, recorder.warnings),
            recorder_lost=0 if recorder is None else int(recorder.lost),
            now_ns=time.time_ns(),
            session=self._session,
            frames=counted.frames,
            motion=counted.motion,
            rules=self._rules.checks(self._spec),
            strangers=dict(self._liveness.foreign),
        )

    def _hear(self, topic: str, message: Any) -> None:
        stamp_ns = ros.ns_from_stamp(message.header.stamp)
        self._counts.streams[topic].hear(time.time_ns(), stamp_ns, message.header.frame_id)

    def _on_state(self, message: ObjectState) -> None:
        if message.object_id not in self._spec.object_ids:
            return
        try:
            state = object_state(message)
        except ValueError as error:
            self.get_logger().error(f"state of {message.object_id}: {error}")
            return
        self._counts.see(state, self._states.get(state.object_id))
        self._states[state.object_id] = state
        self._hear(state.object_id, message)

    def _on_states(self, message: ObjectStates) -> None:
        for state in message.states:
            self._on_state(state)

    def _on_frames(self, batch: FrameBatch) -> None:
        if batch.object_id not in self._spec.object_ids:
            return
        stream = self._counts.frames.setdefault(batch.object_id, Stream())
        for frame in batch.frames:
            if not frame.sent:
                stream.hear(frame.stamp_ns, frame.stamp_ns, "")

    def _on_heartbeat(self, message: Heartbeat) -> None:
        self._managers.add(message.sender)
        if message.session_state in tuple(SessionPhase):
            self._session = SessionPhase(message.session_state)

    def _on_links(self, message: LinkStatus) -> None:
        rows = zip(message.object_ids, message.clock_offset, message.delay, strict=True)
        self._links = {object_id: LinkEstimate(offset, delay) for object_id, offset, delay in rows}

    def _on_localisation(self, message: LocalisationStatus) -> None:
        self._vut_refused = message.reason

    def _on_body(self, message: BodyStatusMsg) -> None:
        status = body_status_of(message)
        self._bodies[status.object_id] = status

    def _on_recorder(self, message: RecorderStatus) -> None:
        self._recorder = message
        self._liveness.hear_strangers(message.strangers)


def listen(
    spec: RunSpec,
    seconds: float,
    progress: Callable[[float], None],
    odometry: str | None = None,
    remappings: Sequence[str] = (),
    navsat: str | None = None,
) -> SessionObservation:
    """Listen in the ROS domain of the environment.

    Args:
        spec: the run; says who should be there.
        seconds: how long, after the time that discovery takes.
        progress: called with the share of the time that has passed.
        odometry: topic of the VUT's GNSS/INS, to be listened to as well.
        remappings: ``from:=to``, as the session's nodes have them.
        navsat: topic of its places, likewise.
    """
    rules = ["--ros-args", *(word for rule in remappings for word in ("-r", rule))]
    context = rclpy.Context()
    ros.init(rules if remappings else None, context)
    try:
        node = SessionListener(spec, context, odometry, navsat)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        started = time.monotonic()
        total_s = DISCOVERY_S + seconds
        counting = False
        while (passed_s := time.monotonic() - started) < total_s:
            if passed_s > DISCOVERY_S and not counting:
                counting = True
                node.forget()
            executor.spin_once(timeout_sec=0.1)
            progress(passed_s / total_s)
        observations = node.observation()
        executor.shutdown()
        node.destroy_node()
        return observations
    finally:
        rclpy.shutdown(context=context)
