"""The self-description of a node, without ROS: its parameters and its diagnostic status.

A node has one table of parameters, in its package's ``ros/parameters.py``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from ssp_core.errors import InputError

Value = bool | int | float | str | list[str]
_WORDS = {bool: "true or false", int: "an integer", float: "a number", str: "a text"}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a node.

    Args:
        name: as in ROS; a unit that isn't SI's own is its suffix.
        default: gives the type as well: bool, int, float, str, or a list of str.
        description: what it is for, with unit and sign of a number; begins in lower case.
        least: smallest number that is taken; numbers have both bounds.
        most: largest one.
        text: what a text must be, in words; what reads it holds it to that.
        pattern: regular expression that the whole of a text must match, where one says it all.
        required: an empty text is refused.
        secret: an error doesn't quote the value.
        read_only: can't be set while the node runs.
    """

    name: str
    default: Value
    description: str
    least: float = 0
    most: float = 0
    text: str = ""
    pattern: str = ""
    required: bool = False
    secret: bool = False
    read_only: bool = True

    @property
    def is_number(self) -> bool:
        return isinstance(self.default, int | float) and not isinstance(self.default, bool)

    @property
    def constraint(self) -> str:
        """Describe in words the values that are accepted."""
        if self.is_number:
            return f"{self.least:.10g} to {self.most:.10g}"
        return self.text or _WORDS.get(type(self.default), "a list of texts")

    def check(self, value: object) -> Value:
        """Return the value as the node is to have it; an integer will do where a number is wanted.

        Raises:
            InputError: it is of another kind, or out of range.
        """
        kind = type(self.default)
        if kind is float and type(value) is int:
            value = float(value)
        if kind is list and (value is None or (isinstance(value, list | tuple) and not value)):
            return self.default  # ROS knows no type of an empty list
        if isinstance(value, kind) and (kind is bool or not isinstance(value, bool)):
            if self.is_number:
                fits = isinstance(value, int | float) and self.least <= value <= self.most
            elif isinstance(value, str):
                fits = bool(value or not self.required) and (
                    not self.pattern or bool(re.fullmatch(self.pattern, value))
                )
            else:
                fits = not isinstance(value, list) or all(isinstance(one, str) for one in value)
            if fits:
                return value
            problem = "is out of range" if self.is_number else f"must be {self.constraint}"
        else:
            problem = f"must be {_WORDS.get(kind, 'a list of texts')}"
        raise InputError(
            problem,
            field=f"parameter {self.name}",
            value=None if self.secret else value,
            remedy=f"from {self.constraint}" if self.is_number else f"give {self.constraint}",
        )


RUN_FILE = Parameter("run_file", "", "the run", text="path of an ssp.run/1 file", required=True)


class Qos(NamedTuple):
    """The offer of reliable publishers: messages kept, and whether late joiners get them."""

    depth: int
    latched: bool = False


QOS = {
    "STATE": Qos(50),  # periodic states, ticks, heartbeats
    "COMMAND": Qos(50),  # references, acknowledgements, actuator commands
    "SENSOR": Qos(20),  # camera frames: none may be lost, they are what is scored
    "LATCHED": Qos(20, latched=True),  # session state, events, camera info
    "TF": Qos(100),  # as tf2_ros
    "TF_STATIC": Qos(1, latched=True),  # as tf2_ros
    "VLA": Qos(4),  # requests and responses
}


class Level(IntEnum):
    """The levels, by the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Status:
    """One part's health.

    Args:
        part: what it belongs to: an object's id, or a node's name.
        values: names with units, and what was measured.
    """

    name: str
    part: str
    level: Level
    message: str
    values: tuple[tuple[str, str], ...] = ()
