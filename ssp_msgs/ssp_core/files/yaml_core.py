"""YAML of files that people write: the core schema of YAML 1.2, without aliases.

YAML 1.1, which PyYAML reads, takes ``0150`` for 104, ``-0:32.1`` for −32.1 and ``on`` for true.
Here a number is decimal, ``0x`` or ``0o``, and only ``true`` and ``false`` are booleans. What looks
like a number and is none stays a text; where a number is wanted it is refused (``number_remedy``).
"""

from __future__ import annotations

import re
from typing import Any

import yaml
from yaml.composer import Composer

# Of one text: YAML takes seven microseconds for each, JSON a tenth of one.
MOST_VALUES = 500_000
# Python shows whole numbers of at most 4300 digits.
_MOST_DIGITS = 4000
_TOO_LARGE = 10**_MOST_DIGITS

_WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9]*)\Z|0o[0-7]+\Z|0x[0-9a-fA-F]+\Z")
_FLOAT = re.compile(
    r"[-+]?(?:\.[0-9]+|(?:0|[1-9][0-9]*)(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?\Z"
    r"|[-+]?\.(?:inf|Inf|INF)\Z|\.(?:nan|NaN|NAN)\Z"
)
_BOOLEAN = re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")
_NULL = re.compile(r"(?:~|null|Null|NULL|)\Z")
# The zeros in front end in one way only, so that a long text is read once.
_ZEROS = re.compile(
    r"([-+]?)(?:0++(?=[1-9])|0+(?=0(?![0-9])))"
    r"([0-9][0-9_]*(?:\.[0-9]*)?(?:[eE][-+]?[0-9]+)?)\Z"
)


class TooManyValuesError(ValueError):
    """A text has more keys and values than are read as YAML.

    Args:
        line: of the first one beyond, from 1.
    """

    def __init__(self, line: int) -> None:
        self.line = line
        super().__init__(f"more than {MOST_VALUES} keys and values")


class CoreLoader(Composer, yaml.CSafeLoader):
    """A safe loader that refuses aliases (a few lines of them can expand to gigabytes).

    libyaml reads the text, five times as fast as PyYAML's own parser; nodes are made in Python,
    where a text that is nested too deeply ends in a RecursionError.
    """

    # Times and merge keys (which are refused) stay as PyYAML has them.
    yaml_implicit_resolvers = {
        first: [pair for pair in found if pair[0].endswith((":timestamp", ":merge"))]
        for first, found in yaml.CSafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        yaml.CSafeLoader.__init__(self, text)
        Composer.__init__(self)
        self._values = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event: Any = self.peek_event()
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not accepted", problem_mark=event.start_mark
            )
        self._values += 1
        if self._values > MOST_VALUES:
            raise TooManyValuesError(event.start_mark.line + 1)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.MarkedYAMLError(
                problem="a mapping was announced here", problem_mark=node.start_mark
            )
        keys: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                raise yaml.MarkedYAMLError(
                    problem=f"key {key!r} is not a string", problem_mark=key_node.start_mark
                )
            if key in keys:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key!r} stands twice", problem_mark=key_node.start_mark
                )
            keys.add(key)
        return super().construct_mapping(node, deep)

    def construct_whole(self, node: Any) -> int:
        """Return a whole number; one that is too long to be shown is refused."""
        text = self._matching(node, _WHOLE, "whole number")
        digits = text.lower().lstrip("+-")
        base = {"0o": 8, "0x": 16}.get(digits[:2], 10)
        if base == 10 and len(digits) <= _MOST_DIGITS:
            return int(text)
        if base != 10 and abs(value := int(digits[2:], base)) < _TOO_LARGE:
            return value
        raise yaml.MarkedYAMLError(
            problem=f"a whole number has more than {_MOST_DIGITS} digits",
            problem_mark=node.start_mark,
        )

    def construct_float(self, node: Any) -> float:
        """Return a number with a point, an exponent or both."""
        text = self._matching(node, _FLOAT, "number").lower()
        return float(text.replace(".inf", "inf").replace(".nan", "nan"))

    def construct_boolean(self, node: Any) -> bool:
        """Return the boolean of ``true`` or ``false``, in lower case, capitals or capitalised."""
        return self._matching(node, _BOOLEAN, "boolean").lower() == "true"

    def _matching(self, node: Any, form: re.Pattern[str], name: str) -> str:
        """Return the text of a scalar; refuse another form, which only an explicit tag leads to."""
        text = str(self.construct_scalar(node))
        if form.match(text):
            return text
        remedy = number_remedy(text)
        raise yaml.MarkedYAMLError(
            problem=f"{text[:40]!r} is no {name}" + (f": {remedy}" if remedy else ""),
            problem_mark=node.start_mark,
        )


for _tag, _form, _starts, _construct in (
    ("bool", _BOOLEAN, "tTfF", CoreLoader.construct_boolean),
    ("int", _WHOLE, "-+0123456789", CoreLoader.construct_whole),
    ("float", _FLOAT, "-+.0123456789", CoreLoader.construct_float),
    ("null", _NULL, ["~", "n", "N", ""], None),
):
    CoreLoader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", _form, list(_starts))
    if _construct is not None:
        CoreLoader.add_constructor(f"tag:yaml.org,2002:{_tag}", _construct)


def number_remedy(value: object) -> str | None:
    """Say what to write where a number is wanted and this stands; None: nothing is known."""
    if isinstance(value, bool):
        return "write a number; true and false are none"
    if not isinstance(value, str):
        return None
    text = value.strip()
    if zeros := _ZEROS.match(text):
        sign, rest = zeros.groups()
        return f"it has a leading zero: write {sign.replace('+', '')}{rest.replace('_', '')}"
    if _WHOLE.match(text) or _FLOAT.match(text):
        return f"it stands as text: write {text} without quotes"
    if ":" in text:
        return "write a decimal number, without a colon"
    if re.fullmatch(r"[-+]?[0-9_]+(\.[0-9_]*)?", text):
        return f"write {text.replace('_', '')}"
    if re.fullmatch(r"[-+]?[0-9.]*,[0-9.,]*", text):
        return "write a decimal point, and no comma"
    return "write a number"
