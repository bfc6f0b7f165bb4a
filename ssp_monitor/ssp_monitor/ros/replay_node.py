"""The node ``replay``: publishes a bag and offers services that control it."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import click
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rosgraph_msgs.msg import Clock as ClockMsg
from std_srvs.srv import Trigger

from ssp_core import names, ros
from ssp_core.bag.pictures.stamps import leap_text, pause_text
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.clock import ns_to_seconds
from ssp_core.console import err, note
from ssp_core.errors import HostError
from ssp_core.host.environment import adopt
from ssp_core.run_file.participation import ParticipantKind
from ssp_monitor.replay.plan import ReplayOptions, make_plan, played, session_signs
from ssp_monitor.replay.player import Leap, MessageSource, Pause, Player
from ssp_monitor.replay.terminal import ReplayOutcome, plan_lines, progress_line
from ssp_monitor.ros.conversions import message_class, profile_of, why_not_installed
from ssp_monitor.ros.parameters import REPLAY

NODE = "replay"
# How long it is listened for a session before anything is published. Discovery takes 0.3 s as a
# rule and a few seconds now and then, so that the watch goes on afterwards.
LOOK_S = 1.5
COMMANDS_LOOK_S = 3.0
WATCH_S = 1.0
PROGRESS_S = 0.1
MATCH_S = 5.0
WAIT_FOR_S = 30.0
ACKNOWLEDGED_S = 3.0
POLL_S = 0.02


class ReplayNode(Node):
    """Publishes one bag.

    Args:
        reader: the bag; stays open.

    Raises:
        InputError: a wish doesn't fit the bag.
        HostError: a session is under way, or an awaited subscriber doesn't listen.
    """

    def __init__(self, reader: BagReader, wishes: ReplayOptions, stop: ros.StopRequest) -> None:
        super().__init__(NODE, namespace=names.NAMESPACE)
        self._wishes = wishes
        self._stop = stop
        self._error: HostError | None = None
        self._plan = make_plan(reader.topics, wishes, why_not_installed)
        self._tape = MessageSource(reader, self._plan.lines, wishes)
        for line in plan_lines(self._plan):
            note(line)
        self._look()
        self._outlets: dict[str, Publisher] = {
            line.recorded: self.create_publisher(
                message_class(line.msgtype), line.topic, profile_of(line.offer)
            )
            for line in self._plan.lines
        }
        self._clock_publisher = (
            self.create_publisher(ClockMsg, names.CLOCK, ros.STATE) if self._plan.clock_hz else None
        )
        ros.declare_kind(self, ParticipantKind.PLAYED, *played(self._plan.lines))
        self._await_subscribers()
        self.player = Player(
            self._tape,
            self._plan,
            wishes,
            self._send,
            self._tick,
            lambda: stop.set("end"),
            self._tell,
        )
        self._offer_commands()
        if stop.reason is None:
            self.player.start()

    def _send(self, message: BagMessage) -> None:
        self._outlets[message.topic].publish(bytes(message.data))

    def _tick(self, bag_ns: int) -> None:
        if self._clock_publisher is not None:
            self._clock_publisher.publish(ClockMsg(clock=ros.stamp_from_ns(bag_ns)))

    def _tell(self, gap: Leap | Pause) -> None:
        """Say that a gap of the log times is skipped, or for how long it is waited for."""
        if isinstance(gap, Leap):
            note(f"{leap_text(gap.before_ns, gap.after_ns)}; skipped")
            return
        wait_s = ns_to_seconds(gap.after_ns - gap.before_ns) / self._wishes.rate
        note(f"{pause_text(gap.before_ns, gap.after_ns)}; waits {wait_s:.1f} s (--start skips it)")

    def _signs(self) -> list[str]:
        return session_signs(
            self.get_node_names_and_namespaces(), self.get_service_names_and_types()
        )

    def _look(self) -> None:
        """Listen for a session, for longer when commands would be published."""
        if self._wishes.beside_session:
            return
        look_s = COMMANDS_LOOK_S if self._wishes.commands else LOOK_S
        until = time.monotonic() + look_s
        while time.monotonic() < until and self._stop.reason is None:
            if signs := self._signs():
                raise HostError(_refusal(signs))
            threading.Event().wait(POLL_S)

    def _watch(self) -> None:
        """End the replay when a session comes later."""
        if self._error is None and (signs := self._signs()):
            self._error = HostError(_refusal(signs))
            self._stop.set("session")

    def _unmatched(self, topic: str, publisher: Publisher, wait_for: int) -> int:
        """Count the subscribers of a topic that are still to be connected."""
        compatible_count = 0
        for subscriber in self.get_subscriptions_info_by_topic(topic):
            fits = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)[0]
            compatible_count += fits != QoSCompatibility.ERROR
        return max(compatible_count, wait_for) - int(publisher.get_subscription_count())

    def _await_subscribers(self) -> None:
        """Wait until all present subscribers are connected, and as many as were asked for."""
        wait_for = self._wishes.wait_for
        limit_s = WAIT_FOR_S if wait_for else MATCH_S
        until = time.monotonic() + limit_s
        topics = [line.topic for line in self._plan.lines]
        while self._stop.reason is None:
            waiting = [
                topic
                for topic, publisher in zip(topics, self._outlets.values(), strict=True)
                if self._unmatched(topic, publisher, wait_for) > 0
            ]
            if not waiting:
                break
            if time.monotonic() >= until:
                some = ", ".join(waiting[:5]) + (", ..." if len(waiting) > 5 else "")
                if wait_for:
                    raise HostError(
                        f"not {wait_for} subscriber{'s' * (wait_for > 1)} of each topic after "
                        f"{limit_s:g} s: {some}"
                    )
                note(f"not all subscribers are connected after {limit_s:g} s: {some}")
                break
            threading.Event().wait(POLL_S)

    def _offer_commands(self) -> None:
        for name in ("pause", "resume", "step", "step_frame"):
            do: Callable[[], None] = getattr(self.player, name)
            self.create_service(Trigger, f"~/{name}", self._answer(do))
        ros.declare(self, [replace(one, default=self._wishes.rate) for one in REPLAY])
        self.add_on_set_parameters_callback(self._set_parameters)
        # Steady: /clock may be paused, or be published by this very node.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if err.is_terminal:
            self.create_timer(PROGRESS_S, self._show_progress, clock=steady)
        if not self._wishes.beside_session:
            self.create_timer(WATCH_S, self._watch, clock=steady)

    def _answer(
        self, do: Callable[[], None]
    ) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            do()
            response.success, response.message = True, self._line()
            return response

        return answer

    def _set_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == "rate":
                try:
                    self.player.set_rate(float(parameter.value))
                except ValueError as error:  # beyond the range by a rounding
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _line(self) -> str:
        tape = self._tape
        return progress_line(
            self.player.progress(), tape.bag_start_ns, tape.end_ns, len(self._plan.lines)
        )

    def _show_progress(self) -> None:
        err.print(f"\r{self._line()}", end="\x1b[K", markup=False)

    def close(self) -> None:
        """End the replay and say how it went.

        Raises:
            HostError: a session came up, or the replay ended early for another reason.
            InputError: the bag is damaged.
        """
        self.player.stop()
        until = time.monotonic() + ACKNOWLEDGED_S
        late = [
            line.topic
            for line in self._plan.lines
            if not self._outlets[line.recorded].wait_for_all_acked(
                Duration(seconds=max(until - time.monotonic(), 0.0))
            )
        ]
        outcome = ReplayOutcome(
            self._stop.reason or "end",
            self.player.progress(),
            self.player.lateness,
            self._plan,
            late,
        )
        if err.is_terminal:
            err.print()
        if self._wishes.json:
            click.echo(json.dumps(outcome.as_json(), indent=1))
        else:
            for line in outcome.lines():
                note(line)
        if self._error is not None:
            raise self._error
        if self.player.error is not None:
            raise self.player.error


def _refusal(signs: list[str]) -> str:
    return (
        f"a session is under way in ROS domain {os.environ.get('ROS_DOMAIN_ID', '0')} "
        f"({', '.join(signs[:4])}{', ...' if len(signs) > 4 else ''}), and a replay would pass for "
        "it; use another ROS_DOMAIN_ID, or --beside-session where that is what you want"
    )


def replay(reader: BagReader, wishes: ReplayOptions, environment: dict[str, str]) -> int:
    """Replay a bag in this process, which ends with it; see ros.run_node."""
    adopt(environment)
    os.environ.update(environment)
    return ros.run_node(
        lambda stop: ReplayNode(reader, wishes, stop),
        ReplayNode.close,
        # ROS would apply --remap once more, after it was checked where a topic goes.
        args=[],
    )
