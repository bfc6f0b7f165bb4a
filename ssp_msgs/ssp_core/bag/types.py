"""Message types without ROS: Jazzy's own, ssp_msgs, those installed, and those that a bag defines.

A definition in a bag is held against limits before code is generated from it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Container, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from graphlib import CycleError, TopologicalSorter
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Constdefs, Fielddefs, Typesdict
from rosbags.serde import SerdeError
from rosbags.serde.utils import SIZEMAP
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore

from ssp_core.cdr.images import VIDEO_DEFINITION, VIDEO_TYPE
from ssp_core.errors import HostError, InputError


class BagMessage(NamedTuple):
    """One serialised message; log time is when it was received, publish time when it was sent."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes
    sequence: int = 0


# Autoware's and PX4's largest definitions, with all that they use, stay below a tenth of these.
MAX_TEXT_BYTES = 512 << 10
MAX_TYPES = 1000
MAX_MEMBERS = 4096
MAX_DEPTH = 32
# Items of arrays of messages and strings, which become a line of code each; all together.
MAX_UNROLLED = 4096
# Items of one array of numbers: a message of 1 GiB could hold no more.
MAX_ARRAY = 1 << 30
# Memory for the Python objects of one message.
MAX_DECODED_BYTES = 2 << 30

# CPython 3.11: an object with its dict of fields, a field's value, a string's head.
_OBJECT_BYTES = 152
_FIELD_BYTES = 40
_STRING_BYTES = 64
_LEAST_STRING_BYTES = 5

# The grammar's expressions take exponential time in nested brackets, and shifts and products make
# numbers of any size. No definition that ROS generates holds any of these.
_IDL_TOKEN = re.compile(
    r'//[^\n]*|/\*.*?(?:\*/|\Z)|"(?:\\.|[^"\\])*"|(?P<operator><<|\*)|(?P<open>[(\[{<])'
    r"|(?P<close>[)\]}>])",
    re.DOTALL,
)
_IDL_DEPTH = {"(": 1, "[": 1, "{": 8, "<": 2}
_OPENED = {")": "(", "]": "[", "}": "{", ">": "<"}
_NAME = re.compile(r"[A-Za-z]\w*(?:/[A-Za-z]\w*)+", re.ASCII)


def check_text(text: str, *, idl: bool) -> None:
    """Refuse a text that would take the parser unreasonably long.

    Raises:
        ValueError: it is too long, or holds expressions that no generated definition has.
    """
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > MAX_TEXT_BYTES:
        raise ValueError(f"{size} bytes of text, more than {MAX_TEXT_BYTES} are not read")
    if text.count("\n") > MAX_MEMBERS * 4:
        raise ValueError(f"more than {MAX_MEMBERS * 4} lines")
    if not idl:
        return
    depth = dict.fromkeys(_IDL_DEPTH, 0)
    for token in _IDL_TOKEN.finditer(text):
        if token["operator"]:
            raise ValueError(f"the operator {token['operator']} at character {token.start()}")
        if bracket := token["open"]:
            depth[bracket] += 1
            if depth[bracket] > _IDL_DEPTH[bracket]:
                raise ValueError(
                    f"brackets {bracket} nested deeper than {_IDL_DEPTH[bracket]} at character "
                    f"{token.start()}"
                )
        elif bracket := token["close"]:
            depth[_OPENED[bracket]] -= 1


def check_types(types: Mapping[str, Any]) -> None:
    """Refuse parsed types from which too much code would be made.

    Args:
        types: by name (constants, fields), as rosbags' parsers give them.

    Raises:
        ValueError: which type and field, and what is wrong there.
    """
    if len(types) > MAX_TYPES:
        raise ValueError(f"{len(types)} types, more than {MAX_TYPES} are not read")
    members = sum(len(constants) + len(fields) for constants, fields in types.values())
    if members > MAX_MEMBERS:
        raise ValueError(f"{members} fields and constants, more than {MAX_MEMBERS} are not read")
    unrolled = 0
    for name, (constants, fields) in types.items():
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name[:80]!r} is no name of a type")
        for constant, _, value in constants:
            if isinstance(value, list):
                raise ValueError(f"constant {name}.{constant} is a list")
            if isinstance(value, float) and not -1.8e308 < value < 1.8e308:
                raise ValueError(f"constant {name}.{constant} is no finite number")
        for field, (kind, rest) in fields:
            if kind != Nodetype.ARRAY:
                continue
            inner, count = rest
            if not 0 < count <= MAX_ARRAY:
                raise ValueError(f"{name}.{field} has {count} items (1 to {MAX_ARRAY} are right)")
            if _is_boxed(inner):
                unrolled += count
    if unrolled > MAX_UNROLLED:
        raise ValueError(
            f"arrays of {unrolled} messages and strings, more than {MAX_UNROLLED} are not read"
        )
    _check_depth(types)


def _is_boxed(inner: Any) -> bool:
    return bool(inner[0] == Nodetype.NAME or inner[1][0] == "string")


def _inner(kind: Any, rest: Any) -> Any:
    """Return the type of a field, or of each item of it."""
    return rest[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, rest)


def _field_types(fields: Iterable[tuple[str, Any]]) -> list[str]:
    """Return the message types that a type's fields name."""
    inner_types = (_inner(*described) for _, described in fields)
    return [str(inner[1]) for inner in inner_types if inner[0] == Nodetype.NAME]


def _check_depth(types: Mapping[str, Any]) -> None:
    """Raise ValueError where a type contains itself, or types nest deeper than MAX_DEPTH."""
    below = {
        name: [n for n in _field_types(fields) if n in types] for name, (_, fields) in types.items()
    }
    depths: dict[str, int] = {}
    try:
        for name in TopologicalSorter(below).static_order():
            depths[name] = 1 + max((depths[n] for n in below[name]), default=0)
            if depths[name] > MAX_DEPTH:
                raise ValueError(f"types nest deeper than {MAX_DEPTH} in {name}")
    except CycleError as error:
        raise ValueError(f"{error.args[1][0]} contains itself") from error


# Behind a count, which is aligned to 4, up to where numbers of 8 bytes would begin.
_PADDING = bytes(4)
_WIDE = frozenset({"int64", "uint64", "float64"})


class BoundedStore(Typestore):
    """A store that decodes no message whose objects could take more than MAX_DECODED_BYTES.

    A byte of a message can become an object of some hundred bytes: an array of empty messages
    takes one byte an item.
    """

    def __init__(self) -> None:
        super().__init__()
        self._growth: dict[str, float] = {}

    def deserialize_cdr(self, rawdata: bytes | memoryview, typename: str) -> object:
        """Deserialize as Typestore does.

        Bytes that rclpy writes behind a message are no part of it.

        Before the items of an empty sequence of 8-byte numbers at a message's end rclpy writes the
        padding that would align them.

        Raises:
            SerdeError: the bytes are no such message, or their objects could take too much memory.
        """
        growth = self._growth.get(typename)
        if growth is None:
            growth = self._growth[typename] = growth_of(self.fielddefs, typename)
        if len(rawdata) * growth > MAX_DECODED_BYTES:
            raise SerdeError(
                f"{len(rawdata)} bytes of small items could take "
                f"{len(rawdata) * growth / 2**30:.1f} GiB of memory once decoded "
                f"(at most {MAX_DECODED_BYTES >> 30} GiB are taken)"
            )
        try:
            return super().deserialize_cdr(rawdata, typename)
        except SerdeError:
            is_padded = bytes(rawdata[-len(_PADDING) :]) == _PADDING
            if not is_padded or not _ends_in_wide_numbers(self.fielddefs, typename):
                raise
            return super().deserialize_cdr(rawdata[: -len(_PADDING)], typename)


def _ends_in_wide_numbers(types: Mapping[str, Any], name: str) -> bool:
    """Tell whether a type's last field is a sequence of 8-byte numbers, be it in another's."""
    fields = types[name][1]
    if not fields:
        return False
    kind, rest = fields[-1][1]
    if kind == Nodetype.NAME:
        return _ends_in_wide_numbers(types, rest)
    return kind == Nodetype.SEQUENCE and rest[0][0] == Nodetype.BASE and rest[0][1][0] in _WIDE


def growth_of(types: Mapping[str, Any], msgtype: str) -> float:
    """Return the bytes of Python objects per byte of a message, at the worst."""

    @cache
    def least(name: str) -> tuple[int, int]:
        """Return the least bytes of a type in a message and as objects without sequences' items."""
        total, objects = 0, _OBJECT_BYTES
        for _, (kind, rest) in types[name][1]:
            objects += _FIELD_BYTES
            if kind == Nodetype.SEQUENCE:
                total += 4
                objects += _OBJECT_BYTES  # an empty list or array
                continue
            inner, count = rest if kind == Nodetype.ARRAY else ((kind, rest), 1)
            if inner[0] == Nodetype.NAME:
                size, more = least(inner[1])
            elif inner[1][0] == "string":
                size, more = _LEAST_STRING_BYTES, _STRING_BYTES
            else:
                size, more = SIZEMAP[inner[1][0]], 0 if kind == Nodetype.ARRAY else 32
            total += size * count
            objects += more * count
        return total, objects

    @cache
    def growth(name: str) -> float:
        fields = types[name][1]
        worst = max([1.0, *map(growth, _field_types(fields))])
        for _, (kind, rest) in fields:
            inner = _inner(kind, rest)
            if kind != Nodetype.SEQUENCE or not _is_boxed(inner):
                continue
            size, objects = _LEAST_STRING_BYTES, _STRING_BYTES
            if inner[0] == Nodetype.NAME:
                size, objects = least(inner[1])
            worst = max(worst, objects / max(1, size))
        return worst

    return growth(msgtype)


_MSGTYPE = re.compile(r"([A-Za-z][A-Za-z0-9_]*)/msg/([A-Za-z][A-Za-z0-9_]*)", re.ASCII)


def installed_file(msgtype: str) -> Path | None:
    """Return the .msg file of a type below AMENT_PREFIX_PATH; None when there is none.

    Args:
        msgtype: from anywhere; it is no path, whatever it says.
    """
    match = _MSGTYPE.fullmatch(msgtype)
    if match is None:
        return None
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix, "share", match[1], "msg", f"{match[2]}.msg")
        if prefix and path.is_file():
            return path
    return None


def installed_types(msgtype: str, known_types: Container[str]) -> Typesdict:
    """Return a type and all that it uses, read from their .msg files.

    Raises:
        InputError: the file of one isn't there, or is no definition.
    """
    types: Typesdict = {}
    left = [msgtype]
    while left:
        name = left.pop()
        if name in types or name in known_types:
            continue
        types[name] = _read(name)
        left += _field_types(types[name][1])
    return types


def _read(msgtype: str) -> tuple[Constdefs, Fielddefs]:
    path = installed_file(msgtype)
    if path is None:
        raise InputError(
            "is no known message type",
            field=msgtype,
            remedy="install its package and source it, so that AMENT_PREFIX_PATH names it",
        )
    try:
        types = get_types_from_msg(path.read_text("utf-8"), msgtype)
        return types[msgtype]
    except (OSError, ValueError, KeyError, RecursionError, TypesysError) as error:
        raise InputError(
            f"is no message definition: {error}",
            file=path,
            remedy="mend the file, or install its package again",
        ) from error


PACKAGE = "ssp_msgs"
CDR = "cdr"
MSG_ENCODING = "ros2msg"
IDL_ENCODING = "ros2idl"
_SEPARATOR = "=" * 80 + "\n"
_SHOWN = 200
_KEPT_STORES = 64
# What rosbags' parsers and the code that they generate raise on a text that is no definition.
_UNUSABLE = (
    TypesysError,
    LookupError,
    ValueError,
    TypeError,
    AttributeError,
    NameError,
    AssertionError,
    SyntaxError,
    OverflowError,
    MemoryError,
    RecursionError,
)


@dataclass(frozen=True, slots=True)
class TypeDefinition:
    """The bag's definition of one message type.

    Args:
        msgtype: full name, ``package/msg/Name``; empty: the bag names none.
        encoding: ``ros2msg`` or ``ros2idl``; others are kept as they are, and not understood.
        text: the definition followed by those of all types that it uses. Bytes that are no UTF-8
            stand in it as surrogates.
        type_hash: ``RIHS01_<hex>`` as ROS 2 computes it, empty when it is not known.
        message_encoding: of its messages; only CDR is decoded.
    """

    msgtype: str
    encoding: str
    text: str
    type_hash: str = ""
    message_encoding: str = CDR

    @staticmethod
    def of_bytes(
        msgtype: str, encoding: str, data: bytes, type_hash: str, message_encoding: str
    ) -> TypeDefinition:
        """Give the definition that a file holds, whatever its bytes are."""
        text = data.decode("utf-8", "surrogateescape")
        return TypeDefinition(msgtype, encoding, text, type_hash, message_encoding)

    @property
    def data(self) -> bytes:
        """The definition as it stands in a file."""
        return self.text.encode("utf-8", "surrogateescape")


def _folders() -> list[Traversable]:
    """List the folders that may hold .msg files.

    They are beside the sources, in the wheel, and in ROS prefixes.
    """
    folders: list[Traversable] = [Path(__file__).resolve().parents[2] / "msg"]
    with suppress(ModuleNotFoundError):  # only a pip installation has it
        folders.append(resources.files("ssp_core.interfaces"))
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders += [Path(prefix, "share", PACKAGE, "msg") for prefix in prefixes if prefix]
    return folders


@cache
def _own_texts() -> dict[str, str]:
    """Return the text of each .msg file of ssp_msgs, and of the video type, by full type name."""
    folders = _folders()
    for folder in folders:
        # Other packages have folders named msg too; ours holds this file.
        if folder.joinpath("ObjectState.msg").is_file():
            return {VIDEO_TYPE: VIDEO_DEFINITION} | {
                f"{PACKAGE}/msg/{entry.name.removesuffix('.msg')}": entry.read_text("utf-8")
                for entry in sorted(folder.iterdir(), key=lambda entry: entry.name)
                if entry.name.endswith(".msg")
            }
    raise HostError(
        f"the message definitions of {PACKAGE} were not found (looked in "
        f"{', '.join(str(folder) for folder in folders)}); install the project anew"
    )


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy and of ssp_msgs; one store, shared by all callers.

    Raises:
        HostError: the .msg files of ssp_msgs are not installed.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for msgtype, text in _own_texts().items():
        types.update(get_types_from_msg(text, msgtype))
    store.register(types)
    return store


@cache
def definition(msgtype: str) -> TypeDefinition:
    """Return the definition of a known type with all that it uses, comments of ssp_msgs kept.

    A type that is neither among Jazzy's common interfaces nor in ssp_msgs is looked for in what is
    installed, and is in the typestore afterwards.

    Raises:
        InputError: the type is nowhere.
    """
    store = typestore()
    if msgtype not in store.fielddefs:
        store.register(installed_types(msgtype, store.fielddefs))
    # A section is "MSG: package/Name\n<text>"; the first one has no such line.
    first, *rest = store.generate_msgdef(msgtype, ros_version=2)[0].split(_SEPARATOR)
    # Our own files stand in for what the store generates: their comments give the units.
    sections = [_own_texts().get(msgtype, first)]
    for section in rest:
        head, _, text = section.partition("\n")
        package, _, name = head.removeprefix("MSG: ").partition("/")
        own = _own_texts().get(f"{package}/msg/{name}", text)
        sections.append(f"{head}\n{own}")
    text = _SEPARATOR.join(sections)
    return TypeDefinition(msgtype, MSG_ENCODING, text, store.hash_rihs01(msgtype))


def serialize(message: object) -> bytes:
    """Return a message of typestore() as CDR: little endian, with four bytes of encapsulation.

    Args:
        message: made with ``typestore().types[msgtype](...)``.
    """
    msgtype = getattr(message, "__msgtype__", None)
    if not isinstance(msgtype, str):
        raise TypeError(f"{type(message).__name__} is no message of the typestore")
    return bytes(typestore().serialize_cdr(message, msgtype, little_endian=True))


def store_from(type_definition: TypeDefinition) -> Typestore:
    """Return a store that knows exactly the types of one definition, as it stands in a bag.

    A definition takes time in proportion to its length, so it is parsed once for all callers, even
    when it is of no use. Callers only read a store.

    Raises:
        InputError: the definition can't be parsed, asks for too much, or lacks the type that it is
            for.
    """
    store = _parsed(type_definition)
    if isinstance(store, InputError):
        raise store.in_file(None)
    return store


@lru_cache(maxsize=_KEPT_STORES)
def _parsed(type_definition: TypeDefinition) -> Typestore | InputError:
    store = BoundedStore()
    if type_definition.message_encoding != CDR:
        return InputError(
            "has messages in an encoding that isn't decoded",
            field=type_definition.msgtype or None,
            value=type_definition.message_encoding,
            remedy=f"{CDR} is decoded",
        )
    if not type_definition.text.strip() and type_definition.msgtype in typestore().fielddefs:
        # rosbag2 leaves out a definition that it doesn't find: what ROS itself defines is known.
        type_definition = definition(type_definition.msgtype)
    text = type_definition.text.replace("\r\n", "\n")
    try:
        check_text(text, idl=type_definition.encoding == IDL_ENCODING)
        if type_definition.encoding == MSG_ENCODING:
            types = get_types_from_msg(text, type_definition.msgtype)
        elif type_definition.encoding == IDL_ENCODING:
            types = _types_from_idl(text)
        else:
            return InputError(
                "has a definition in an unknown encoding",
                field=type_definition.msgtype,
                value=type_definition.encoding,
                remedy=f"{MSG_ENCODING} and {IDL_ENCODING} are understood",
            )
        check_types(types)
        store.register(types)
        store.get_msgdef(type_definition.msgtype)
    except _UNUSABLE as error:
        # rosbags' messages repeat the whole definition.
        why = str(error)
        for whole in (f"MSG: {type_definition.msgtype}\n{text}", text):
            why = why.replace(repr(whole), "")
        why = " ".join(why.split()) or type(error).__name__
        problem = f"has a definition that can't be used: {why[:_SHOWN]}"
        return InputError(
            problem,
            field=type_definition.msgtype,
            remedy="record the bag again, with the definitions of its types",
        )
    return store


# What the C preprocessor of an IDL compiler takes; a bag's definition brings what it includes.
_DIRECTIVE = re.compile(r"^[ \t]*#[^\n]*$", re.MULTILINE)


def _types_from_idl(text: str) -> Typesdict:
    """Parse a definition of one file, or of several behind ``IDL: package/msg/Name`` lines."""
    types: Typesdict = {}
    for section in text.split(_SEPARATOR):
        body = section.partition("\n")[2] if section.startswith("IDL: ") else section
        body = _DIRECTIVE.sub("", body)
        if body.strip():
            types.update(get_types_from_idl(body))
    return types
