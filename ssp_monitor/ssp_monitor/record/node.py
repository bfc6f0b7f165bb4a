"""Records until somebody says stop: the recorder's parts without a session around them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from ssp_core import names
from ssp_core.errors import HostError
from ssp_monitor.core.closing import Closed
from ssp_monitor.core.plan import RecordingPlan
from ssp_monitor.recording.node import Recording
from ssp_msgs.msg import RecorderStatus

POLL_S = 0.5
NODE_NAME = "recorder"


def record(
    plan: RecordingPlan,
    stop: threading.Event,
    duration_s: float | None,
    tell: Callable[[RecorderStatus], None],
) -> tuple[Closed, str]:
    """Records what a plan asks for.

    Args:
        plan: without topics of its own.
        stop: ends it.
        duration_s: ends it too, None for never.
        tell: is given the recorder's state twice a second, and once when all is received.

    Returns:
        What became of the bag, and why the recording ended by itself; empty when it was told to.

    Raises:
        InputError: the bag can't be made.
        HostError: the bag can't be written, or reception failed.
    """
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        # Nothing is spun: of a node that only looks at the graph, nobody asks anything.
        node = Node(
            NODE_NAME,
            namespace=names.NAMESPACE,
            enable_rosout=False,
            start_parameter_services=False,
        )
        recording = Recording(node, plan, {})
        until_s = None if duration_s is None else time.monotonic() + duration_s
        why = ""
        try:
            while not why and not stop.is_set():
                left_s = POLL_S if until_s is None else min(POLL_S, until_s - time.monotonic())
                if left_s <= 0:
                    break
                stop.wait(left_s)
                why = _poll(recording, tell)
        finally:
            closed = recording.close()
            tell(recording.status())
        node.destroy_node()
        return closed, why
    finally:
        rclpy.try_shutdown()


def _poll(recording: Recording, tell: Callable[[RecorderStatus], None]) -> str:
    if recording.intake.error is not None:
        raise HostError(f"reception ended: {recording.intake.error}") from recording.intake.error
    disk = recording.poll()
    status = recording.status()
    tell(status)
    return str(status.failure) or disk.ends or ""
