"""Parameters of the node ``view``."""

from __future__ import annotations

from pathlib import Path

from rclpy.node import Node

from ssp_core.errors import InputError


def read_run_file(node: Node) -> Path | None:
    """Declares and reads the one parameter; None: what can be learnt from topics alone.

    Raises:
        InputError: it is no text.
    """
    value = node.declare_parameter("run_file", "").value
    if not isinstance(value, str):
        raise InputError("must be a path", field="parameter run_file", value=value)
    return Path(value) if value else None
