"""Parameters of the node ``monitor``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
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


def topic_rules(arguments: Sequence[str]) -> list[str]:
    """Of a process's arguments those that rename topics, and none that renames nodes.

    Args:
        arguments: as in sys.argv, ``-r from:=to`` among them.
    """
    rules = [rule for flag, rule in pairwise(arguments) if flag in ("-r", "--remap")]
    found = [rule for rule in rules if not rule.partition(":=")[0].split(":")[-1].startswith("__")]
    return ["--ros-args", *(word for rule in found for word in ("-r", rule))] if found else []
