"""The seal of a bag: edits of each kind are named, and what was cut off is sealed up to there."""

from __future__ import annotations

import json
import random
import shutil
import struct
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.mcap_file import FOOTER, HEAD, RecordFrame, open_bounded, read_frame
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.append import append_attachment, sealed_end
from ssp_core.bag.seals.seal import Seal, files_seal, read_seal
from ssp_core.bag.seals.verdict import UNBOUND, check_verdict, leave_verdict
from ssp_core.bag.writing import mcap_output
from ssp_core.bag.writing.chain import LARGE_BYTES, Maker
from ssp_core.bag.writing.mcap_output import Buffer, write_buffers
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from ssp_core.vocabulary import Verdict
from tests.support.bags.seals import with_checksums

S = 10**9
CHUNKS = 6


def text(words: str) -> bytes:
    data = words.encode() + b"\0"
    return b"\0\1\0\0" + len(data).to_bytes(4, "little") + data


def write(
    path: Path,
    split: Split | None = None,
    *,
    large: bool = False,
    name: str | None = None,
    packed: bool = False,
) -> Path:
    """A bag of six chunks with three messages each."""
    maker = Maker.RECORDER
    with BagWriter(path, split=split, maker=maker, name=name, packed=packed) as writer:
        writer.attach("run.yaml", b"run", "application/yaml")
        writer.add_topic("/text", "std_msgs/msg/String")
        for chunk in range(CHUNKS):
            for number in range(3):
                at_ns = chunk * S + number
                words = "x" * (LARGE_BYTES + 9) if large and number == 2 else f"{chunk} {number}"
                writer.write("/text", text(words), at_ns, at_ns, 1)
            writer.flush()
    return path


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write(tmp_path / "bag")


@pytest.fixture
def parts(tmp_path: Path) -> Path:
    return write(tmp_path / "parts", Split(max_s=1.5))


def test_a_kill_between_any_two_writes_leaves_what_fits_its_seal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, taken = tmp_path / "bag", []

    def write_and_keep(descriptor: int, buffers: Sequence[Buffer]) -> None:
        write_buffers(descriptor, buffers)
        taken.append(shutil.copytree(bag, tmp_path / f"after_{len(taken)}"))

    monkeypatch.setattr(mcap_output, "write_buffers", write_and_keep)
    write(bag, Split(max_s=1.5))
    seals = [files_seal(sorted(one.glob("*.mcap")), whole=True) for one in taken]
    assert [seal.text for seal in seals if not seal.is_sound] == []
    assert [bool(seal.open_at) for seal in seals] == [True] * (len(seals) - 1) + [False]
    assert {seal.open_at for seal in seals} > {
        f"the end of the file before bag_{n}.mcap" for n in (1, 2)
    }


def seal_of(path: Path) -> Seal:
    with BagReader(path) as reader:
        return read_seal(reader)


def frames(file: Path) -> Iterator[RecordFrame]:
    """The records of a closed or cut file up to the end of its data."""
    with open_bounded(file) as stream:
        offset = 8
        while True:
            try:
                frame = read_frame(stream, offset)
            except ValueError:
                return
            yield frame
            if frame.opcode == Opcode.DATA_END:
                return
            offset = frame.end


def chunks(file: Path) -> list[RecordFrame]:
    return [frame for frame in frames(file) if frame.opcode == Opcode.CHUNK]


def file_of(bag: Path) -> Path:
    return next(iter(sorted(bag.glob("*.mcap"))))


def test_what_was_written_fits_its_seal(bag: Path, parts: Path) -> None:
    whole, split = seal_of(bag), seal_of(parts)
    assert (whole.text, whole.chunks) == (
        f"sealed by the recorder, {CHUNKS} chunks, end {whole.end[:16]}",
        CHUNKS,
    )
    assert len(split.ends) == len(list(parts.glob("*.mcap"))) == 3
    assert whole.end == sealed_end(bag)
    assert split.end == sealed_end(parts)
    report = check_bag(bag)
    assert report.ok
    assert report.seal == whole.text


def test_the_seal_is_that_of_the_bytes(tmp_path: Path, bag: Path) -> None:
    again = write(tmp_path / "again", name="bag_0")
    assert seal_of(again).end == seal_of(bag).end
    assert file_of(again).read_bytes() == file_of(bag).read_bytes()


def test_others_read_a_sealed_bag(bag: Path, parts: Path) -> None:
    leave_verdict(bag, Verdict.VALID, [], "runner")
    for folder in (bag, parts):
        with Reader(folder) as reader:
            assert sum(1 for _ in reader.messages()) == 3 * CHUNKS
        read = 0
        for file in folder.glob("*.mcap"):
            with file.open("rb") as stream:
                reader_ = make_reader(stream, validate_crcs=True)
                read += len(list(reader_.iter_messages()))
                names = {record.name for record in reader_.iter_metadata()}
                assert names == {"rosbag2", "ssp.seal"}
        assert read == 3 * CHUNKS


def a_byte(data: bytearray, file: Path) -> str:
    data[chunks(file)[3].end - 5] ^= 1
    return "chunk 4 of bag_0.mcap"


def a_state(data: bytearray, file: Path) -> str:
    place = data.index(b"2 1\0")
    data[place] = ord("7")
    return "chunk 3 of bag_0.mcap"


def swapped(data: bytearray, file: Path) -> str:
    one, other = chunks(file)[1:3]
    first, second = bytes(data[one.offset : one.end]), bytes(data[other.offset : other.end])
    assert len(first) == len(second)
    data[one.offset : one.end], data[other.offset : other.end] = second, first
    return "chunk 2 of bag_0.mcap"


def swapped_with_seals(data: bytearray, file: Path) -> str:
    all_of_them = list(frames(file))
    begins = [a.offset for a, b in pairwise(all_of_them) if b.opcode == Opcode.CHUNK]
    one, other, behind = begins[1:4]
    data[one:behind] = data[other:behind] + data[one:other]
    return "chunk 3 of bag_0.mcap stands where chunk 2"


def an_attachment(data: bytearray, file: Path) -> str:
    del file
    place = data.index(b"\x03\0\0\0\0\0\0\0run")
    data[place + 8 : place + 11] = b"fun"
    return "chunk 1 of bag_0.mcap"


def a_topic_in_the_summary(data: bytearray, file: Path) -> str:
    del file
    place = data.rindex(b"/text")
    data[place : place + 5] = b"/tex2"
    return "the summary of bag_0.mcap"


def a_seal(data: bytearray, file: Path) -> str:
    del file
    place = data.index(b"00000005")
    data[place : place + 8] = b"00000006"
    return "chunk 6 of bag_0.mcap stands where chunk 5"


def the_end(data: bytearray, file: Path) -> str:
    del file
    place = data.rindex(b"digest") + 10
    data[place : place + 4] = b"0000"
    return "behind chunk 6 of bag_0.mcap"


EDITS = (
    a_byte,
    a_state,
    swapped,
    swapped_with_seals,
    an_attachment,
    a_topic_in_the_summary,
    a_seal,
    the_end,
)


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_is_named(bag: Path, edit: Callable[[bytearray, Path], str]) -> None:
    file = file_of(bag)
    data = bytearray(file.read_bytes())
    place = edit(data, file)
    file.write_bytes(with_checksums(data))
    found = files_seal([file], whole=False)
    assert found.altered.startswith(place), found
    assert any(place in problem for problem in check_bag(bag).problems)


def test_a_byte_without_checksums_is_damage(bag: Path) -> None:
    file = file_of(bag)
    data = bytearray(file.read_bytes())
    place = a_byte(data, file)
    file.write_bytes(data)
    assert seal_of(bag).damaged.startswith(place)


def test_a_message_that_is_taken_out_is_named(bag: Path) -> None:
    file = file_of(bag)
    with BagReader(bag) as reader:
        assert sum(m.log_time_ns == 2 * S + 1 for m in reader.messages()) == 1
    data, old = file.read_bytes(), chunks(file)[2]
    chunk = data[old.offset : old.end]
    begin = chunk.index(b"2 1\0") - 31 - 8
    record = HEAD.size + HEAD.unpack_from(chunk, begin)[1]
    content = chunk[49:begin] + chunk[begin + record :]
    head = bytearray(chunk[:49])
    struct.pack_into("<Q", head, 1, 40 + len(content))
    struct.pack_into("<Q", head, 25, len(content))
    struct.pack_into("<I", head, 33, crc32(content))
    struct.pack_into("<Q", head, 41, len(content))
    edited = bytearray(data[: old.offset] + head + content + data[old.end :])
    file.write_bytes(with_checksums(edited))
    assert files_seal([file], whole=False).altered == "chunk 3 of bag_0.mcap"


def test_a_chunk_that_is_taken_out_is_named(bag: Path) -> None:
    file = file_of(bag)
    data, all_of_them = file.read_bytes(), list(frames(file))
    begins = [a.offset for a, b in pairwise(all_of_them) if b.opcode == Opcode.CHUNK]
    file.write_bytes(with_checksums(bytearray(data[: begins[2]] + data[begins[3] :])))
    assert "chunk 3 of bag_0.mcap is missing" in files_seal([file], whole=False).altered


@pytest.mark.parametrize("removed", [0, 1, 2])
def test_a_file_that_is_missing_is_named(parts: Path, removed: int) -> None:
    files = sorted(parts.glob("*.mcap"))
    left = [file for number, file in enumerate(files) if number != removed]
    found = files_seal(left, whole=True)
    place = "the file behind" if removed == 2 else "goes on from"
    assert place in found.altered
    files[removed].unlink()
    assert not check_bag(parts).ok


def test_a_file_of_another_bag_is_named(parts: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "other", split=Split(max_s=1.5)) as writer:
        writer.add_topic("/text", "std_msgs/msg/String")
        for number in range(CHUNKS):
            writer.write("/text", text("other"), number * S, number * S, 1)
    shutil.copy(tmp_path / "other" / "other_1.mcap", parts / "parts_1.mcap")
    assert seal_of(parts).altered == "parts_1.mcap goes on from another file"


def test_one_file_of_several_can_be_checked(parts: Path) -> None:
    for file in parts.glob("*.mcap"):
        assert files_seal([file], whole=False).is_sound


def test_a_cut_file_is_sealed_up_to_its_last_whole_chunk(bag: Path, tmp_path: Path) -> None:
    file = file_of(bag)
    data, found = file.read_bytes(), chunks(file)
    cut = tmp_path / "cut.mcap"
    for number, chunk in enumerate(found):
        for at, whole in (
            (chunk.offset, number),
            (chunk.offset + 60, number),
            (chunk.end - 1, number),
            (chunk.end, number + 1),
            (chunk.end + 7, number + 1),
        ):
            cut.write_bytes(data[:at])
            seal = files_seal([cut], whole=False)
            assert (seal.chunks, seal.is_sound) == (whole, True), (number, at)
            assert f"up to chunk {whole} of cut.mcap, where it ends unclosed" in seal.text
    assert any("was not closed" in problem for problem in check_bag(cut).problems)
    assert "up to chunk 6" in check_bag(cut).seal


def test_a_recovered_bag_says_how_far_its_source_was_sealed(bag: Path, tmp_path: Path) -> None:
    file = file_of(bag)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: chunks(file)[4].offset + 3])
    report = recover(cut, tmp_path / "new")
    assert report.seal == (
        "sealed by the recorder up to chunk 4 of cut.mcap, where it ends unclosed"
    )
    seal = seal_of(tmp_path / "new")
    assert (seal.maker, seal.sources[0].state) == ("recover", report.seal)
    assert check_bag(tmp_path / "new").ok


def test_an_edit_is_not_washed_off(bag: Path, tmp_path: Path) -> None:
    """Neither a cut nor a recovery gives an altered bag a seal that hides it."""
    file = file_of(bag)
    data = bytearray(file.read_bytes())
    a_state(data, file)
    file.write_bytes(with_checksums(data))
    with pytest.raises(InputError, match=r"altered since it was sealed: chunk 3 of bag_0"):
        cut_bag(bag, tmp_path / "cut", ["/text"])
    assert not (tmp_path / "cut").exists()
    recover(bag, tmp_path / "new")
    assert any("altered" in problem for problem in check_bag(tmp_path / "new").problems)


def test_a_cut_names_its_parents(bag: Path, tmp_path: Path) -> None:
    leave_verdict(bag, Verdict.VALID, [], "runner")
    cut_bag(bag, tmp_path / "one", ["/text"], S, 3 * S)
    cut_bag(tmp_path / "one", tmp_path / "two", ["/text"], S, 2 * S)
    parent, seal = seal_of(bag), seal_of(tmp_path / "two")
    assert (seal.maker, seal.sources[1].name) == ("cut", "bag")
    assert seal.sources[1].ends == parent.ends
    assert seal.sources[1].state == parent.text
    assert check_bag(tmp_path / "two").ok
    with BagReader(tmp_path / "two") as reader:
        assert check_verdict(reader, seal, tmp_path / "two") == ""


def test_large_messages_are_in_the_seal(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", large=True)
    file = file_of(bag)
    assert seal_of(bag).chunks == CHUNKS
    data = bytearray(file.read_bytes())
    data[chunks(file)[1].end - 9] ^= 1
    file.write_bytes(with_checksums(data))
    assert files_seal([file], whole=False).altered == "chunk 2 of bag_0.mcap"


def noise(size: int) -> str:
    """Text that packs badly."""
    return random.Random(1).randbytes(size).hex()


@pytest.mark.parametrize("split", [None, Split(max_s=1.5)], ids=["one file", "several"])
def test_packed_chunks_are_sealed_as_they_are_stored(split: Split | None, tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", split, packed=True)
    seal = seal_of(bag)
    assert (seal.is_sound, seal.chunks, seal.end) == (True, CHUNKS, sealed_end(bag))
    end = leave_verdict(bag, Verdict.VALID, [], "runner")
    assert (seal_of(bag).is_sound, seal_of(bag).end) == (True, end)
    assert check_bag(bag).ok
    again = write(tmp_path / "again", split, name="bag_0", packed=True)
    assert seal_of(again).ends == seal.ends


def test_a_large_packed_message_is_sealed_whole(tmp_path: Path) -> None:
    path = tmp_path / "bag"
    with BagWriter(path, packed=True) as writer:
        writer.add_topic("/text", "std_msgs/msg/String")
        writer.write("/text", text(noise(2 * LARGE_BYTES)), 1, 1)
    (file,) = path.glob("*.mcap")
    assert seal_of(path).is_sound
    (chunk,) = chunks(file)
    assert chunk.length > LARGE_BYTES
    data = bytearray(file.read_bytes())
    data[chunk.offset + chunk.length // 2] ^= 1
    file.write_bytes(data)
    assert not seal_of(path).is_sound


def test_a_bag_of_others_is_not_sealed(bag: Path) -> None:
    file = file_of(bag)
    with file.open("rb") as stream:
        messages = list(make_reader(stream).iter_messages())
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", schema)
        for _, _, message in messages:
            writer.add_message(channel, message.log_time, message.data, message.publish_time)
        writer.finish()
    assert seal_of(bag).text == "not sealed"
    assert check_bag(bag).ok
    with pytest.raises(InputError, match="isn't sealed"):
        append_attachment(bag, "a", b"a", "text/plain")


@pytest.mark.parametrize(
    ("report", "missing"), [(b'{"sealed": true}', True), (b"{}", False), (b"no report", False)]
)
def test_a_seal_that_was_taken_out_is_missed(bag: Path, report: bytes, missing: bool) -> None:
    """Recordings of before the seal have a report that doesn't speak of one."""
    file = file_of(bag)
    with file.open("rb") as stream:
        messages = list(make_reader(stream).iter_messages())
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "another")
        writer.add_attachment(0, 0, "recording.json", "application/json", report)
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/text", "cdr", schema)
        for _, _, message in messages:
            writer.add_message(channel, message.log_time, message.data, message.publish_time)
        writer.finish()
    (bag / "verdict.json").write_text(
        '{"schema": "ssp.verdict/1", "verdict": "valid", "reasons": []}'
    )
    assert seal_of(bag).altered.startswith("its seal is missing") == missing
    assert check_bag(bag).ok != missing
    made = recover(bag, bag.parent / "made")
    assert made.seal.startswith("altered") == missing


# -- the verdict -----------------------------------------------------------------------------------


def verdict_of(bag: Path) -> str:
    with BagReader(bag) as reader:
        return check_verdict(reader, read_seal(reader), bag)


def test_a_verdict_is_in_the_bag_and_beside_it(bag: Path) -> None:
    before = sealed_end(bag)
    leave_verdict(bag, Verdict.VALID, [], "monitor")
    end = leave_verdict(bag, Verdict.OFF_SPEC, ["too late"], "runner")
    with BagReader(bag) as reader:
        assert reader.attachment("verdict.json") == (bag / "verdict.json").read_bytes()
        assert [m.log_time_ns for m in reader.messages()][-1] == 5 * S + 2
    seal = seal_of(bag)
    assert (len(seal.ends), seal.ends[0], seal.end) == (3, before, end)
    assert json.loads((bag / "verdict.json").read_text())["seal"] == seal.ends[1]
    assert check_bag(bag).ok
    assert verdict_of(bag) == ""


def test_a_verdict_that_was_edited_is_named(bag: Path) -> None:
    leave_verdict(bag, Verdict.OFF_SPEC, ["too late"], "runner")
    file = bag / "verdict.json"
    file.write_text(file.read_text().replace("off_spec", "valid").replace('"too late"', ""))
    with pytest.raises(
        InputError, match="says valid; the verdict in the bag is off_spec: too late"
    ):
        verdict_of(bag)
    assert any("off_spec" in problem for problem in check_bag(bag).problems)


def test_a_verdict_that_was_edited_in_the_bag_is_named(bag: Path) -> None:
    leave_verdict(bag, Verdict.OFF_SPEC, ["too late"], "runner")
    file = file_of(bag)
    data = bytearray(file.read_bytes())
    place = data.index(b"off_spec")
    data[place : place + 8] = b"valid   "
    file.write_bytes(with_checksums(data))
    assert seal_of(bag).altered == "behind chunk 6 of bag_0.mcap, between it and the closing seal"


def test_a_verdict_of_another_bag_is_named(bag: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    with BagWriter(other) as writer:
        writer.add_topic("/text", "std_msgs/msg/String")
    leave_verdict(other, Verdict.VALID, [], "runner")
    shutil.copy(other / "verdict.json", bag)
    with pytest.raises(InputError, match="is of another recording"):
        verdict_of(bag)


def leave_result(folder: Path, **values: object) -> None:
    value = {"schema": "ssp.result/1", "bag": folder.name, **values}
    (folder.parent / "result.json").write_text(json.dumps(value))


def test_the_result_of_a_run_is_held_against_its_bag(bag: Path) -> None:
    end = leave_verdict(bag, Verdict.OFF_SPEC, ["too late"], "runner")
    leave_result(bag, seal=end, verdict="off_spec")
    assert verdict_of(bag) == ""
    assert check_bag(bag).ok
    leave_result(bag, seal=end, verdict="valid")
    with pytest.raises(InputError, match=r"verdict: says another verdict than its bag, off_spec"):
        verdict_of(bag)
    # The bag is sealed anew, with a verdict that is its own.
    leave_result(bag, seal=end, verdict="off_spec")
    leave_verdict(bag, Verdict.OFF_SPEC, [], "runner")
    with pytest.raises(InputError, match=r"result.json: seal: names another seal than its bag"):
        verdict_of(bag)
    assert any("another seal" in problem for problem in check_bag(bag).problems)


@pytest.mark.parametrize("values", [{"bag": "other"}, {"schema": "mine/1"}, {"seal": None}])
def test_a_result_that_is_not_of_the_bag_says_nothing(bag: Path, values: dict[str, object]) -> None:
    leave_verdict(bag, Verdict.VALID, [], "runner")
    leave_result(bag, **{"seal": "00" * 32, **values})
    assert verdict_of(bag) == ""
    (bag.parent / "result.json").write_text("no JSON")
    assert verdict_of(bag) == ""


def test_a_verdict_beside_a_bag_alone_is_said(bag: Path) -> None:
    (bag / "verdict.json").write_text(
        '{"schema": "ssp.verdict/1", "verdict": "valid", "reasons": []}'
    )
    assert verdict_of(bag) == UNBOUND
    assert UNBOUND in check_bag(bag).remarks


def test_nobody_calls_valid_what_was_not_closed(bag: Path, tmp_path: Path) -> None:
    """Its verdict was cut off, and another one is put beside what was recovered."""
    leave_verdict(bag, Verdict.INVALID_HARNESS, ["front_camera died"], "runner")
    file = file_of(bag)
    last = chunks(file)[-1]
    file.write_bytes(file.read_bytes()[: last.end])
    made = tmp_path / "made"
    recover(bag, made)
    told = {"schema": "ssp.verdict/1", "verdict": "aborted", "reasons": ["a lost link"]}
    (made / "verdict.json").write_text(json.dumps(told))
    assert verdict_of(made) == UNBOUND
    (made / "verdict.json").write_text(json.dumps({**told, "verdict": "valid", "reasons": []}))
    with pytest.raises(InputError, match="ends unclosed: no runner calls such a recording valid"):
        verdict_of(made)


def test_a_full_disk_leaves_the_bag_as_it_was(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int, offset: int, length: int) -> None:
        del descriptor, offset, length
        raise OSError(28, "No space left on device")

    data = file_of(bag).read_bytes()
    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(Exception, match="No space left"):
        leave_verdict(bag, Verdict.VALID, [], "runner")
    assert file_of(bag).read_bytes() == data
    assert (bag / "verdict.json").is_file()


def test_the_footer_finds_the_summary(bag: Path) -> None:
    """A summary that stands elsewhere than behind the data isn't the sealed one."""
    file = file_of(bag)
    data = bytearray(file.read_bytes())
    footer_at = len(data) - 8 - FOOTER.size
    start = struct.unpack_from("<Q", data, footer_at + 9)[0]
    summary = bytes(data[start:footer_at]).replace(b"/text", b"/tex2")
    footer = data[footer_at:]
    struct.pack_into("<Q", footer, 9, footer_at)
    struct.pack_into("<Q", footer, 17, 0)
    struct.pack_into("<I", footer, 25, crc32(summary + bytes(footer[:25])))
    file.write_bytes(bytes(data[:footer_at]) + summary + bytes(footer))
    assert files_seal([file], whole=False).altered == "the summary of bag_0.mcap"
