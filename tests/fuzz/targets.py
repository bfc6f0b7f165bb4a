"""What is fuzzed: functions of bytes that raise nothing but what their reader documents."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import answers
import extraction
import seeds
from rosbags.serde import SerdeError

from ssp_core.bag.check import check_bag
from ssp_core.bag.cut import cut_bag
from ssp_core.bag.mcap_file import DAMAGE
from ssp_core.bag.metadata import offered_qos, parse_offered_qos, read_metadata
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.types import TypeDefinition, definition, store_from, typestore
from ssp_core.cdr.messages import leading_stamp_ns, peek_stamp_ns
from ssp_core.cdr.references import decode_ack, decode_reference
from ssp_core.cdr.states import decode_state, decode_states, find_state
from ssp_core.cdr.steps import (
    decode_command,
    decode_commands,
    decode_done,
    decode_heartbeat,
    decode_tick,
    decode_tick_head,
)
from ssp_core.errors import InputError
from ssp_core.files import load_model
from ssp_core.run_file.faults import load_faults
from ssp_core.run_file.model import RunSpec
from ssp_monitor.bag_tools.info import summarise_bag

_MESSAGES = 300  # of a bag; a short file may repeat a message often, but not without end
# In memory where there is such a folder: a target writes a file for each input.
_FOLDER = "/dev/shm" if Path("/dev/shm").is_dir() else None


@dataclass(frozen=True, slots=True)
class Target:
    """One target.

    Args:
        run: takes the input; an exception is a finding.
        seeds: makes the inputs to begin with.
        most_bytes: of an input.
    """

    run: Callable[[bytes], None]
    seeds: Callable[[], Iterator[bytes]]
    most_bytes: int


@contextmanager
def _scratch() -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix="ssp_fuzz_", dir=_FOLDER))
    try:
        yield folder
    finally:
        shutil.rmtree(folder)


def read_bag(data: bytes) -> None:
    """Opens a file, reads messages in order and by topic, decodes them, reads attachments."""
    with _scratch() as folder:
        path = folder / "a.mcap"
        path.write_bytes(data)
        try:
            with BagReader(path) as reader:
                _ = reader.count, reader.start_ns, reader.end_ns
                before = 0
                for message in islice(reader.messages(), _MESSAGES):
                    if message.log_time_ns < before:
                        raise AssertionError("messages out of order")
                    before = message.log_time_ns
                    try:
                        reader.decode(message)
                    except InputError:
                        continue
                for topic in reader.topics:
                    for _ in islice(reader.messages([topic], before // 2), _MESSAGES):
                        pass
                for name in reader.attachments[:10]:
                    reader.attachment(name)
        except InputError:
            return


def check(data: bytes) -> None:
    """Checks a file; what is wrong is in the report."""
    with _scratch() as folder:
        (folder / "a.mcap").write_bytes(data)
        check_bag(folder / "a.mcap")


def recover_bag(data: bytes) -> None:
    """Recovers a file; the new bag is sound but for messages that can't be decoded."""
    with _scratch() as folder:
        (folder / "a.mcap").write_bytes(data)
        try:
            report = recover(folder / "a.mcap", folder / "new")
        except InputError:
            if (folder / "new").exists():
                raise AssertionError("half a bag was left") from None
            return
        with BagReader(folder / "new") as reader:
            if reader.count != report.count:
                raise AssertionError(f"{reader.count} messages in a bag of {report.count}")
        _sound(folder / "new")
        if sorted(p.name for p in folder.iterdir()) != ["a.mcap", "new"]:
            raise AssertionError("files beside the new bag")


def _sound(bag: Path) -> None:
    """Raises AssertionError for a bag of ours with more than messages that can't be decoded."""
    for problem in check_bag(bag).problems:
        if not any(known in problem for known in (" that is no ", "can't be ", "encoding")):
            raise AssertionError(problem)


def info(data: bytes) -> None:
    """Says what stands in a file."""
    with _scratch() as folder:
        (folder / "a.mcap").write_bytes(data)
        try:
            summarise_bag(folder / "a.mcap")
        except InputError:
            return


def cut(data: bytes) -> None:
    """Cuts the middle out of a file; the new bag is sound but for what can't be decoded."""
    with _scratch() as folder:
        path = folder / "a.mcap"
        path.write_bytes(data)
        try:
            with BagReader(path) as reader:
                topics = list(reader.topics)
                start_ns, end_ns = reader.start_ns or 0, reader.end_ns or 0
            cut_bag(path, folder / "new", topics, start_ns + 1, max(start_ns + 1, end_ns))
        except InputError:
            if (folder / "new").exists():
                raise AssertionError("half a bag was left") from None
            return
        _sound(folder / "new")


def metadata(data: bytes) -> None:
    with _scratch() as folder:
        (folder / "a.mcap").write_bytes(b"")
        (folder / "metadata.yaml").write_bytes(data)
        try:
            files = read_metadata(folder).files
        except InputError:
            return
        if any(file.parent != folder for file in files):
            raise AssertionError(f"files elsewhere: {files}")


def qos(data: bytes) -> None:
    try:
        parse_offered_qos(data.decode("utf-8", "replace"))
    except ValueError:
        return


DECODERS: tuple[Callable[[bytes], object], ...] = (
    decode_state,
    decode_states,
    decode_tick,
    decode_tick_head,
    decode_command,
    decode_commands,
    decode_done,
    decode_heartbeat,
    decode_reference,
    decode_ack,
    leading_stamp_ns,
    peek_stamp_ns,
    lambda data: find_state(data, "ot1"),
)


def wire(data: bytes) -> None:
    """The hand-written codecs, chosen by the first byte."""
    if not data:
        return
    try:
        DECODERS[data[0] % len(DECODERS)](data[1:])
    except ValueError:
        return


def types(data: bytes) -> None:
    """A definition, and a message of that type out of the same bytes."""
    encoding = "ros2idl" if data[:1] and data[0] & 1 else "ros2msg"
    text = data[1:].decode("utf-8", "replace")
    try:
        store = store_from(TypeDefinition("a/msg/B", encoding, text))
        store.deserialize_cdr(b"\0\1\0\0" + data[:200], "a/msg/B")
    except (InputError, SerdeError, *DAMAGE):
        return


_CDR_TYPES = (
    "ssp_msgs/msg/ObjectStates",
    "ssp_msgs/msg/Reference",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/CompressedImage",
    "diagnostic_msgs/msg/DiagnosticArray",
    "tf2_msgs/msg/TFMessage",
    "std_msgs/msg/Float64MultiArray",
)
_STORES = [store_from(definition(t)) for t in _CDR_TYPES if t in typestore().fielddefs]


def cdr(data: bytes) -> None:
    """Messages of usual types by rosbags, as BagReader.decode asks for it."""
    if not data:
        return
    place = data[0] % len(_STORES)
    try:
        _STORES[place].deserialize_cdr(data[1:], _CDR_TYPES[place])
    except (SerdeError, *DAMAGE):
        return


def run_file(data: bytes) -> None:
    with _scratch() as folder:
        path = folder / "a.yaml"
        path.write_bytes(data)
        for load in (load_faults, lambda p: load_model(RunSpec, p)):
            try:
                load(path)
            except InputError:
                continue


def _qos_texts() -> Iterator[bytes]:
    yield offered_qos(5).encode()
    yield offered_qos(1, transient_local=True).encode()


TARGETS = {
    "read": Target(read_bag, seeds.bags, 8192),
    "check": Target(check, seeds.bags, 8192),
    "recover": Target(recover_bag, seeds.bags, 8192),
    "info": Target(info, seeds.bags, 8192),
    "cut": Target(cut, seeds.bags, 8192),
    "metadata": Target(metadata, seeds.metadata_texts, 4096),
    "qos": Target(qos, _qos_texts, 2048),
    "wire": Target(wire, seeds.wire_messages, 1024),
    "types": Target(types, seeds.definitions, 4096),
    "cdr": Target(cdr, seeds.wire_messages, 1024),
    "run": Target(run_file, seeds.run_texts, 2048),
    "answer": Target(answers.answer, answers.texts, 4096),
    "response": Target(answers.response, answers.stored, 4096),
    "extract": Target(extraction.text, extraction.texts, 2048),
    "reply": Target(extraction.reply, extraction.replies, 2048),
}
