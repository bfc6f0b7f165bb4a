"""The layout of a message's dataclass on the wire: one annotation for each of its fields.

    speed_mps: Annotated[float | None, Wire(0x80, "i16", per_unit=100, none=-32768)]

says that the field is a part of item 0x80, has 16 bits with sign, counts hundredths of its unit,
and is None where the wire has -32768. Fields with the same value id follow each other in one item.
An item whose fields all have a default may be missing; it is left out where they all are None.
"""

from __future__ import annotations

import math
import struct
from dataclasses import MISSING, dataclass, fields
from itertools import groupby
from typing import Any, get_type_hints

from ssp_ot_controller.bodies.iso22133.framing import EVIDENCE_BYTES, Item, Reason, RejectedBytes

# struct's letters; 48 bits and texts are bytes for it.
_LETTERS = {
    "u8": "B",
    "u16": "H",
    "u32": "I",
    "i16": "h",
    "i32": "i",
    "i48": "6s",
    "f32": "f",
    "text": "64s",
}
_TEXT_BYTES = 64
_BITS_48 = 48
# What is told of one message at most.
MOST_ODD = 20
# Hundredths of a degree in a rad, and in a full turn.
PER_RAD = 18_000.0 / math.pi
TURN = 36_000


@dataclass(frozen=True, slots=True)
class Wire:
    """The place and form of one value in a payload.

    Args:
        value_id: of the item.
        code: u8, u16, u32, i16, i32, i48, f32; ``text`` for 64 bytes that end with zeros;
            ``bytes`` for any content, alone in its item; ``points`` for items of that value id
            that may come any number of times, each a dataclass of ``points``.
        per_unit: steps of the wire in one unit of the field, for a field that is a float.
        step: units of the field in one step of the wire, for a field that is an int.
        none: the wire's number for 'unavailable'; None: it has no such number.
        turns: the number is an angle that wraps around at a full turn.
    """

    value_id: int
    code: str
    per_unit: float | None = None
    step: int = 1
    none: int | None = None
    turns: bool = False
    points: type | None = None


@dataclass(frozen=True, slots=True)
class _Field:
    name: str
    wire: Wire
    optional: bool


@dataclass(frozen=True, slots=True)
class _Group:
    """One item: its fields, and how struct reads them (None for what struct doesn't know)."""

    value_id: int
    fields: tuple[_Field, ...]
    struct: struct.Struct | None

    @property
    def optional(self) -> bool:
        return all(field.optional for field in self.fields)


_LAYOUTS: dict[type, tuple[_Group, ...]] = {}


def _groups_of(cls: Any) -> tuple[_Group, ...]:
    """Return the items of a message in the order in which they are sent."""
    layout = _LAYOUTS.get(cls)
    if layout is not None:
        return layout
    hints = get_type_hints(cls, include_extras=True)
    laid: list[_Field] = []
    for field in fields(cls):
        wire = next(part for part in hints[field.name].__metadata__ if isinstance(part, Wire))
        laid.append(_Field(field.name, wire, field.default is not MISSING))
    groups = []
    for value_id, run in groupby(laid, key=lambda field: field.wire.value_id):
        parts = tuple(run)
        letters = [_LETTERS.get(field.wire.code) for field in parts]
        shape = struct.Struct("<" + "".join(map(str, letters))) if all(letters) else None
        groups.append(_Group(value_id, parts, shape))
    _LAYOUTS[cls] = tuple(groups)
    return _LAYOUTS[cls]


# -- values ---------------------------------------------------------------------------------------


def _to_wire(field: _Field, value: Any) -> Any:
    """Return a number or bytes for struct; raise ValueError for what the wire can't say."""
    wire = field.wire
    if wire.code == "text":
        return _text_bytes(field.name, value)
    if wire.code == "f32":
        return math.nan if value is None else _single(field.name, value)
    if value is None:
        if wire.none is None:
            raise ValueError(f"{field.name} has no value for 'unavailable'")
        raw = wire.none
    else:
        raw = _steps(field.name, wire, value)
        if raw == wire.none:
            raise ValueError(f"{field.name} {value} would be read as 'unavailable'")
    low, high = _range(wire.code)
    if not low <= raw <= high:
        raise ValueError(f"{field.name} {value} is outside of {wire.code}")
    return raw.to_bytes(6, "little", signed=True) if wire.code == "i48" else raw


def _steps(name: str, wire: Wire, value: float) -> int:
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value}")
    raw = int(value) // wire.step if wire.per_unit is None else round(value * wire.per_unit)
    return raw % TURN if wire.turns else raw


def _range(code: str) -> tuple[int, int]:
    bits = int(code[1:])
    return (-(1 << bits - 1), (1 << bits - 1) - 1) if code[0] == "i" else (0, (1 << bits) - 1)


def _text_bytes(name: str, text: str) -> bytes:
    data = text.encode()
    if len(data) >= _TEXT_BYTES or b"\0" in data:
        raise ValueError(f"{name} needs less than {_TEXT_BYTES} bytes and no zeros: {text!r}")
    return data


def _single(name: str, value: float) -> float:
    try:
        (single,) = struct.unpack("<f", struct.pack("<f", value))
    except OverflowError:
        single = math.inf
    if not math.isfinite(single):
        raise ValueError(f"{name} is {value}")
    return float(single)


def _tell(odd: list[str], text: str) -> None:
    if len(odd) < MOST_ODD:
        odd.append(text)


def _from_wire(field: _Field, raw: Any, odd: list[str]) -> Any:
    """Return the field's value; what isn't one is None, and reported."""
    wire = field.wire
    if wire.code == "text":
        return raw.split(b"\0", 1)[0].decode(errors="replace")
    if wire.code == "f32":
        if math.isinf(raw):
            _tell(odd, f"{field.name} is {raw}")
        return raw if math.isfinite(raw) else None
    if wire.code == "i48":
        raw = int.from_bytes(raw, "little", signed=True)
    if raw == wire.none:
        return None
    if wire.turns and not 0 <= raw <= TURN:
        _tell(odd, f"{field.name} states {raw / 100:g} degrees")
        return None
    if wire.per_unit is None:
        return raw * wire.step
    return (raw % TURN if wire.turns else raw) / wire.per_unit


# -- messages -------------------------------------------------------------------------------------


def items_to_send(message: object) -> list[Item]:
    """Return a message's items.

    Raises:
        ValueError: a value that the wire can't say.
    """
    items: list[Item] = []
    for group in _groups_of(type(message)):
        values = [getattr(message, field.name) for field in group.fields]
        if group.optional and all(value is None for value in values):
            continue
        first = group.fields[0].wire
        if first.points is not None:
            items += (item for point in values[0] for item in items_to_send(point))
        elif group.struct is None:
            items.append(Item(group.value_id, bytes(values[0])))
        else:
            raw = [_to_wire(f, v) for f, v in zip(group.fields, values, strict=True)]
            items.append(Item(group.value_id, group.struct.pack(*raw)))
    return items


def read_items(cls: type, items: tuple[Item, ...], odd: list[str]) -> Any | RejectedBytes:
    """Return a message of a class, or why its items are none.

    Args:
        cls: of the message.
        items: of the payload, in their order.
        odd: receives a sentence for each item that the message doesn't have and each value that is
            none, up to MOST_ODD sentences.
    """
    groups = {group.value_id: group for group in _groups_of(cls)}
    values: dict[str, Any] = {}
    for item in items:
        group = groups.get(item.value_id)
        if group is None:
            _tell(odd, f"has item 0x{item.value_id:04X}, which isn't known")
            continue
        problem = _read_item(group, item, values, odd)
        if problem is not None:
            evidence = item.content[:EVIDENCE_BYTES]
            return RejectedBytes(Reason.ITEM, f"item 0x{item.value_id:04X} {problem}", evidence)
    for group in groups.values():
        first = group.fields[0]
        if first.wire.points is not None:
            values[first.name] = tuple(values.get(first.name, ()))
        elif first.name not in values and not group.optional:
            return RejectedBytes(Reason.MISSING, f"item 0x{group.value_id:04X} is missing")
    return cls(**values)


def _read_item(group: _Group, item: Item, values: dict[str, Any], odd: list[str]) -> str | None:
    """Fill in the values of one item; return what is wrong with it, or None."""
    first = group.fields[0]
    if first.wire.points is not None:
        point = read_items(first.wire.points, (item,), odd)
        if isinstance(point, RejectedBytes):
            return point.text
        values.setdefault(first.name, []).append(point)
        return None
    if first.name in values:
        return "comes twice"
    if group.struct is None:
        values[first.name] = item.content
        return None
    if len(item.content) != group.struct.size:
        return f"has {len(item.content)} bytes, must have {group.struct.size}"
    raw = group.struct.unpack(item.content)
    for field, value in zip(group.fields, raw, strict=True):
        values[field.name] = _from_wire(field, value, odd)
    return None
