"""The events of a session, as lines for people, and what is known of it by them."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.clock import ns_to_seconds
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, Phase, SessionPhase
from ssp_msgs.msg import (
    FaultEvent,
    ObjectState,
    ObjectStates,
    PhaseEvent,
    SafetyEvent,
    SessionState,
    TriggerEvent,
)
from ssp_scenario_manager.session.state_machine import STANDSTILL_GIVEN_UP

RunListener = Callable[[str], None]
_SAY_AGAIN_S = 5.0  # what a step waits for, this long after the last line
# The name for people of a session whose objects were asked to arm, until all report that they are.
ARMING = "ARMING"


class ArmedObjects:
    """The objects of a run that report that they are armed, watched while a caller wants to know.

    Args:
        run: its objects are listened to.
    """

    def __init__(self, node: Node, run: RunSpec) -> None:
        self._node = node
        self._armed = dict.fromkeys((t.id for t in run.targets), False)
        sub = node.create_subscription
        if run.states_in_one:
            self._subscriptions = [
                sub(ObjectStates, names.OBJECT_STATES, self._on_states, ros.STATE)
            ]
        else:
            self._subscriptions = [
                sub(ObjectState, names.state_topic(target.id), self._on_state, ros.STATE)
                for target in run.targets
            ]

    @property
    def all(self) -> bool:
        return all(self._armed.values())

    def close(self) -> None:
        for subscription in self._subscriptions:
            self._node.destroy_subscription(subscription)

    def _on_state(self, message: ObjectState) -> None:
        if message.object_id in self._armed:
            self._armed[message.object_id] = message.control_state == ControlState.ARMED

    def _on_states(self, message: ObjectStates) -> None:
        for state in message.states:
            self._on_state(state)


class RunTimes:
    """The time that a run takes, on the session's clock and on the wall.

    Attributes:
        zero_ns: stamp of its start; None before. The clock of a live session counts from 1970, that
            of a simulated one from 0.
        session_s: since its start.
        wall_s: likewise.
    """

    def __init__(self) -> None:
        self.zero_ns: int | None = None
        self.session_s = self.wall_s = 0.0
        self._running_since: float | None = None

    def start(self, stamp: Any, sent_at: float) -> None:
        """Take the start by its own stamp, and when that was sent, on the steady clock."""
        self.zero_ns = ros.ns_from_stamp(stamp)
        since = self._running_since
        self._running_since = sent_at if since is None else min(since, sent_at)

    def go_on(self, session_s: float, is_over: bool) -> None:
        """Take the time that the manager states while the run goes on."""
        if is_over:
            return
        self.session_s = session_s
        if session_s > 0.0:
            now = time.monotonic()
            self._running_since = now if self._running_since is None else self._running_since
            self.wall_s = now - self._running_since

    def end(self, stamp: Any, sent_at: float) -> None:
        """Take the end as ``start``: what ``go_on`` takes comes before or after it, or never."""
        if self.zero_ns is not None and self._running_since is not None:
            self.session_s = self.since_start_s(stamp)
            self.wall_s = sent_at - self._running_since

    def since_start_s(self, stamp: Any) -> float:
        return ns_to_seconds(ros.ns_from_stamp(stamp) - (self.zero_ns or 0))


def sent_at(info: Any) -> float:
    """Return when a message was sent, on this host's steady clock, by rclpy's MessageInfo.

    Its reader may have stood still since, in a terminal or for a debugger. Sender and reader are of
    one host.
    """
    late_ns = time.time_ns() - info["source_timestamp"]
    return time.monotonic() - max(0.0, ns_to_seconds(late_ns))


class SessionEvents:
    """The events of a session, said as they come.

    Args:
        node: listens.
        run: whose objects are listened to while they arm.
        say: takes a line.
        hear: called for each state of the session.

    Attributes:
        is_led_by_us: by a goal of this process, whose feedback has the states earlier.
        state: of the session; None before the first.
        was_armed: the session has been ARMED, or beyond.
        trouble: the first sign that the running session is going to end badly: when, and what.
        first_event: the first limit that was passed: code, of whom, limit, and when, ns.
        end: the session's last word.
        ended_at: when that was heard.
        times: of the run.
    """

    def __init__(
        self, node: Node, run: RunSpec, say: RunListener, hear: Callable[[], None]
    ) -> None:
        self._node, self._run, self._say, self._hear = node, run, say, hear
        self.is_led_by_us = self.was_armed = False
        self.state: int | None = None
        self.trouble: tuple[float, str] | None = None
        self.first_event: tuple[int, str, float, int] | None = None
        self.end: SessionState | None = None
        self.ended_at: float | None = None
        self.times = RunTimes()
        # While the session is ARMED and not every object reports that it is.
        self._arming: ArmedObjects | None = None
        self._last_note_at = time.monotonic()
        sub = node.create_subscription
        with_info: Any = self._on_session  # rclpy's MessageInfo too, which its stubs don't know
        sub(SessionState, names.SESSION_STATE, with_info, ros.LATCHED)
        sub(TriggerEvent, names.TRIGGER_EVENT, self._on_trigger, ros.LATCHED)
        sub(PhaseEvent, names.PHASE_EVENT, self._on_phase, ros.LATCHED)
        sub(SafetyEvent, names.SAFETY_EVENT, self._on_safety, ros.LATCHED)
        sub(FaultEvent, names.FAULT_EVENT, self._on_fault, ros.LATCHED)

    def say_state(self, state: int) -> None:
        """Say a state that is new."""
        if state == self.state:
            return
        self.state = state
        self._last_note_at = time.monotonic()
        self._stop_arming()
        if state == SessionPhase.ARMED:
            # Objects were asked to arm, and each may still refuse.
            self._arming = ArmedObjects(self._node, self._run)
            self._say(f"session {ARMING}: an object may still refuse")
        else:
            self._say(f"session {SessionPhase(state).name}")

    def say_armed(self) -> None:
        """Say once that every object reports that it is armed."""
        if self._arming is not None and self._arming.all:
            self._stop_arming()
            self._say(f"session {SessionPhase.ARMED.name}: every object reports it")

    def say_wait(self, state: int, cause: str) -> None:
        """Say what a step waits for, now and then."""
        if cause and time.monotonic() - self._last_note_at > _SAY_AGAIN_S:
            self._last_note_at = time.monotonic()
            arming = state == SessionPhase.ARMED and self._arming is not None
            self._say(f"waiting in {ARMING if arming else SessionPhase(state).name}: {cause}")

    def _stop_arming(self) -> None:
        if self._arming is not None:
            self._arming.close()
            self._arming = None

    # -- callbacks -----------------------------------------------------------------------------

    def _on_session(self, message: SessionState, info: Any) -> None:
        self.was_armed |= message.state >= SessionState.STATE_ARMED
        self._hear()
        if not self.is_led_by_us:
            self.say_state(message.state)
        if message.state == SessionState.STATE_RUNNING:
            self.times.start(message.header.stamp, sent_at(info))
        if message.state == SessionState.STATE_ABORTING:
            self._note_trouble(message.reason)
        over = message.state in (SessionState.STATE_FINISHED, SessionState.STATE_ABORTED)
        given_up = message.event == STANDSTILL_GIVEN_UP
        if given_up:
            self._say(f"{message.reason}; keep clear")
        if over or given_up:
            self.end = message
            self.ended_at = self.ended_at or time.monotonic()
            self.times.end(message.header.stamp, sent_at(info))

    def _note_trouble(self, what: str) -> None:
        self.trouble = self.trouble or (time.monotonic(), what)

    def _on_trigger(self, message: TriggerEvent) -> None:
        sent = f"reference {', '.join(message.reference_ids)} sent"
        self._say(
            f"trigger {message.trigger_id}: {message.condition} at "
            f"{self.times.since_start_s(message.crossing_time):.3f} s, "
            f"{sent if message.reference_ids else 'judged'} {message.processing * 1e3:.1f} ms later"
        )

    def _on_phase(self, message: PhaseEvent) -> None:
        stamp_s = self.times.since_start_s(message.header.stamp)
        mark = ", provisional: the recording's end tells" if message.provisional else ""
        self._say(f"phase {Phase(message.phase).name.lower()} at {stamp_s:.2f} s{mark}")

    def _on_safety(self, message: SafetyEvent) -> None:
        who = f" {message.object_id}" if message.object_id else ""
        figures = ""
        if message.words:
            figures = f" {message.words}"
        elif message.code != SafetyCode.OPERATOR:
            unit = f" {message.unit}" if message.unit else ""
            figures = f": {message.measured:.3g}{unit}, limit {message.limit:.3g}{unit}"
        stamp_s = self.times.since_start_s(message.header.stamp)
        if self.was_armed and self.first_event is None:
            at_ns = time.monotonic_ns()
            self.first_event = message.code, message.object_id, message.limit, at_ns
        if self.times.zero_ns is not None:
            # What came before the start may be left over from another session.
            self._note_trouble(f"{message.limit_name}{who}{figures}")
        self._say(
            f"SAFETY {message.limit_name}{who}{figures} at {stamp_s:.2f} s (seen by "
            f"{message.source}, {message.reaction})"
        )

    def _on_fault(self, message: FaultEvent) -> None:
        if message.source == self._node.get_name():
            # Injected by the runner, which says so itself.
            return
        stamp_s = self.times.since_start_s(message.header.stamp)
        self._say(
            f"FAULT {message.fault.partition(' ')[2]} of {message.target} "
            f"{'begins' if message.active else 'ends'} ({stamp_s:.2f} s)"
        )
