"""ssp bag info, check and recover."""

from __future__ import annotations

import json

import pytest

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cli import main


def run(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str, str]:
    status = main(["bag", *map(str, args)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_info_shows_topics_and_attachments(small_bag, capsys):
    status, shown, _ = run(capsys, "info", small_bag)
    assert status == 0
    assert "10 messages of 1 topics, 1 file" in shown
    assert "9.000 s from 0.000 s" in shown
    assert "/clock  rosgraph_msgs/msg/Clock        10  1.0" in shown
    assert "run.yaml" in shown
    status, shown, _ = run(capsys, "info", small_bag, "--json")
    summary = json.loads(shown)
    assert summary["topics"]["/clock"]["messages"] == 10
    assert summary["end_ns"] == 9_000_000_000


def test_info_on_an_empty_bag(tmp_path, capsys):
    BagWriter(tmp_path / "empty").close()
    status, shown, _ = run(capsys, "info", tmp_path / "empty")
    assert status == 0
    assert "0 messages of 0 topics" in shown
    assert "no times" in shown


@pytest.mark.parametrize("verb", ["info", "check", "recover"])
def test_a_bag_that_is_not_there_is_one_message(tmp_path, capsys, verb):
    status, _, errors = run(capsys, verb, tmp_path / "nowhere")
    assert status == 1
    assert f"{tmp_path / 'nowhere'}: is not there" in errors


def test_a_sound_bag_passes(small_bag, capsys):
    for path in (small_bag, small_bag / "small_0.mcap"):
        status, shown, _ = run(capsys, "check", path, "--json")
        assert status == 0
        said = json.loads(shown)
        assert said.pop("seal").startswith("sealed by its writer, 1 chunks, end ")
        assert said == {
            "path": str(path),
            "ok": True,
            "messages": {"/clock": 10},
            "problems": [],
            "undecoded": {},
            "remarks": [],
        }


def test_a_flipped_byte_fails(small_bag, capsys, clock_cdr):
    file = small_bag / "small_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(clock_cdr(5_000_000_000)) + 6] ^= 1
    file.write_bytes(data)
    status, shown, _ = run(capsys, "check", small_bag)
    assert status == 1
    assert "small_0.mcap: is damaged" in shown
    assert "crc" in shown.lower()
    assert "problems: 1" in shown


def test_counts_that_disagree_fail(small_bag, capsys):
    metadata = small_bag / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 10", "message_count: 11"))
    status, shown, _ = run(capsys, "check", small_bag)
    assert status == 1
    assert "/clock: 10 messages stored, 11 in metadata.yaml" in shown
    assert "10 messages stored, 11 in metadata.yaml" in shown


def test_messages_that_are_not_of_their_type_fail(tmp_path, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        writer.write("/clock", b"\x00\x01\x00\x00\x01", 0, 0)
        writer.write("/clock", b"\x00\x01\x00\x00\x01", 1, 1)
    status, shown, _ = run(capsys, "check", tmp_path / "bag", "--json")
    assert status == 1
    problems = json.loads(shown)["problems"]
    assert len(problems) == 2
    assert problems[1] == "/clock: 2 of 2 messages can't be decoded"


def test_recover_makes_a_bag_of_a_cut_file(small_bag, tmp_path, capsys):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((small_bag / "small_0.mcap").read_bytes()[:-100])
    status, _, _ = run(capsys, "check", cut)
    assert status == 1
    status, shown, _ = run(capsys, "recover", cut)
    assert status == 0
    assert "10 messages of 1 topics" in shown
    with BagReader(tmp_path / "cut_recovered") as reader:
        assert reader.count == 10
    status, shown, _ = run(capsys, "check", tmp_path / "cut_recovered")
    assert status == 0
    status, shown, _ = run(capsys, "recover", cut, "--out", tmp_path / "b", "--json")
    assert json.loads(shown)["messages"] == {"/clock": 10}
