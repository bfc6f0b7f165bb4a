"""The limits of a summary and of what chunks may unpack to, at their edges."""

from __future__ import annotations

import pytest
from mcap.records import AttachmentIndex, ChunkIndex, Message, Schema
from mcap.summary import Summary

from ssp_core.bag import mcap_file
from ssp_core.bag import mcap_file as bounds
from ssp_core.bag.mcap_file import (
    ANY_TOTAL_BYTES,
    MAX_ATTACHMENT_BYTES,
    MAX_CHUNK_BYTES,
    MAX_CHUNK_RECORDS,
    MAX_RATIO,
    MAX_SCHEMAS_BYTES,
    UnpackBudget,
    check_summary,
)
from ssp_core.bag.mcap_output import record_bytes

DATA_END = 1 << 40


def index(offset: int, unpacked: int, index_bytes: int = 0) -> ChunkIndex:
    packed = -(-unpacked // MAX_RATIO)
    return ChunkIndex(packed + 41, offset, "zstd", packed, 0, index_bytes, {}, 0, unpacked)


def summary(*chunks: ChunkIndex) -> Summary:
    made = Summary()
    made.chunk_indexes += chunks
    return made


def test_what_all_chunks_unpack_to_is_bounded_by_the_file() -> None:
    chunks = [index(8 + (k << 30), MAX_CHUNK_BYTES) for k in range(5)]
    check_summary(summary(*chunks[:4]), DATA_END, 0)
    with pytest.raises(ValueError, match=f"unpack to more than {ANY_TOTAL_BYTES} bytes"):
        check_summary(summary(*chunks), DATA_END, 0)
    check_summary(summary(*chunks), DATA_END, 1 + (1 << 30) // MAX_RATIO)


def test_unpacking_again_ends() -> None:
    budget = UnpackBudget(10, ratio=2)
    budget.take(ANY_TOTAL_BYTES + 20)
    with pytest.raises(ValueError, match="unpack to more than"):
        budget.take(1)


def test_an_index_of_messages_belongs_to_one_chunk() -> None:
    one = index(8, 1000, index_bytes=100)
    check_summary(summary(one, index(8 + one.chunk_length + 100, 1000)), DATA_END, 0)
    with pytest.raises(ValueError, match="two chunk indexes for the bytes from"):
        check_summary(summary(one, index(8 + one.chunk_length + 99, 1000)), DATA_END, 0)


def test_a_chunk_has_no_more_messages_than_can_be_put_in_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    check_summary(summary(index(8, 1000, 16 * MAX_CHUNK_RECORDS)), DATA_END, 0)
    with pytest.raises(ValueError, match=f"more than {MAX_CHUNK_RECORDS} messages"):
        check_summary(summary(index(8, 1000, 16 * MAX_CHUNK_RECORDS + 1)), DATA_END, 0)
    monkeypatch.setattr(mcap_file, "MAX_CHUNK_RECORDS", 5)
    content = record_bytes(Message(1, 0, b"", 0, 0))
    assert len(list(mcap_file.inner_records(memoryview(content * 5)))) == 5
    with pytest.raises(ValueError, match="a chunk of more than 5 records"):
        list(mcap_file.inner_records(memoryview(content * 6)))


@pytest.mark.parametrize("length", [MAX_ATTACHMENT_BYTES, MAX_ATTACHMENT_BYTES + 1])
def test_an_attachment_is_read_as_a_whole(length: int) -> None:
    made = summary()
    made.attachment_indexes.append(AttachmentIndex(8, length, 0, 0, length, "video", "a/b"))
    if length <= MAX_ATTACHMENT_BYTES:
        check_summary(made, DATA_END, 0)
        return
    with pytest.raises(ValueError, match="attachment 'video' has"):
        check_summary(made, DATA_END, 0)


def test_definitions_are_bounded_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MAX_SCHEMAS_BYTES", 10)
    made = summary()
    made.schemas |= {k: Schema(k, b"12345", "ros2msg", "a/msg/B") for k in (1, 2)}
    check_summary(made, DATA_END, 0)
    made.schemas[3] = Schema(3, b"1", "ros2msg", "a/msg/C")
    with pytest.raises(ValueError, match="11 bytes of message definitions, more than 10"):
        check_summary(made, DATA_END, 0)
    assert MAX_SCHEMAS_BYTES > 4e6  # 200 types of 20 kB
