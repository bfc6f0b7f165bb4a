"""Publishers of the manager: facts of the session, heartbeats, answers to the world."""

from __future__ import annotations

import time
from collections.abc import Iterable
from uuid import uuid4

from rclpy.node import Node
from tf2_msgs.msg import TFMessage

from ssp_core import names, ros
from ssp_core.cdr import steps
from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.transforms import TransformFilter, encode_transforms, of_camera
from ssp_msgs.msg import (
    Heartbeat,
    LinkStatus,
    PhaseEvent,
    SafetyEvent,
    SessionState,
    StepDone,
    TriggerEvent,
)
from ssp_scenario_manager import conversions
from ssp_scenario_manager.core import outbox
from ssp_scenario_manager.core.link_clock import LinkClocks
from ssp_scenario_manager.core.link_report import link_report
from ssp_scenario_manager.core.session import Session
from ssp_scenario_manager.core.tally import Tallies


class Outlet:
    """Owns the publishers and counts the heartbeats.

    Args:
        node: owns the endpoints; its name is the sender's.
    """

    def __init__(self, node: Node) -> None:
        pub = node.create_publisher
        self._name = node.get_name()
        self._log = node.get_logger()
        # Two managers have the same node name; who hears both must be able to tell them apart.
        self._sender = f"{self._name}-{uuid4().hex[:12]}"
        self._state = pub(SessionState, names.SESSION_STATE, ros.LATCHED)
        self._heartbeats = pub(Heartbeat, names.HEARTBEAT, ros.STATE)
        self._trigger = pub(TriggerEvent, names.TRIGGER_EVENT, ros.LATCHED)
        self._phase = pub(PhaseEvent, names.PHASE_EVENT, ros.LATCHED)
        self._safety = pub(SafetyEvent, names.SAFETY_EVENT, ros.LATCHED)
        self._done = pub(StepDone, names.STEP_DONE, ros.STATE)
        self._links = pub(LinkStatus, names.LINK_STATUS, ros.STATE)
        self._tf = pub(TFMessage, names.TF, ros.TF)
        self._tf_static = pub(TFMessage, names.TF_STATIC, ros.TF_STATIC)
        self._poses = TransformFilter()
        self._count = 0

    def state_changed(self, change: outbox.StateChanged, spec: RunSpec | None) -> None:
        """A transition, on its topic and in the log."""
        self._state.publish(conversions.session_state_to_msg(change, spec))
        self._log.info(
            f"{change.previous.name} -> {change.state.name} ({change.event}): {change.reason}"
        )

    def send(
        self,
        fact: outbox.Triggered | outbox.PhaseBegan | outbox.LimitPassed | outbox.Note,
        now_ns: int,
        arrival_ns: int,
    ) -> None:
        """A decision record, a phase, an event, or a word for people.

        Args:
            fact: what the session found.
            now_ns: session time, that at which a trigger's references go out.
            arrival_ns: when the deciding state arrived, on the steady clock.
        """
        if isinstance(fact, outbox.Triggered):
            processing_s = (time.monotonic_ns() - arrival_ns) / NS_PER_S
            self._trigger.publish(conversions.trigger_to_msg(fact, now_ns, processing_s))
        elif isinstance(fact, outbox.PhaseBegan):
            self._phase.publish(conversions.phase_to_msg(fact))
        elif isinstance(fact, outbox.Note):
            self._log.info(fact.text)
        else:
            self._safety.publish(conversions.limit_to_msg(fact, self._name))

    def report_links(
        self, session: Session, links: LinkClocks, tallies: Tallies, now_ns: int
    ) -> None:
        """What is known of the links, for operators and for the record; losses go to the log too.

        Args:
            session: gives the newest states; nothing is published before a run is loaded.
            links: the answers to heartbeats.
            tallies: states counted.
            now_ns: session time.
        """
        lines = link_report(session, links, tallies, now_ns, time.monotonic_ns())
        if lines:
            self._links.publish(conversions.link_status_to_msg(lines, now_ns))
        for line in tallies.news():
            self._log.warning(line)

    def loaded(self, spec: RunSpec) -> None:
        """A run's camera to tf2; poses begin anew, since another run may have another clock."""
        self._poses = TransformFilter()
        if spec.camera is not None:
            self._tf_static.publish(encode_transforms(of_camera(spec.camera)))

    def poses(self, states: Iterable[ObjectState]) -> None:
        """Everybody's base_link to tf2, in one message, at the stamps of the states."""
        if news := self._poses.news(states):
            self._tf.publish(encode_transforms(news))

    def heartbeat(
        self, session: SessionPhase, sent: dict[str, int], now_ns: int
    ) -> tuple[int, int]:
        """A sign of life with what an object must have heard by now: references sent, by id.

        Returns:
            Its sequence number and when it was sent, ns on the system clock.
        """
        self._count += 1
        sent_ns = time.time_ns()
        beat = steps.Heartbeat(now_ns, self._sender, self._count, sent_ns, session, sent)
        self._heartbeats.publish(steps.encode_heartbeat(beat))
        return self._count, sent_ns

    def step_done(self, step: int, session: SessionPhase) -> None:
        """Tells the world that this step was judged, and which heartbeat belongs to it."""
        done = steps.StepDone(names.SCENARIO_MANAGER, step, self._count, session)
        self._done.publish(steps.encode_done(done))
