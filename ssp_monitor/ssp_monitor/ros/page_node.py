"""The node ``monitor_page``: hears a session and serves the operators' page about it."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage

from ssp_core import names, ros
from ssp_core.cdr.references import decode_ack
from ssp_core.clock import NS_PER_S
from ssp_core.credentials import TOKEN_VARIABLE, check_token
from ssp_core.errors import HostError
from ssp_core.host.children import outlive_parent
from ssp_core.host.terminal import catch_stop_signals
from ssp_core.run_file.model import load_run
from ssp_core.run_file.verdict import EndWord
from ssp_monitor.page.access import is_loopback, make_token
from ssp_monitor.page.server import PageServer
from ssp_monitor.page.snapshot import Pictures, Snapshots, site_message
from ssp_monitor.page.viewers import Payload
from ssp_monitor.ros.parameters import PAGE
from ssp_monitor.ros.session_subscriptions import LOOK_PERIOD_S, SessionSubscriptions
from ssp_monitor.status import messages
from ssp_monitor.status.board import Answer, Board, Event, StateOnPage
from ssp_msgs.msg import FaultEvent, ReferenceAck, SafetyEvent, TriggerEvent
from ssp_msgs.srv import SessionCommand

_ACK_TYPE = "ssp_msgs/msg/ReferenceAck"
# After the end the page stays for so long, but not for so long without a viewer: one may reload.
STAY_S = 60.0
UNSEEN_S = 10.0
# After the end of the run no process of the page is there for longer than this, s.
_ENDS_S = 90
# Shorter than the silence that a viewer takes for a lost connection.
AGAIN_S = 0.4


class ManagerCommands:
    """Passes commands on to the manager's services.

    rclpy's clients may be called in any thread, so that an abort waits for no timer of ours.

    Args:
        session_token: of the session that the page shows.
    """

    def __init__(self, node: Node, session_token: Callable[[], str]) -> None:
        self._session_token = session_token
        self._clients = {
            word: node.create_client(SessionCommand, word) for word in names.SESSION_COMMANDS
        }

    def offered(self) -> frozenset[str]:
        """Return commands whose services were found."""
        return frozenset(word for word, one in self._clients.items() if one.service_is_ready())

    def ask(self, command: str, who: str, state_on_page: StateOnPage | None) -> Future[Answer]:
        """Send a command as PageServer's Commands.

        An answer that never comes leaves the future as it is.
        """
        answer: Future[Answer] = Future()
        client = self._clients[command]
        if not client.service_is_ready():
            text = f"no scenario manager offers {command} in this ROS domain"
            answer.set_result(Answer(False, text, answered=False))
            return answer
        request = SessionCommand.Request(requested_by=who, session_token=self._session_token())
        if state_on_page is not None:
            request.shown_state = state_on_page.state
            request.shown_since = ros.stamp_from_ns(state_on_page.since_ns)
        pending_response = client.call_async(request)
        pending_response.add_done_callback(partial(_pass_on, answer))
        answer.add_done_callback(lambda done: _forget(client, pending_response, done))
        return answer


def _pass_on(answer: Future[Answer], pending_response: Any) -> None:
    if answer.set_running_or_notify_cancel():
        answer.set_result(messages.command_answer(pending_response.result()))


def _forget(client: Client, pending_response: Any, answer: Future[Answer]) -> None:
    """Forget a request whose answer never came."""
    if answer.cancelled():
        client.remove_pending_request(pending_response)


class MonitorPage(Node):
    """Owns subscriptions, board and server.

    Raises:
        InputError: a parameter or the run file is wrong.
        HostError: the port is taken.
    """

    def __init__(self, stop: ros.StopRequest) -> None:
        super().__init__(names.MONITOR_PAGE, namespace=names.NAMESPACE)
        self._stop = stop
        parameters = ros.declare(self, PAGE)
        own = parameters["token"] or os.environ.get(TOKEN_VARIABLE, "")
        token = check_token(own, "parameter token") if own else make_token()
        run = load_run(parameters["run_file"]) if parameters["run_file"] else None
        self._board = Board(run)
        self._snapshots = Snapshots(self._board)
        self._events_pushed = -1
        self._watch = SessionSubscriptions(self, self._board)
        self._pictures = Pictures(self._board, int(NS_PER_S / parameters["camera_rate_hz"]))
        self._acks: set[str] = set()
        self._subscribe()
        self._commands = ManagerCommands(self, self._session_token)
        self.server = PageServer(parameters["host"], parameters["port"], token, self._commands)
        self.server.push({"site": json.dumps({"type": "site", **site_message(run)})})
        self._announce(not own, token)
        # Steady: a frozen /clock must not freeze the page.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0 / parameters["page_rate_hz"], self._push, clock=steady)
        self.create_timer(LOOK_PERIOD_S, self._look_around, clock=steady)
        if parameters["led_by_runner"]:
            threading.Thread(target=self._hear_runner, name="runner", daemon=True).start()

    def _session_token(self) -> str:
        """Return the run file's token, or without one that of the manager that is heard."""
        run = self._board.run
        return (run.session_token if run is not None else "") or self._board.manager.session_token

    def _announce(self, is_new_token: bool, token: str) -> None:
        if not is_loopback(self.server.door.bind_address):
            print(
                f"page: anybody who can reach {self.server.door.bind_address} sees this port; "
                "reading and commands need the token, which travels unencrypted",
                flush=True,
            )
        # The one time that the token is said, and only when nobody gave it to us.
        print(f"page: {self.server.url}{f'#token={token}' if is_new_token else ''}", flush=True)

    def _subscribe(self) -> None:
        sub = self.create_subscription
        sub(CompressedImage, names.CAMERA_IMAGE, self._on_picture, ros.SENSOR, raw=True)
        event_topics: list[tuple[type, str, Callable[[Any], Event]]] = [
            (SafetyEvent, names.SAFETY_EVENT, messages.safety_event),
            (TriggerEvent, names.TRIGGER_EVENT, messages.trigger_event),
            (FaultEvent, names.FAULT_EVENT, messages.fault_event),
        ]
        for kind, topic, convert in event_topics:
            sub(kind, topic, partial(self._on_event, convert), ros.LATCHED)
        run = self._board.run
        if run is not None:
            self._watch.follow(names.absolute(names.state_topic(run.vut.id)))
            for target in run.targets:
                self._follow_ack(names.absolute(names.ack_topic(target.id)))
                if not run.states_in_one:
                    self._watch.follow(names.absolute(names.state_topic(target.id)))

    def _look_around(self) -> None:
        """Follow objects that the run file, or no run file, names."""
        self._watch.look_around()
        for topic, kinds in self.get_topic_names_and_types():
            if topic.startswith(f"{names.NAMESPACE}/") and _ACK_TYPE in kinds:
                self._follow_ack(topic)
        if not self.server.is_alive:
            raise HostError("the page's server has ended")

    def _follow_ack(self, topic: str) -> None:
        if topic not in self._acks:
            self._acks.add(topic)
            ros.subscribe_raw(self, ReferenceAck, topic, decode_ack, self._on_ack, ros.COMMAND)

    # -- what is heard ---------------------------------------------------------------------------

    def _on_picture(self, data: bytes) -> None:
        self._pictures.put(data, time.monotonic_ns())

    def _on_event(self, convert: Callable[[Any], Event], message: Any) -> None:
        self._board.events.add(convert(message))

    def _on_ack(self, ack: Any) -> None:
        if not ack.accepted:
            self._board.events.add(messages.refused_event(ack))

    def _hear_runner(self) -> None:
        """Take the runner's words, in a thread of its own; without it there is no run."""
        for line in sys.stdin.buffer:
            try:
                word = EndWord.parse(line)
            except ValueError as error:
                self.get_logger().error(str(error))
                continue
            self._snapshots.word = word
            if word.final:
                signal.alarm(_ENDS_S)  # the kernel's: it also ends what hangs
                print("page: heard the end", flush=True)
                self._stop.set("the run has ended")
                return
        self._stop.set("the runner has ended")

    # -- what is shown ---------------------------------------------------------------------------

    def _push(self) -> None:
        """Decode the newest messages, and send them to all viewers."""
        self._watch.settle()
        now_ns = time.monotonic_ns()
        if not self.server.viewers:
            return
        self._board.offered = self._commands.offered()
        if fault := self._pictures.settle():
            self._watch.tell_once(f"{names.CAMERA_IMAGE}: {fault}")
        payloads: dict[str, Payload] = {}
        snapshot = {"type": "snapshot", **self._snapshots.snapshot(now_ns)}
        payloads["snapshot"] = json.dumps(snapshot, separators=(",", ":"), allow_nan=False)
        if self._events_pushed != self._board.events.count:
            self._events_pushed = self._board.events.count
            events = {"type": "events", **self._snapshots.events()}
            payloads["events"] = json.dumps(events, separators=(",", ":"), allow_nan=False)
        if (picture := self._pictures.take(now_ns)) is not None:
            payloads["picture"] = picture
        self.server.push(payloads)

    @property
    def _has_final_word(self) -> bool:
        word = self._snapshots.word
        return word is not None and word.final

    def close(self) -> None:
        """End the server; one that shows the end of a run goes on for its viewers."""
        if self._has_final_word and self.server.viewers:
            outlive_parent()  # it waits for 2 s, and ROS may take longer to end
            self._push()
            self.server.retire()
        else:
            self.server.close()

    def stay(self) -> None:
        """Show the end of the run without ROS: for a minute, as long as there are viewers."""
        if not self.server.is_alive:
            return
        over = threading.Event()
        catch_stop_signals(lambda _: over.set())
        print(f"page: stays for its viewers, {STAY_S:g} s at most", flush=True)
        snapshot = {"type": "snapshot", **self._snapshots.snapshot(time.monotonic_ns())}
        frozen: dict[str, Payload] = {
            "snapshot": json.dumps(snapshot, separators=(",", ":"), allow_nan=False)
        }
        began_s = seen_s = time.monotonic()
        while not over.wait(AGAIN_S) and self.server.is_alive:
            now_s = time.monotonic()
            seen_s = now_s if self.server.viewers else seen_s
            if now_s - began_s > STAY_S or now_s - seen_s > UNSEEN_S:
                break
            self.server.push(frozen)
        self.server.close()


def main() -> None:
    """Run the node."""
    sys.exit(ros.run_node(MonitorPage, MonitorPage.close, afterwards=MonitorPage.stay))


if __name__ == "__main__":
    main()
