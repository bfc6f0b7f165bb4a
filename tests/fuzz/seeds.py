"""Inputs to begin with: small bags of our writer, of mcap's and of rosbags', messages, texts."""

from __future__ import annotations

import io
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.split import Split
from ssp_core.bag.types import TypeDefinition, definition, serialize, store_from, typestore
from ssp_core.bag.writer import BagWriter
from ssp_core.cdr.references import Acknowledgement, encode_ack
from ssp_core.cdr.states import StateArray, encode_state, encode_states
from ssp_core.cdr.steps import (
    BodyCommand,
    BodyCommands,
    Heartbeat,
    SessionPhase,
    StepDone,
    WorldTick,
    encode_commands,
    encode_done,
    encode_heartbeat,
    encode_tick,
)
from ssp_core.motion.state import ObjectState, Size
from ssp_core.vocabulary import ObjectClass, Role

STATES = "ssp_msgs/msg/ObjectStates"
# A short one, so that changes hit more than definitions.
ITEMS = TypeDefinition(
    "a/msg/Items",
    "ros2msg",
    "uint8[] bytes\nItem[] items\n" + "=" * 80 + "\nMSG: a/Item\nstring name\nfloat64[3] x\n",
)
STRING = "std_msgs/msg/String"
STATE = ObjectState(
    object_id="ot1",
    object_class=ObjectClass(1),
    role=Role(1),
    stamp_ns=5,
    x_m=1.0,
    y_m=2.0,
    yaw_rad=0.5,
    speed_mps=3.0,
    acceleration_mps2=0.0,
    yaw_rate_radps=0.0,
    size=Size(2.0, 2.0, 1.8, 1.5),
)


def text_message(text: str) -> bytes:
    return serialize(typestore().types[STRING](data=text))


def fill(writer: BagWriter) -> None:
    """Two topics, one of them latched, and an attachment in the midst."""
    writer.add_topic("/map", STRING, offered_qos(1, transient_local=True), latched=True)
    writer.add_topic("/items", ITEMS.msgtype, offered_qos(5), written=ITEMS)
    store = store_from(ITEMS)
    item = store.types["a/msg/Item"](name="one", x=np.zeros(3))
    items = store.types[ITEMS.msgtype](bytes=np.arange(5, dtype=np.uint8), items=[item, item])
    message = bytes(store.serialize_cdr(items, ITEMS.msgtype))
    writer.write("/map", text_message("here"), 0, 0, 1)
    for k in range(1, 9):
        writer.write("/items", message, k * 10**9, k * 10**9 - 7, k)
        if k % 3 == 0:
            writer.flush()
        if k == 4:
            writer.attach("run.yaml", b"seed: 1\n", "application/yaml")


def own_bag() -> bytes:
    """A file of our writer."""
    with tempfile.TemporaryDirectory() as folder:
        with BagWriter(Path(folder, "bag")) as writer:
            fill(writer)
        return writer.file.read_bytes()


def own_later_file() -> bytes:
    """The second file of a split bag, which begins with repeated messages."""
    with tempfile.TemporaryDirectory() as folder:
        with BagWriter(Path(folder, "bag"), split=Split(max_s=3.0)) as writer:
            fill(writer)
        return writer.files[1].read_bytes()


def mcap_bag(compression: CompressionType, *, chunked: bool = True, crcs: bool = False) -> bytes:
    """A file of mcap's writer, without CRCs so that a change reaches what lies behind them."""
    stream = io.BytesIO()
    writer = Writer(
        stream,
        chunk_size=200,
        compression=compression,
        use_chunking=chunked,
        enable_crcs=crcs,
        enable_data_crcs=crcs,
    )
    writer.start("ros2", "seed")
    known = definition(STRING)
    schema = writer.register_schema(STRING, known.encoding, known.text.encode())
    channel = writer.register_channel("/text", "cdr", schema, {"offered_qos_profiles": ""})
    for k in range(12):
        writer.add_message(channel, k, text_message("text " * k), k, k)
    writer.add_attachment(1, 1, "a.txt", "text/plain", b"attached")
    writer.finish()
    return stream.getvalue()


def rosbags_bag() -> bytes:
    """A file of rosbags' writer."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection("/text", STRING, typestore=typestore())
            for k in range(5):
                writer.write(connection, k, text_message("text"))
        return next(path.glob("*.mcap")).read_bytes()


def without_crcs(data: bytes) -> bytes:
    """The file with every CRC 0, which means that there is none."""
    changed = bytearray(data)
    at = 8
    while at + 9 <= len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, at)
        end = at + 9 + length
        if opcode == Opcode.CHUNK:
            changed[at + 33 : at + 37] = bytes(4)
        elif opcode in (Opcode.DATA_END, Opcode.FOOTER, Opcode.ATTACHMENT):
            changed[end - 4 : end] = bytes(4)
        at = end
    return bytes(changed)


def bags() -> Iterator[bytes]:
    """Files in all forms, first with their CRCs."""
    for data in (own_bag(), own_later_file(), rosbags_bag()):
        yield data
        yield without_crcs(data)
        yield without_crcs(data)[: len(data) // 2]
    for compression in CompressionType:
        yield mcap_bag(compression)
    yield mcap_bag(CompressionType.NONE, chunked=False)
    yield mcap_bag(CompressionType.ZSTD, crcs=True)


def metadata_texts() -> Iterator[bytes]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        with BagWriter(path) as writer:
            fill(writer)
        yield (path / "metadata.yaml").read_bytes()
    yield b"rosbag2_bagfile_information:\n  storage_identifier: mcap\n"


def definitions() -> Iterator[bytes]:
    """A byte for the encoding (its low bit: IDL), then the text."""
    for msgtype in (STRING, STATES, "geometry_msgs/msg/TwistWithCovarianceStamped"):
        yield b"\0" + definition(msgtype).text.encode()
    yield b"\0float64 X=1.5\nstring<=5 S='a'\nuint8[<=4] a\nbool[3] b true\n"
    yield (
        b"\1module a { module msg { module B_Constants { const long X = 3; }; typedef double T[3];"
        b'struct B { @verbatim (language="comment", text="x") double x; sequence<octet, 4> y; '
        b"T z; string<3> s; }; }; };"
    )


def wire_messages() -> Iterator[bytes]:
    """A byte for the decoder, then the message; every decoder gets every message."""
    messages = [
        encode_state(STATE),
        encode_states(StateArray(5, "ot", (STATE,))),
        encode_tick(WorldTick(5, 1, True, True, 2, 3, (STATE,))),
        encode_commands(BodyCommands(5, "ot", 1, (BodyCommand("ot1", 1, 0.5, 0.0, 0.1, False),))),
        encode_done(StepDone("ot", 3)),
        encode_heartbeat(Heartbeat(5, "m", 1, 6, SessionPhase(0), {"ot1": 7})),
        encode_ack(Acknowledgement(5, "r1", "ot1", True)),
        text_message("text"),
    ]
    for number in range(16):
        for message in messages:
            yield bytes([number]) + message


def run_texts() -> Iterator[bytes]:
    yield b"schema: ssp.faults/1\nfaults:\n  - {kind: kill, target: ot1, at_s: 6}\n"
    yield b"{schema: ssp.run/1, id: r, road: {}, vut: {id: vut}, targets: [], end: {}}\n"
