"""What all nodes share of ROS: QoS by name, stamps, signals and the executor loop.

The one module of ssp_core that imports rclpy.
"""

from __future__ import annotations

import signal
import sys
import traceback
from collections.abc import Callable
from typing import Any

import rclpy
from builtin_interfaces.msg import Time as TimeMsg
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.signals import SignalHandlerOptions

from ssp_core.clock import NS_PER_S
from ssp_core.console import report_error
from ssp_core.errors import SspError
from ssp_core.messages import stamp_ns
from ssp_core.names import NAMESPACE


def _profile(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


# A publisher and its subscribers take the same profile, by name.
STATE = _profile(50)  # periodic states, ticks, heartbeats
COMMAND = _profile(50)  # references, acknowledgements, actuator commands
SENSOR = _profile(20)  # camera frames: none may be lost, they are what is scored
LATCHED = _profile(20, DurabilityPolicy.TRANSIENT_LOCAL)  # session state, events, camera info
VLA = _profile(4, DurabilityPolicy.VOLATILE)  # requests and responses


def stamp_from_ns(ns: int) -> TimeMsg:
    return TimeMsg(sec=ns // NS_PER_S, nanosec=ns % NS_PER_S)


ns_from_stamp = stamp_ns


def make_executor() -> Executor:
    """EventsExecutor where this rclpy has it, SingleThreadedExecutor otherwise."""
    try:
        from rclpy.experimental import EventsExecutor
    except ImportError:
        return SingleThreadedExecutor()
    return EventsExecutor()


class StopRequest:
    """Set by SIGINT or SIGTERM, or by the node itself; the loop looks at it."""

    def __init__(self) -> None:
        self.reason: str | None = None

    def set(self, reason: str) -> None:
        if self.reason is None:
            self.reason = reason


def run_node(make: Callable[[StopRequest], Node], shutdown: Callable[[Any], None]) -> int:
    """Runs one node in this process until a signal, or until the node asks to stop.

    rclpy's own signal handler would invalidate the context before the node could say that it
    stops, so signals only set a flag; ``shutdown(node)`` then runs with the context still valid.

    Returns:
        0 after an orderly stop, 1 when the node raised: an SspError is one message on standard
        error, anything else is a traceback.
    """
    stop = StopRequest()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda received, _: stop.set(signal.Signals(received).name))
    status = 0
    node: Node | None = None
    executor = make_executor()
    try:
        node = make(stop)
        executor.add_node(node)
        while stop.reason is None and rclpy.ok():
            executor.spin_once(timeout_sec=0.2)
    except SspError as error:
        report_error(str(error))
        status = 1
    except Exception:
        traceback.print_exc()
        status = 1
    finally:
        try:
            if node is not None:
                shutdown(node)
        except SspError as error:
            report_error(str(error))
            status = 1
        except Exception:
            traceback.print_exc()
            status = 1
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        sys.stdout.flush()
    return status


def make_node(name: str, cls: type[Node] = Node, **kwargs: Any) -> Node:
    """A node in the project's namespace."""
    return cls(name, namespace=NAMESPACE, **kwargs)
