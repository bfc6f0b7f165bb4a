"""The bridge's ROS parameters, read once when the node starts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from ssp_core.errors import InputError
from ssp_vla_bridge.core.backend import parse_options
from ssp_vla_bridge.core.interfaces import find_interface

_TOPIC_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


@dataclass(frozen=True)
class BridgeParams:
    """What one bridge serves.

    Args:
        model: name on the topics.
        backend: name of the backend, or ``module:factory``.
        backend_options: its options.
        timeout_s: from request to answer, s.
        queue_limit: requests that may wait besides the one that is worked on.
        interface: for shadow mode: which frames and ego samples it is given; empty: the backend's.
        shadow_hz: how often it is asked about a running session, Hz of its clock; 0: never.
    """

    model: str
    backend: str
    backend_options: dict[str, Any]
    timeout_s: float
    queue_limit: int
    interface: str
    shadow_hz: float


def read_params(node: Node) -> BridgeParams:
    """Declares and reads the parameters.

    Raises:
        InputError: one is wrong, with what would be right.
    """
    model = str(node.declare_parameter("model", "constant_velocity").value)
    backend = str(node.declare_parameter("backend", "").value) or model
    options = parse_options(str(node.declare_parameter("backend_options", "").value))
    timeout_s = float(node.declare_parameter("timeout_s", 60.0).value)
    queue_limit = int(node.declare_parameter("queue_limit", 4).value)
    interface = str(node.declare_parameter("interface", "").value)
    shadow_hz = float(node.declare_parameter("shadow_hz", 0.0).value)
    if not _TOPIC_WORD.fullmatch(model):
        raise InputError(
            "is no name for a topic",
            field="model",
            value=model,
            remedy="use letters, digits and underscores, a letter first",
        )
    if not 0.001 <= timeout_s <= 86400.0:
        raise InputError("must lie in [0.001, 86400] s", field="timeout_s", value=timeout_s)
    if queue_limit < 1:
        raise InputError("must be at least 1", field="queue_limit", value=queue_limit)
    if not 0.0 <= shadow_hz <= 100.0:
        raise InputError("must lie in [0, 100] Hz", field="shadow_hz", value=shadow_hz)
    if interface:
        find_interface(interface)
    return BridgeParams(model, backend, options, timeout_s, queue_limit, interface, shadow_hz)
