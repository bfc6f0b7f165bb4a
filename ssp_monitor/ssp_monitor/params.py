"""Parameters of the node ``monitor``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rclpy.node import Node

from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class MonitorParams:
    """The run to record, and the bag directory to make."""

    run_file: Path
    bag_dir: Path


def _path(node: Node, name: str) -> Path:
    value = node.declare_parameter(name, "").value
    if not isinstance(value, str) or not value:
        raise InputError(
            "must be a path", field=f"parameter {name}", value=value, remedy=f"give -p {name}:=PATH"
        )
    return Path(value)


def read_params(node: Node) -> MonitorParams:
    """Declares and reads the parameters.

    Raises:
        InputError: one is missing.
    """
    return MonitorParams(run_file=_path(node, "run_file"), bag_dir=_path(node, "bag_dir"))
