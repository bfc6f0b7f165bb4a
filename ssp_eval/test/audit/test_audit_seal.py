"""A recording is judged as it was sealed: an edited bag or verdict is refused by name."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.append import append_attachment
from ssp_core.bag.seals.seal import read_seal
from ssp_core.bag.seals.verdict import UNBOUND, leave_verdict
from ssp_core.errors import InputError
from ssp_core.vocabulary import Verdict
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.labels.truth import read_source
from tests.support.bags.seals import with_checksums


@pytest.fixture
def bag(make_bag: Callable[..., Path]) -> Path:
    return make_bag("run/bag", duration_s=1.0)


def test_the_seal_and_the_verdict_are_disclosed(bag: Path) -> None:
    with BagReader(bag) as reader:
        before = read_seal(reader).text
    assert read_recording(bag).provenance.seal == f"{before}; {UNBOUND}"
    leave_verdict(bag, Verdict.VALID, [], "runner")
    told = read_recording(bag).provenance
    assert told.seal.startswith("sealed by its writer")
    assert UNBOUND not in told.seal
    assert told.refusal is None


@pytest.mark.parametrize("read", [read_recording, read_source])
def test_a_verdict_made_valid_is_refused(bag: Path, read: Callable[[Path], object]) -> None:
    """The runner alone knew of it: the session's own last word is valid."""
    leave_verdict(bag, Verdict.INVALID_HARNESS, ["front_camera died"], "runner")
    assert "front_camera died" in str(read_recording(bag).provenance.refusal)
    file = bag / "verdict.json"
    text = file.read_text().replace("invalid_harness", "valid").replace('"front_camera died"', "")
    file.write_text(text)
    with pytest.raises(InputError, match="in the bag is invalid_harness: front_camera died"):
        read(bag)


@pytest.mark.parametrize("read", [read_recording, read_source])
def test_a_byte_of_a_frame_is_refused(bag: Path, read: Callable[[Path], object]) -> None:
    file = next(bag.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    data[data.index(b"\xff\xd8\xff") + 20] ^= 1
    file.write_bytes(data)
    with pytest.raises(InputError, match=f"is damaged: chunk 1 of {file.name}: crc"):
        read(bag)
    file.write_bytes(with_checksums(data))
    with pytest.raises(InputError, match=f"altered since it was sealed: chunk 1 of {file.name}"):
        read(bag)


def test_a_verdict_without_its_seal_is_refused(bag: Path, make_bag: Callable[..., Path]) -> None:
    leave_verdict(bag, Verdict.VALID, [], "runner")
    other = make_bag("other/bag", duration_s=2.0)
    (other / "verdict.json").write_bytes((bag / "verdict.json").read_bytes())
    with pytest.raises(InputError, match="is of another recording"):
        read_recording(other)


def test_a_session_of_which_nothing_tells_what_it_lacks_is_refused(
    bag: Path, tmp_path: Path
) -> None:
    """A recovered bag is taken if it still has the recorder's report of what the original held."""
    append_attachment(bag, "recording.json", b'{"topics": []}', "application/json")
    leave_verdict(bag, Verdict.VALID, [], "runner")
    file = next(bag.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    data[data.index(b"\xff\xd8\xff") + 20] ^= 1
    file.write_bytes(data)
    recover(bag, tmp_path / "with")
    assert "damaged: chunk 1" in read_recording(tmp_path / "with").provenance.seal
    data[data.index(b'{"topics": []}') + 3] ^= 1
    file.write_bytes(data)
    recover(bag, tmp_path / "without")
    with pytest.raises(InputError, match=r"has no recording\.json: which part"):
        read_recording(tmp_path / "without")


def test_a_session_without_seal_and_without_its_recorders_report_is_refused(bag: Path) -> None:
    file = next(bag.glob("*.mcap"))
    data = file.read_bytes()
    file.write_bytes(_without_metadata(data))
    with pytest.raises(InputError, match=r"neither seal nor recording\.json"):
        read_recording(bag)


def _without_metadata(data: bytes) -> bytes:
    """The same messages and attachments in a file that a foreign tool would write."""
    out = io.BytesIO()
    writer = Writer(out)
    writer.start("ros2", "another")
    reader = make_reader(io.BytesIO(data))
    for found in reader.iter_attachments():
        writer.add_attachment(0, 0, found.name, found.media_type, found.data)
    channels: dict[int, int] = {}
    for schema, channel, message in reader.iter_messages():
        if schema is not None and channel.id not in channels:
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(
                channel.topic, channel.message_encoding, number, dict(channel.metadata)
            )
        writer.add_message(
            channels[channel.id], message.log_time, message.data, message.publish_time
        )
    writer.finish()
    return out.getvalue()
