"""Static transforms of several publishers: none is lost in a cut, a later file or a recovery."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.latched import LatchedMessage, StaticTransforms, is_static, late_joiner
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.world.transforms import (
    TF_TYPE,
    Transform,
    decode_transforms,
    encode_transforms,
)
from tests.support.bags.messages import STRING, text

LEVEL = (0.0, 0.0, 0.0, 1.0)
QOS = {
    "depth 1": offered_qos(1, transient_local=True),
    "none": "",
    "untold": "- {durability: transient_local, history: 3, depth: 0}",
    "volatile": offered_qos(1),
    "no QoS at all": "{",
}
S = 10**9


def transform(child: str, x_m: float = 1.0, parent: str = "base_link") -> Transform:
    return Transform(parent, child, 5, (x_m, 0.0, 0.0), LEVEL)


THREE = [transform("mast"), transform("camera", 2.0, "mast"), transform("lidar", 3.0)]


def cdr(*transforms: Transform) -> bytes:
    return encode_transforms(transforms)


def record(path: Path, qos: str, split: Split | None = None, topic: str = "/tf_static") -> None:
    """Three publishers of one transform each, then six seconds of something else."""
    offered = "" if qos == "{" else qos
    with BagWriter(path, split=split) as writer:
        writer.add_topic(topic, TF_TYPE, offered)
        writer.add_topic("/text", STRING)
        for k, one in enumerate(THREE):
            writer.write(topic, cdr(one), k, k, k)
        for k in range(6):
            writer.write("/text", text(str(k)), k * S, k * S)


def frames(bag: Path, topic: str = "/tf_static") -> list[list[str]]:
    """The child frames of each message."""
    with BagReader(bag) as reader:
        return [[t.child for t in decode_transforms(m.data)] for m in reader.messages([topic])]


@pytest.mark.parametrize("topic", ["/tf_static", "/robot/tf_static"])
@pytest.mark.parametrize("qos", QOS.values(), ids=QOS)
def test_a_cut_begins_with_the_transforms_of_all_publishers(
    tmp_path: Path, qos: str, topic: str
) -> None:
    record(tmp_path / "bag", qos, topic=topic)
    report = cut_bag(tmp_path / "bag", tmp_path / "cut", ["/text", topic], 2 * S, 4 * S)
    assert report.repeated == {topic: 1}
    assert frames(tmp_path / "cut", topic) == [["mast", "camera", "lidar"]]
    assert check_bag(tmp_path / "cut").ok


@pytest.mark.parametrize("qos", QOS.values(), ids=QOS)
def test_each_later_file_begins_with_the_transforms_of_all_publishers(
    tmp_path: Path, qos: str
) -> None:
    record(tmp_path / "bag", qos, Split(max_s=2.0))
    with BagReader(tmp_path / "bag") as reader:
        first, *later = reader.files
    assert len(later) == 2
    assert frames(first) == [["mast"], ["camera"], ["lidar"]] == frames(tmp_path / "bag")
    for file in later:
        assert frames(file) == [["mast", "camera", "lidar"]]
    assert check_bag(tmp_path / "bag").ok
    # What a later file repeats is no news, but where the first one is missing.
    assert recover(tmp_path / "bag", tmp_path / "whole").complete
    assert frames(tmp_path / "whole") == frames(first)
    first.unlink()
    recover(tmp_path / "bag", tmp_path / "rest")
    assert frames(tmp_path / "rest") == [["mast", "camera", "lidar"]]


def latched_bytes(*messages: bytes) -> list[bytes]:
    static = StaticTransforms()
    for k, message in enumerate(messages):
        static.keep(LatchedMessage(message, k, k))
    return [one.cdr for one in static.messages]


def test_the_newest_transform_of_a_child_frame_counts() -> None:
    moved = transform("mast", 9.0)
    (merged,) = latched_bytes(cdr(THREE[0], THREE[1]), cdr(moved), cdr(THREE[2]))
    assert decode_transforms(merged) == (THREE[1], moved, THREE[2])


def test_a_message_that_says_all_is_kept_as_it_is() -> None:
    whole = cdr(*THREE) + bytes(3)  # as some middleware rounds it up
    assert latched_bytes(whole) == [whole]
    assert latched_bytes(cdr(THREE[0]), whole) == [whole]
    assert latched_bytes(cdr(transform("other")), whole) != [whole]


def test_what_is_no_message_of_transforms_is_kept_beside_them() -> None:
    assert latched_bytes(b"nonsense", cdr(THREE[0])) == [b"nonsense", cdr(THREE[0])]
    static = StaticTransforms()
    assert static.take(LatchedMessage(b"nonsense", 0, 0)) == b"nonsense"
    assert static.take(LatchedMessage(cdr(THREE[0]), 0, 0)) == cdr(THREE[0])
    assert static.take(LatchedMessage(cdr(THREE[1]), 0, 0)) == cdr(*THREE[:2])


def test_topics_are_known_by_name_and_type() -> None:
    assert is_static("/tf_static", TF_TYPE)
    assert is_static("/robot/tf_static", TF_TYPE)
    assert not is_static("/tf", TF_TYPE)
    assert not is_static("/my_tf_static", TF_TYPE)
    assert not is_static("/tf_static", STRING)
    assert late_joiner("/tf", TF_TYPE, "") is None
    assert late_joiner("/map", STRING, QOS["depth 1"]) is not None
    assert late_joiner("/map", STRING, QOS["depth 1"], latched=False) is None
