"""The ROS parts that all nodes share: QoS, stamps, parameters, subscriptions, signals, executor.

A package's ``ros`` folders are the only places in it that import rclpy, messages or this package.
"""

from __future__ import annotations

import faulthandler
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import rclpy
from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.duration import Duration
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_msgs.msg import String

from ssp_core.cdr.messages import stamp_ns
from ssp_core.clock import NS_PER_S, time_ns
from ssp_core.cycles import search_as_usual
from ssp_core.errors import InputError, SspError
from ssp_core.host.environment import require_sound
from ssp_core.host.terminal import (
    catch_stop_signals,
    end_at_once,
    keep_output_to_ourselves,
    survive_lost_output,
)
from ssp_core.names import NAMESPACE, declared_topic
from ssp_core.node_interface import QOS, Parameter, Status
from ssp_core.run_file.participation import ParticipantKind

T = TypeVar("T")


def _profile(name: str) -> QoSProfile:
    qos = QOS[name]
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.latched else DurabilityPolicy.VOLATILE,
    )


# A publisher and its subscribers take the same profile, by name.
STATE, COMMAND, SENSOR = _profile("STATE"), _profile("COMMAND"), _profile("SENSOR")
LATCHED, TF, TF_STATIC = _profile("LATCHED"), _profile("TF"), _profile("TF_STATIC")
VLA = _profile("VLA")
# Subscriptions to drivers that aren't ours: a best-effort reader hears either kind of writer.
DRIVER = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=50, reliability=ReliabilityPolicy.BEST_EFFORT
)


def stamp_from_ns(ns: int) -> TimeMsg:
    return TimeMsg(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


ns_from_stamp = stamp_ns


def session_ns(stamp: TimeMsg) -> int:
    """Return a stamp that a node goes on with, ns; raise ValueError for one of no session."""
    return time_ns(stamp.sec, stamp.nanosec)


def diagnostic_array(statuses: Iterable[Status], stamp_ns: int) -> DiagnosticArray:
    """Return the statuses, dated by this host's clock as is usual on that topic."""
    array = DiagnosticArray()
    array.header.stamp = stamp_from_ns(stamp_ns)
    array.status = [
        DiagnosticStatus(
            level=bytes([status.level]),
            name=status.name,
            hardware_id=status.part,
            message=status.message,
            values=[KeyValue(key=key, value=value) for key, value in status.values],
        )
        for status in statuses
    ]
    return array


def declare(node: Node, table: Iterable[Parameter]) -> dict[str, Any]:
    """Declare the parameters of a table, each with its descriptor, and give their values.

    Raises:
        InputError: a value is of another type than its parameter's, or out of its range.
    """
    values = {}
    for one in table:
        # rclpy would end with a traceback for what is wrong, and take no 5 where 5.0 is meant.
        as_given = ParameterDescriptor(dynamic_typing=True)
        value = one.check(node.declare_parameter(one.name, one.default, as_given).value)
        node.undeclare_parameter(one.name)
        node.declare_parameter(one.name, value, _descriptor(one), ignore_override=True)
        values[one.name] = value
    return values


def _descriptor(one: Parameter) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(
        description=one.description,
        additional_constraints=one.constraint,
        read_only=one.read_only,
    )
    if isinstance(one.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=one.least, to_value=one.most)
        ]
    elif one.is_number:
        bounds = {"from_value": int(one.least), "to_value": int(one.most)}
        descriptor.integer_range = [IntegerRange(**bounds, step=1)]
    return descriptor


def declare_kind(node: Node, kind: ParticipantKind, *participants: str) -> None:
    """Declare what participants of a live session are, in latched messages (METHOD 4.4b)."""
    for who in participants:
        node.create_publisher(String, declared_topic(who), LATCHED).publish(String(data=kind))


def hear_kind(node: Node, participant: str, take: Callable[[str], None]) -> Subscription:
    """Hear what a participant is declared to be; ``take`` gets the word of each declaration."""

    def take_word(message: Any) -> None:
        take(message.data)

    return node.create_subscription(String, declared_topic(participant), take_word, LATCHED)


def subscribe_raw(
    node: Node,
    kind: Any,
    topic: str,
    decode: Callable[[Any], T],
    callback: Callable[[T], None],
    qos: QoSProfile,
    *,
    raw: bool = True,
) -> Any:
    """Subscribe to messages that are decoded by one of ``ssp_core.cdr``, not by rclpy.

    A message that is none is dropped, which is as good as silence; the first one of a topic is
    logged, because more of the same would tell nothing new and cost time.

    Args:
        node: owns the subscription.
        kind: class of the messages.
        topic: relative to the node's namespace.
        decode: raises ValueError for bytes that are no such message.
        callback: takes what ``decode`` gives.
        qos: of the subscription.
        raw: False: ``decode`` takes what rclpy has decoded.
    """
    decode_or_tell = tolerant(node, topic, decode)

    def take(data: Any) -> None:
        message = decode_or_tell(data)
        if message is not None:
            callback(message)

    return node.create_subscription(kind, topic, take, qos, raw=raw)


# At its end a node waits for what is under way, until so many looks found nothing (0.1 s where the
# machine isn't busy), and for no more than so many altogether (0.4 s). Looks, since on a busy
# machine those that bring a message wait for a processor as long as who looks for it.
_LOOK_S = 0.004
_CALM_LOOKS = 25
_MOST_LOOKS = 100


def take_the_rest(take: Callable[[], bool]) -> None:
    """Take what has arrived and what is under way.

    Args:
        take: takes what is there, and tells whether that was something.
    """
    calm = 0
    for _ in range(_MOST_LOOKS):
        calm = 0 if take() else calm + 1
        if calm > _CALM_LOOKS:
            return
        time.sleep(_LOOK_S)


def take_arrived(subscription: Any) -> bool:
    """Give the callback what no executor has taken yet; tell whether there was something."""
    with subscription.handle:
        has_messages = False
        while one := subscription.handle.take_message(subscription.msg_type, subscription.raw):
            subscription.callback(one[0])
            has_messages = True
    return has_messages


# What a reader misses can't be sent again once its writer is gone, so that a node waits at its end,
# but no longer than this: a reader may hang.
LAST_WORD_S = 2.0


def await_readers(node: Node) -> None:
    """Wait until all that the node published has reached its reliable readers, or LAST_WORD_S."""
    deadline = time.monotonic() + LAST_WORD_S
    for publisher in node.publishers:
        left_s = max(0.0, deadline - time.monotonic())
        publisher.wait_for_all_acked(Duration(seconds=left_s))


def tolerant(node: Node, topic: str, decode: Callable[[Any], T]) -> Callable[[Any], T | None]:
    """Wrap ``decode`` for subscribe_raw: None for bytes that are no message, reported once."""
    is_reported = False

    def decode_or_tell(data: Any) -> T | None:
        nonlocal is_reported
        try:
            return decode(data)
        except ValueError as error:
            if not is_reported:
                is_reported = True
                node.get_logger().error(
                    f"{topic}: message dropped (more will be without a word): {error}"
                )
            return None

    return decode_or_tell


def make_executor() -> Executor:
    """Make an EventsExecutor where this rclpy has it, a SingleThreadedExecutor otherwise."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


# For executor, node and context, and the interpreter's own end; usually they take 0.1 s.
_TEARDOWN_LIMIT_S = 10.0


@contextmanager
def bounded_teardown() -> Iterator[None]:
    """End this process with status 1, and its stacks on stderr, if the block lasts too long.

    Middleware may hang in it with Python's lock held, where nothing of Python's own runs any more.
    """
    faulthandler.dump_traceback_later(_TEARDOWN_LIMIT_S, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


class StopRequest:
    """Set by SIGINT, SIGTERM, SIGHUP or SIGQUIT, or by the node itself; the loop looks at it."""

    def __init__(self) -> None:
        self.reason: str | None = None

    def set(self, reason: str) -> None:
        if self.reason is None:
            self.reason = reason


def init(
    args: list[str] | None = None,
    context: rclpy.Context | None = None,
    domain_id: int | None = None,
) -> None:
    """Begin ROS in this process.

    Signals are left alone: rclpy's own handler would invalidate the context before a node could say
    that it stops.

    Args:
        args: for ROS to read; None: those of this process.
        context: that begins; None: the process's own.
        domain_id: None: the one that the environment names.

    Raises:
        InputError: a variable of the environment is wrong; names all of them.
    """
    require_sound(os.environ)
    keep_output_to_ourselves()
    rclpy.init(
        args=args,
        context=context,
        domain_id=domain_id,
        signal_handler_options=SignalHandlerOptions.NO,
    )


def _report(error: SspError) -> None:
    # Terminal output is slow to import, and a node that has no error prints none.
    from ssp_core.console import report_error

    report_error(str(error))


def run_node(
    make: Callable[[StopRequest], Node],
    shutdown: Callable[[Any], None],
    args: list[str] | None = None,
    afterwards: Callable[[Any], None] | None = None,
) -> int:
    """Run one node in this process until a signal, or until the node asks to stop; then exit.

    Signals only set a flag; ``shutdown(node)`` then runs with the context still valid, and the
    node's readers get what they lack of it.

    Args:
        make: makes the node; by the StopRequest it can ask to stop.
        shutdown: ends the node in order; takes it.
        args: for ROS to read; None: those of this process, in which it finds remap rules also
            before ``--ros-args``. A command that reads its own gives an empty list.
        afterwards: what is left to do without ROS after an orderly stop; takes the node.

    Returns:
        Never: the process ends with status 0 after an orderly stop, 1 when the node raised or a
        variable of the environment is wrong: an SspError is one message on standard error, anything
        else is a traceback.
    """
    # A process that has to be killed says first where it hung (ProcessGroup.stop sends SIGABRT).
    faulthandler.enable()
    survive_lost_output()
    stop = StopRequest()
    try:
        init(args)
    except InputError as error:
        _report(error)
        sys.exit(1)
    catch_stop_signals(lambda number: stop.set(number.name))
    status = 0
    node: Node | None = None
    executor = make_executor()
    try:
        node = make(stop)
        executor.add_node(node)
        # Looking for cycles among what was imported and made so far, again and again, would stop a
        # running node for some 10 ms each time.
        search_as_usual()
        while stop.reason is None and rclpy.ok():
            executor.spin_once(timeout_sec=0.2)
    except SspError as error:
        _report(error)
        status = 1
    except Exception:
        traceback.print_exc()
        status = 1
    finally:
        try:
            if node is not None:
                shutdown(node)
                await_readers(node)
        except SspError as error:
            _report(error)
            status = 1
        except Exception:
            traceback.print_exc()
            status = 1
        # The node has said and closed what it had to. Middleware that hangs while it is taken down
        # must not make the runner kill a process whose work is done.
        faulthandler.dump_traceback_later(_TEARDOWN_LIMIT_S, exit=True)
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    if afterwards is not None and node is not None and status == 0:
        faulthandler.cancel_dump_traceback_later()
        afterwards(node)
    end_at_once(status)


def make_node(name: str, cls: type[Node] = Node, **kwargs: Any) -> Node:
    """Return a node in the project's namespace."""
    return cls(name, namespace=NAMESPACE, **kwargs)
