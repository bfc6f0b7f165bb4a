"""Message types without ROS: Jazzy's own and ssp_msgs, read from the .msg files themselves."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore

from ssp_core.bag.definition_limits import BoundedStore, check_text, check_types
from ssp_core.bag.installed_types import installed_types
from ssp_core.bag.video_type import VIDEO_DEFINITION, VIDEO_TYPE
from ssp_core.errors import HostError, InputError

PACKAGE = "ssp_msgs"
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
    """What a bag says about one message type.

    Args:
        msgtype: full name, ``package/msg/Name``.
        encoding: ``ros2msg`` or ``ros2idl``.
        text: the definition followed by those of all types that it uses.
        type_hash: ``RIHS01_<hex>`` as ROS 2 computes it, empty when it is not known.
    """

    msgtype: str
    encoding: str
    text: str
    type_hash: str = ""


def _folders() -> list[Traversable]:
    """Where the .msg files may be: beside the sources, in the wheel, in ROS install prefixes."""
    folders: list[Traversable] = [Path(__file__).resolve().parents[2] / "msg"]
    with suppress(ModuleNotFoundError):  # only a pip installation has it
        folders.append(resources.files("ssp_core.interfaces"))
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    folders += [Path(prefix, "share", PACKAGE, "msg") for prefix in prefixes if prefix]
    return folders


@cache
def _own_texts() -> dict[str, str]:
    """Text of each .msg file of ssp_msgs, and of the video type, by full type name."""
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
    """The types of ROS 2 Jazzy and of ssp_msgs; one store, shared by all callers.

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
    """Definition of a known type with all that it uses, comments of ssp_msgs kept.

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
    """CDR (little endian, with its four bytes of encapsulation) of a message of typestore().

    Args:
        message: made with ``typestore().types[msgtype](...)``.
    """
    msgtype = getattr(message, "__msgtype__", None)
    if not isinstance(msgtype, str):
        raise TypeError(f"{type(message).__name__} is no message of the typestore")
    return bytes(typestore().serialize_cdr(message, msgtype, little_endian=True))


@lru_cache(maxsize=_KEPT_STORES)
def store_from(written: TypeDefinition) -> Typestore:
    """A store that knows exactly the types of one definition, as it stands in a bag.

    Bags of one recorder share their definitions, and so the stores: whoever has one only reads it.

    Raises:
        InputError: the definition can't be parsed, asks for too much, or lacks the type that it is
            for.
    """
    store = BoundedStore()
    try:
        check_text(written.text, idl=written.encoding == IDL_ENCODING)
        if written.encoding == MSG_ENCODING:
            types = get_types_from_msg(written.text, written.msgtype)
        elif written.encoding == IDL_ENCODING:
            types = get_types_from_idl(written.text)
        else:
            raise InputError(
                "has a definition in an unknown encoding",
                field=written.msgtype,
                value=written.encoding,
                remedy=f"{MSG_ENCODING} and {IDL_ENCODING} are understood",
            )
        check_types(types)
        store.register(types)
        store.get_msgdef(written.msgtype)
    except _UNUSABLE as error:
        # rosbags' messages repeat the whole definition.
        text = str(error)
        for whole in (f"MSG: {written.msgtype}\n{written.text}", written.text):
            text = text.replace(repr(whole), "")
        text = " ".join(text.split()) or type(error).__name__
        raise InputError(
            f"has a definition that can't be used: {text[:_SHOWN]}", field=written.msgtype
        ) from error
    return store
