"""Files of other writers: without chunks, in any order, with types that nothing understands."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import pytest
from foreign_recordings import (
    INFO,
    TF,
    TYPES,
    TrackDay,
    camera_info,
    number_of,
    transform,
    write_bag,
)
from mcap.writer import Writer

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.reading.reader import BagReader, content_sha256
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_core.world.camera_messages import encode_frame
from ssp_eval.importers.ros_bag import SourceBag

OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")
CAMERA = ("--camera-info", "/info")
IMAGE = "/ssp/vut/front_camera/image/compressed"
OPTICAL = (-0.5, 0.5, -0.5, 0.5)
Kind = tuple[str, str, bytes, str]


def rewritten(bag: Path, target: Path, beside: Kind | None = None, **options: Any) -> Path:
    """The same messages as another program writes them, with a topic of a strange kind."""
    with BagReader(bag) as reader, target.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2")
        channels = {}
        for topic in reader.topics:
            written = reader.definition(topic)
            schema = writer.register_schema(written.msgtype, written.encoding, written.data)
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        if beside is not None:
            name, encoding, text, message_encoding = beside
            strange = writer.register_schema(name, encoding, text)
            channel = writer.register_channel("/vendor", message_encoding, strange)
            writer.add_message(channel, reader.start_ns or 0, b"{}", 0, 1)
        for m in reader.messages():
            writer.add_message(
                channels[m.topic], m.log_time_ns, m.data, m.publish_time_ns, m.sequence
            )
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    return target


def run(bag: Path, out: Path, *options: object) -> int:
    common = ("--domain", "physical", "--end", "4", "--out", out)
    return main(["import-bag", str(bag), *OBJECTS, *map(str, (*options, *common))])


def recorded(out: Path) -> list[BagMessage]:
    with BagReader(out) as reader:
        return list(reader.messages())


@pytest.fixture(scope="module")
def source(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The track day with a camera's place, and a CameraInfo 2 s after the first frame."""
    ns = day.zero_ns
    place = TYPES.types[TF](
        transforms=[transform("base_link", "camera_optical", (1, 0, 1), OPTICAL)]
    )
    more = [("/info", INFO, ns + 2 * 10**9, camera_info(ns, 32.0)), ("/tf_static", TF, ns, place)]
    return write_bag(tmp_path_factory.mktemp("foreign") / "day", [*day.messages(), *more])


@pytest.mark.parametrize("options", [CAMERA, (*CAMERA, "--mount", "1,0,1,0"), ()])
def test_a_file_without_chunks_gives_the_same_bytes(
    source: Path, tmp_path: Path, options: tuple[str, ...]
) -> None:
    chunked = rewritten(source, tmp_path / "chunked.mcap")
    plain = rewritten(source, tmp_path / "plain.mcap", use_chunking=False)
    assert run(chunked, tmp_path / "one", *options) == 0
    assert run(plain, tmp_path / "other", *options) == 0
    found = recorded(tmp_path / "other")
    assert found == recorded(tmp_path / "one")
    with BagReader(tmp_path / "other") as reader:
        frames = [(peek_stamp_ns(m.data), reader.decode(m)) for m in reader.messages([IMAGE])]
    assert len(frames) == 41
    for k, (stamp_ns, frame) in enumerate(frames):
        assert number_of(cv2.imdecode(frame.data, cv2.IMREAD_COLOR)) == k
        assert stamp_ns == frames[0][0] + k * 10**8


def test_messages_out_of_order_in_a_file_without_chunks_are_put_in_order(
    source: Path, tmp_path: Path
) -> None:
    plain = tmp_path / "plain.mcap"
    with BagReader(source) as reader, plain.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        for topic in reversed(reader.topics):  # topic by topic
            written = reader.definition(topic)
            schema = writer.register_schema(written.msgtype, written.encoding, written.data)
            channel = writer.register_channel(topic, "cdr", schema)
            for m in reader.messages([topic]):
                writer.add_message(channel, m.log_time_ns, m.data, m.publish_time_ns, m.sequence)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    assert run(source, tmp_path / "one", *CAMERA) == 0
    assert run(plain, tmp_path / "other", *CAMERA) == 0
    assert recorded(tmp_path / "other") == recorded(tmp_path / "one")


STRANGE: dict[str, Kind] = {
    "JSON": ("vendor.Lateral", "jsonschema", b"{}", "json"),
    "protobuf": ("vendor.Lateral", "protobuf", b"\n\xff", "protobuf"),
    "nonsense": ("vendor_msgs/msg/Lateral", "ros2msg", b"= =", "cdr"),
}


@pytest.mark.parametrize("kind", STRANGE)
def test_a_topic_that_is_not_wanted_and_cannot_be_read_is_listed(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    strange = rewritten(source, tmp_path / "strange.mcap", STRANGE[kind])
    assert run(strange, tmp_path / "out", *CAMERA) == 0
    assert "/vendor: can't be read and isn't needed" in capsys.readouterr().err
    assert run(source, tmp_path / "same", *CAMERA) == 0
    assert recorded(tmp_path / "out") == recorded(tmp_path / "same")


def test_a_topic_that_is_asked_for_and_cannot_be_read_is_refused_without_a_wrong_remedy(
    source: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    nonsense: Kind = ("nav_msgs/msg/Odometry", "ros2msg", b"= =", "cdr")
    strange = rewritten(source, tmp_path / "strange.mcap", nonsense)
    wanted = ("--vut", "/vendor", *OBJECTS[2:], "--domain", "physical", "--out", tmp_path / "out")
    said = refused("import-bag", strange, *wanted)
    assert "nav_msgs/msg/Odometry: has a definition that can't be used" in said
    assert "recover" not in said


def test_a_bag_of_sqlite_is_read_whatever_types_stand_beside(
    day: TrackDay, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bag also holds a type that rosbag2 didn't find, and JSON of another program."""
    source = write_bag(tmp_path / "day", day.messages(), sqlite=True)
    assert run(source, tmp_path / "same") == 0
    (file,) = source.glob("*.db3")
    with closing(sqlite3.connect(file)) as store, store:
        for number, name, form in ((90, "/odd", "cdr"), (91, "/vendor", "json")):
            kind = f"{name[1:]}_msgs/msg/Thing"
            store.execute(
                "INSERT INTO topics (id, name, type, serialization_format, offered_qos_profiles, "
                "type_description_hash) VALUES (?, ?, ?, ?, '', '')",
                (number, name, kind, form),
            )
            store.execute(
                "INSERT INTO message_definitions (topic_type, encoding, "
                "encoded_message_definition, type_description_hash) VALUES (?, 'unknown', '', '')",
                (kind,),
            )
    capsys.readouterr()
    assert run(source, tmp_path / "out") == 0
    said = capsys.readouterr().err
    assert "/odd: can't be read and isn't needed" in said
    assert "/vendor: can't be read and isn't needed" in said
    assert recorded(tmp_path / "out") == recorded(tmp_path / "same")


def change_rows(bag: Path, *changes: str) -> None:
    """Change the rows of a bag whose tables allow any value, as those of other writers do."""
    (file,) = bag.glob("*.db3")
    with closing(sqlite3.connect(file)) as store, store:
        for table in ("topics", "messages", "message_definitions"):
            store.execute(f"ALTER TABLE {table} RENAME TO strict_{table}")
            store.execute(f"CREATE TABLE {table} AS SELECT * FROM strict_{table}")
        for change in changes:
            store.execute(change)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("UPDATE messages SET data = NULL", "messages whose time or data is none"),
        ("UPDATE messages SET data = 'text'", "messages whose time or data is none"),
        ("UPDATE messages SET timestamp = -5 WHERE id = 1", "holds 1 messages whose time or data"),
        ("UPDATE messages SET timestamp = 'late' WHERE id = 1", "holds 1 messages whose time"),
        ("UPDATE messages SET timestamp = 1.5 WHERE id = 1", "holds 1 messages whose time or data"),
        ("UPDATE topics SET name = x'2f61' WHERE id = 1", "topics, id 1: holds what isn't text"),
        ("UPDATE topics SET type = x'2f61'", "holds what isn't text"),
        (
            "UPDATE message_definitions SET encoded_message_definition = x'2f61'",
            "has a definition that isn't text",
        ),
    ],
)
def test_values_of_other_types_in_a_bag_of_sqlite_are_refused(
    change: str, text: str, day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    source = write_bag(tmp_path / "day", day.messages(), sqlite=True)
    change_rows(source, change)
    given = ("import-bag", source, *OBJECTS, "--domain", "physical", "--out", tmp_path / "out")
    assert text in refused(*given)


def test_nothing_for_profiles_and_definitions_in_a_bag_of_sqlite_is_read(
    day: TrackDay, tmp_path: Path
) -> None:
    source = write_bag(tmp_path / "day", day.messages(), sqlite=True)
    assert run(source, tmp_path / "same") == 0
    change_rows(
        source,
        "UPDATE topics SET offered_qos_profiles = NULL",
        "UPDATE message_definitions SET encoded_message_definition = NULL",
    )
    assert run(source, tmp_path / "out") == 0
    assert recorded(tmp_path / "out") == recorded(tmp_path / "same")


def test_a_bag_of_sqlite_that_nobody_closed_is_read_and_that_is_said(
    day: TrackDay, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A killed rosbag2 leaves such a bag: it writes metadata.yaml only at the end."""
    source = write_bag(tmp_path / "day", day.messages(), sqlite=True)
    assert run(source, tmp_path / "same") == 0
    (source / "metadata.yaml").unlink()
    capsys.readouterr()
    assert run(source, tmp_path / "out") == 0
    assert "there is no metadata.yaml: what the folder's files hold was read" in (
        capsys.readouterr().err
    )
    assert recorded(tmp_path / "out") == recorded(tmp_path / "same")
    assert main(["bag", "cut", str(source), "--start", "1", "-o", str(tmp_path / "cut")]) == 0


def test_the_hash_of_a_split_bag_is_that_of_the_files_that_are_read(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "day", name="day", split=Split(max_bytes=65536)) as writer:
        writer.add_topic("/cam", COMPRESSED_TYPE, offered_qos(1))
        for k in range(24):
            data = encode_frame(k, bytes([k]) * 40_000)
            writer.write("/cam", data, k, k, k + 1)
    assert len(list((tmp_path / "day").glob("*.mcap"))) > 11
    with BagReader(tmp_path / "day") as reader:
        digest = content_sha256(reader)
    (tmp_path / "day" / "stray.mcap").write_bytes(b"")
    with SourceBag(tmp_path / "day") as source:
        assert source.sha256() == digest


def test_the_hash_of_a_bag_of_sqlite_is_also_that_of_its_log(day: TrackDay, tmp_path: Path) -> None:
    source = write_bag(tmp_path / "day", day.messages(), sqlite=True)
    (file,) = source.glob("*.db3")
    with SourceBag(source) as bag:
        assert bag.sha256() == sha256_file(file)
    with closing(sqlite3.connect(file)) as store:
        store.execute("PRAGMA journal_mode=WAL")
        digest = sha256_file(file)
        store.execute("DELETE FROM messages WHERE id = 1")
        store.commit()
        with SourceBag(source) as bag:
            assert bag.sha256() != digest == sha256_file(file)


def test_a_topic_that_is_missing_may_stand_in_a_file_that_was_left_out(
    source: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    (source / "later.mcap").write_bytes(next(source.glob("*.mcap")).read_bytes())
    wanted = ("--vut", "/nobody", *OBJECTS[2:], "--domain", "physical", "--out", tmp_path / "out")
    said = refused("import-bag", source, *wanted)
    assert "/nobody: is no topic of this bag" in said
    assert "later.mcap isn't named by metadata.yaml and was left out" in said
