"""The bags of BagWriter in rosbags, mcap and mcap_ros2: they read them as our own reader does."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from ssp_core.bag.metadata import MANY_TOPICS, ROOT_KEY, bag_information, offered_qos
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from tests.support.bags.messages import text

STRING = "std_msgs/msg/String"
TOPICS = ("/a", "/b", "/c")
# Nothing, what is copied into the chunk, what is not, and more than a chunk's target.
SIZES = (0, 1, 400, 8192, 8193, 300_000, 1_200_000)


@pytest.fixture(scope="module")
def split_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three files of ten messages, the later two begin with the two newest maps."""
    path = tmp_path_factory.mktemp("split") / "run"
    with BagWriter(path, split=Split(max_s=1.0)) as writer:
        latched = offered_qos(2, transient_local=True)
        writer.add_topic("/map", STRING, latched, latched=True)
        writer.add_topic("/x", STRING, offered_qos(50))
        writer.attach("run.yaml", b"seed: 1\n", "application/yaml")
        for k in range(3):
            writer.write("/map", text(f"map {k}"), k, k + 100, k)
        for k in range(27):
            writer.write("/x", text(f"x {k}"), 10 + k * 100_000_000, k, k)
    return path


def by_mcap(path: Path) -> list[tuple[str, int, int, bytes, int]]:
    """Messages of a file as the mcap package reads them, with all it checks."""
    with path.open("rb") as stream:
        by_index = list(make_reader(stream, validate_crcs=True).iter_messages())
        stream.seek(0)
        # Only a pass through the whole file checks the CRC of the data.
        assert list(NonSeekingReader(stream, validate_crcs=True).iter_messages()) == by_index
    return [
        (channel.topic, message.log_time, message.publish_time, message.data, message.sequence)
        for _, channel, message in by_index
    ]


def by_rosbags(path: Path) -> list[tuple[str, int, bytes]]:
    with AnyReader([path]) as reader:
        return [(c.topic, stamp, bytes(data)) for c, stamp, data in reader.messages()]


def test_each_file_of_a_split_bag_is_complete_for_other_readers(split_bag: Path) -> None:
    files = sorted(split_bag.glob("*.mcap"))
    assert [file.name for file in files] == ["run_0.mcap", "run_1.mcap", "run_2.mcap"]
    for k, file in enumerate(files):
        messages = by_mcap(file)
        maps = [m for m in messages if m[0] == "/map"]
        assert [m[3] for m in maps] == [text(f"map {n}") for n in ((0, 1, 2) if k == 0 else (1, 2))]
        assert [m[2] for m in maps][-2:] == [101, 102]
        first_x = next(m for m in messages if m[0] == "/x")
        if k:
            # Repeated at the log time at which the file begins, before its first own message.
            assert [m[1] for m in maps] == [first_x[1]] * 2
            assert [m[0] for m in messages[:3]] == ["/map", "/map", "/x"]
        assert {t: s for t, s, *_ in map(decoded, ros2_messages(file))}.keys() == {"/map", "/x"}
        with BagReader(file) as reader:
            assert [tuple(m) for m in reader.messages()] == messages
            assert reader.count == len(messages)


def ros2_messages(path: Path) -> list[Any]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
        return list(reader.iter_decoded_messages())


def decoded(item: Any) -> tuple[str, str]:
    return item.channel.topic, item.decoded_message.data


def test_a_split_bag_reads_as_an_unsplit_one(split_bag: Path) -> None:
    with BagReader(split_bag) as reader:
        messages = list(reader.messages())
        assert [m.sequence for m in messages if m.topic == "/map"] == [0, 1, 2]
        assert [m.sequence for m in messages if m.topic == "/x"] == list(range(27))
        assert {name: info.count for name, info in reader.topics.items()} == {"/map": 3, "/x": 27}
        assert reader.attachments == ("run.yaml",)
        late = list(reader.messages(["/map", "/x"], 2_000_000_000))
        assert [m.sequence for m in late] == list(range(20, 27))


def test_rosbags_reads_a_split_bag_with_its_repeats(split_bag: Path) -> None:
    messages = by_rosbags(split_bag)
    assert [data for topic, _, data in messages if topic == "/x"] == [
        text(f"x {k}") for k in range(27)
    ]
    maps = [data for topic, _, data in messages if topic == "/map"]
    assert maps == [text(f"map {n}") for n in (0, 1, 2, 1, 2, 1, 2)]
    with AnyReader([split_bag]) as reader:
        assert reader.message_count == 34


messages = st.tuples(
    st.sampled_from(TOPICS),
    st.sampled_from(SIZES),
    st.integers(0, 40) | st.integers(0, 2**62),
    st.integers(0, 2**63),
    st.integers(0, 2**32 - 1),
)


@settings(max_examples=60, deadline=None)
@given(
    steps=st.lists(messages | st.just("flush"), max_size=25),
    split=st.none() | st.builds(Split, st.sampled_from([1024, 500_000]), st.just(1e9)),
)
def test_any_messages_read_back_the_same_by_every_reader(
    steps: list[Any], split: Split | None
) -> None:
    written = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        with BagWriter(path, split=split) as writer:
            for topic in TOPICS:
                writer.add_topic(topic, STRING)
            for number, step in enumerate(steps):
                if step == "flush":
                    writer.flush()
                    continue
                topic, size, log_ns, publish_ns, sequence = step
                data = bytes([number]) * size
                writer.write(topic, data, log_ns, publish_ns, sequence)
                written.append(BagMessage(topic, log_ns, publish_ns, data, sequence))
        assert writer.facts().count == writer.messages == len(written)
        expected = sorted(written, key=lambda m: m.log_time_ns)  # stable: equal times as written
        with BagReader(path) as reader:
            assert list(reader.messages()) == expected
            for topic in TOPICS:
                alone = [m for m in expected if m.topic == topic and 10 <= m.log_time_ns < 30]
                assert list(reader.messages([topic], 10, 30)) == alone
        by_file = [message for file in writer.files for message in by_mcap(file)]
        assert sorted(by_file) == sorted(map(tuple, expected))
        if split is None:
            assert by_file == list(map(tuple, expected))
        plain = sorted((m.topic, m.log_time_ns, m.data) for m in expected)
        assert sorted(by_rosbags(path)) == plain


def test_a_bag_of_very_many_topics_is_closed_and_opened_by_every_reader(tmp_path: Path) -> None:
    names = [f"/t{k}" for k in range(MANY_TOPICS)] + ["/über"]
    qos = offered_qos(5)
    with BagWriter(tmp_path / "bag") as writer:
        for name in names:
            writer.add_topic(name, STRING, qos)
            writer.write(name, text(name), 1, 1)
    with BagReader(tmp_path / "bag") as reader:
        assert [m.topic for m in reader.messages()] == names
        assert {info.offered_qos for info in reader.topics.values()} == {qos}
    assert sorted(topic for topic, _, _ in by_rosbags(tmp_path / "bag")) == sorted(names)
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())[ROOT_KEY]
    assert information == bag_information(writer.facts())


@pytest.mark.parametrize("split", [None, Split(max_s=1.0)], ids=["one file", "several"])
def test_others_read_packed_chunks_as_plain_ones(split: Split | None, tmp_path: Path) -> None:
    for name in ("plain", "packed"):
        path = tmp_path / name
        with BagWriter(path, name="run_0", split=split, packed=name == "packed") as writer:
            writer.add_topic("/x", STRING, offered_qos(50))
            for k, size in enumerate(SIZES * 2):
                writer.write("/x", text("x" * size), k * 300_000_000, k, k)
    plain, packed = (sorted((tmp_path / name).glob("*.mcap")) for name in ("plain", "packed"))
    assert len(packed) == len(plain) == (1 if split is None else 4)
    assert [by_mcap(file) for file in packed] == [by_mcap(file) for file in plain]
    assert by_rosbags(tmp_path / "packed") == by_rosbags(tmp_path / "plain")
    with BagReader(tmp_path / "packed") as ours, BagReader(tmp_path / "plain") as theirs:
        assert list(ours.messages()) == list(theirs.messages())
    sizes = [sum(file.stat().st_size for file in files) for files in (packed, plain)]
    assert 20 * sizes[0] < sizes[1]
