"""Parameters of the node ``monitor_page``."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from ssp_core.errors import InputError
from ssp_core.page_token import TOKEN_VARIABLE, check_token

DEFAULT_PORT = 8080


@dataclass(frozen=True, slots=True)
class PageParams:
    """What the page is told.

    Args:
        run_file: of the session; None: what can be learnt from topics.
        host: address to listen on.
        port: to listen on; 0: any.
        token: that commands need; empty: one is made.
        rate_hz: snapshots per second.
        camera_rate_hz: pictures per second, at the most.
    """

    run_file: Path | None
    host: str
    port: int
    rate_hz: float
    camera_rate_hz: float
    token: str = field(default="", repr=False)


def read_params(node: Node) -> PageParams:
    """Declares and reads the parameters; the token may also come in SSP_PAGE_TOKEN.

    Raises:
        InputError: one of them is out of its range.
    """
    # Whatever its type, a value is judged here: rclpy would end with a traceback for the wrong one.
    anything = ParameterDescriptor(dynamic_typing=True)

    def value(name: str, default: object) -> object:
        return node.declare_parameter(name, default, anything).value

    port = value("port", DEFAULT_PORT)
    if not isinstance(port, int) or isinstance(port, bool) or not 0 <= port <= 65535:
        raise InputError("must be a port, 0 to 65535", field="parameter port", value=port)
    token = str(value("token", "")) or os.environ.get(TOKEN_VARIABLE, "")
    if token:
        check_token(token, "parameter token")
    run_file = str(value("run_file", ""))
    return PageParams(
        run_file=Path(run_file) if run_file else None,
        host=str(value("host", "127.0.0.1")),
        port=port,
        rate_hz=_rate("page_rate_hz", value("page_rate_hz", 10.0)),
        camera_rate_hz=_rate("camera_rate_hz", value("camera_rate_hz", 5.0)),
        token=token,
    )


def _rate(name: str, value: object) -> float:
    if not isinstance(value, int | float) or not 2.0 <= value <= 30.0:
        raise InputError("must be 2 to 30 Hz", field=f"parameter {name}", value=value)
    return float(value)
