"""Twins of a recorded world: what they are, what differs in them, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import read_seal
from ssp_core.cdr.states import decode_state
from ssp_core.cdr.steps import decode_tick
from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_core.motion.state import ObjectState
from ssp_eval.data.provenance import read_provenance
from ssp_eval.recordings.clip import Clip, Question
from ssp_eval.twins.audit import Pixels, audit_of
from ssp_eval.twins.changes import parse_change
from ssp_eval.twins.files import TwinRecord, bag_of, read_set, usable_twins
from tests.support.bags.seals import with_checksums
from tests.support.bags.worlds import HELD, IMAGE, TICK, cutting_in, record_world, small_world

ALL = {
    "camera.0500",
    "class.ot1.truck",
    "class.ot2.car",
    "control.car",
    "history.0500",
    "mirror.ot1",
    "mirror.ot2",
    "shift.ot1.m0500",
    "shift.ot1.p0500",
    "shift.ot2.m0500",
    "shift.ot2.p0500",
    "without.ot1",
    "without.ot2",
}
# The lorry stands.
IDLE = {"shift.ot2.m0500", "shift.ot2.p0500"}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with all its twins."""
    run = record_world(tmp_path_factory.mktemp("twins") / "run")
    assert main(["twins", str(run), "--change", "all"]) == 0
    return run


def record(run: Path, name: str) -> TwinRecord:
    text = (run / "twins" / name / "twin.json").read_text()
    return TwinRecord.model_validate_json(text)


def payloads(bag: Path, topic: str) -> list[bytes]:
    with BagReader(bag) as reader:
        return [message.data for message in reader.messages([topic])]


def images(run: Path, name: str = "") -> Iterator[Any]:
    bag = run / "twins" / name / "bag" if name else run / "bag"
    for data in payloads(bag, IMAGE):
        start = data.index(b"\xff\xd8")
        yield cv2.imdecode(np.frombuffer(data[start:], np.uint8), cv2.IMREAD_COLOR)


def test_all_twins_are_made_and_differ_in_their_cause_alone(made: Path) -> None:
    found = read_set(made / "bag")
    assert found is not None
    assert {twin.identity.name for twin in found.twins} == ALL
    assert {twin.identity.name for twin in found.twins if not twin.audit.holds} == IDLE
    for twin in found.twins:
        assert twin == record(made, twin.identity.name)
        assert twin.audit.outside_px in (0, None)
        assert not twin.audit.holds or twin.audit.reasons == []
    with BagReader(made / "bag") as bag:
        digest = read_provenance(bag).bag_sha256
    assert {t.identity.name for t in usable_twins(made / "bag", digest)} == ALL - IDLE


@pytest.mark.parametrize("name", ["without.ot1", "control.car", "camera.0500", "history.0500"])
def test_a_twin_is_a_whole_bag(made: Path, name: str) -> None:
    assert check_bag(bag_of(made / "bag", name)).ok
    with BagReader(made / "bag") as bag, BagReader(bag_of(made / "bag", name)) as twin:
        assert twin.topics.keys() == bag.topics.keys()
        assert set(twin.attachments) == {"run.yaml", "twin.json"}
        assert twin.attachment("run.yaml") == bag.attachment("run.yaml")
        seal, parent = read_seal(twin), read_seal(bag)
    assert seal.maker == "twin"
    assert seal.is_sound
    assert [(one.name, one.ends) for one in seal.sources] == [("bag", parent.ends)]


def test_an_altered_recording_and_an_altered_twin_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = record_world(tmp_path / "run", steps=30)
    command = ["twins", str(run), "--change", "control"]
    assert main(command) == 0
    file = bag_of(run / "bag", "control.car") / "bag_0.mcap"
    sound, data = file.read_bytes(), bytearray(file.read_bytes())
    data[data.index(b"\xff\xd8\xff") + 20] ^= 1
    file.write_bytes(with_checksums(data))
    assert not check_bag(file.parent).ok
    assert main(command) == 0  # it is made again
    assert file.read_bytes() == sound
    file = run / "bag" / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(b"\xff\xd8\xff") + 20] ^= 1
    file.write_bytes(with_checksums(data))
    capsys.readouterr()
    assert main([*command, "--force"]) == 1
    assert "is altered since it was sealed: chunk 1 of bag_0.mcap" in capsys.readouterr().err


def test_without_an_object_nothing_tells_of_it(made: Path) -> None:
    bag = bag_of(made / "bag", "without.ot1")
    assert payloads(bag, "/ssp/ot1/state") == []
    assert not any(b"ot1" in data for topic in (TICK, "/tf") for data in payloads(bag, topic))
    for name in ("/ssp/vut/state", "/ssp/ot2/state"):
        assert payloads(bag, name) == payloads(made / "bag", name)
    theirs = [decode_tick(data).objects for data in payloads(made / "bag", TICK)]
    assert [decode_tick(data).objects for data in payloads(bag, TICK)] == [
        tuple(state for state in states if state.object_id != "ot1") for states in theirs
    ]


def test_traffic_that_reports_nothing_can_be_taken_away(tmp_path: Path) -> None:
    run = record_world(tmp_path / "run", steps=60)
    assert main(["twins", str(run), "--change", "without=passer"]) == 0
    found = record(run, "without.passer").audit
    assert set(found.messages_changed) == {IMAGE, TICK}
    assert found.messages_missing == {}


def test_camera_alone_keeps_the_history_and_history_alone_the_frames(made: Path) -> None:
    factual, state = made / "bag", "/ssp/vut/state"
    camera, history = (bag_of(factual, name) for name in ("camera.0500", "history.0500"))
    assert payloads(camera, state) == payloads(factual, state)
    assert payloads(camera, TICK) == payloads(factual, TICK)
    assert payloads(camera, IMAGE)[5:] != payloads(factual, IMAGE)[5:]
    assert payloads(history, IMAGE) == payloads(factual, IMAGE)
    assert payloads(history, TICK) == payloads(factual, TICK)
    assert {decode_state(data).speed_mps for data in payloads(history, state)} == {5.0}


def test_a_frame_taken_earlier_is_where_the_camera_was_then(tmp_path: Path) -> None:
    def alone(step: int) -> tuple[ObjectState, ...]:
        return cutting_in(step)[-1:]

    quiet = small_world(look={"noise_sigma": 0.0})
    run = record_world(tmp_path / "run", steps=60, run=quiet, states=alone)
    assert main(["twins", str(run), "--change", "camera=0.2"]) == 0
    before, after = list(images(run)), list(images(run, "camera.0200"))
    before, after = before[HELD:], after[HELD:]
    assert all((one == two).all() for one, two in zip(before[:-1], after[1:], strict=True))


def test_a_twin_is_asked_about_at_the_factual_times_and_never_scored(made: Path) -> None:
    with Clip(made / "bag") as factual, Clip(bag_of(made / "bag", "mirror.ot1")) as twin:
        one, two = factual.question(2.0), twin.question(2.0)
        assert isinstance(one, Question)
        assert isinstance(two, Question)
        assert (one.t_s, one.request.stamp_ns) == (two.t_s, two.request.stamp_ns)
        assert one.request.history == two.request.history
        assert one.request.frames != two.request.frames
        assert factual.provenance.refusal is None
        assert "is a twin" in str(twin.provenance.refusal)


def test_where_light_reaches_further_the_pixels_outside_are_counted_and_not_judged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dusk = small_world(look={"light": "dusk"})
    run = record_world(tmp_path / "run", steps=20, run=dusk)
    assert main(["twins", str(run), "--change", "without=ot1"]) == 0
    found = record(run, "without.ot1").audit
    assert (found.holds, found.outside_judged) == (True, False)
    assert found.outside_px is not None
    assert found.outside_px > 0
    assert f"({found.outside_px})" in capsys.readouterr().out


def test_a_twin_that_differs_in_more_than_its_cause_does_not_hold(made: Path) -> None:
    change = parse_change("without=ot1")
    with (
        BagReader(made / "bag") as factual,
        BagReader(bag_of(made / "bag", "without.ot1")) as twin,
        BagReader(bag_of(made / "bag", "mirror.ot1")) as other,
    ):
        pixels = Pixels("ot1", frames=15, changed_frames=15, bounded=True)
        assert audit_of(change, factual, twin, pixels).holds
        outside = replace(pixels, outside_px=3)
        assert audit_of(change, factual, twin, outside).reasons == [
            "3 changed pixels lie outside the object's image and shadow"
        ]
        # As a twin of its control: the states of ot1 are nobody's business there.
        told = audit_of(parse_change("control"), factual, twin, replace(pixels, object_id="x"))
        assert "/ssp/world/tick differs in more than the change" in told.reasons
        assert "/ssp/ot1/state lacks a message" in told.reasons
        assert not audit_of(change, twin, other, pixels).holds


def test_the_same_inputs_give_the_same_bytes_and_a_finished_twin_is_kept(tmp_path: Path) -> None:
    run = record_world(tmp_path / "run", steps=60)
    command = ["twins", str(run), "--change", "without=ot1"]
    assert main(command) == 0
    file = run / "twins" / "without.ot1" / "bag" / "bag_0.mcap"
    first, written = sha256_file(file), file.stat().st_mtime_ns
    assert main(command) == 0
    assert file.stat().st_mtime_ns == written
    assert main([*command, "--force"]) == 0
    assert file.stat().st_mtime_ns != written
    assert sha256_file(file) == first


def test_a_twin_that_is_damaged_or_unfinished_is_made_again(tmp_path: Path) -> None:
    run = record_world(tmp_path / "run", steps=30)
    command = ["twins", str(run), "--change", "without=ot1", "--change", "control"]
    assert main(command) == 0
    (run / "twins" / "control.car" / "twin.json").unlink()
    file = run / "twins" / "without.ot1" / "bag" / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-200])
    assert main(command) == 0
    found = read_set(run / "bag")
    assert found is not None
    assert [twin.identity.name for twin in found.twins] == ["control.car", "without.ot1"]
    assert check_bag(file.parent).ok


def test_the_twins_are_printed_for_programs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = record_world(tmp_path / "run", steps=30)
    # It is behind the camera's picture by then: of a change that was named, that is a failure.
    assert main(["twins", str(run), "--change", "shift=ot2:0.5", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert told == json.loads((run / "twins" / "twin_set.json").read_text())
    assert (told["schema"], told["of"]) == ("ssp.twin_set/1", "run-1")
    (twin,) = told["twins"]
    assert twin["audit"]["reasons"] == ["nothing differs: the change does nothing here"]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ("without=ot9", "(got 'ot9'); its objects are ot1, ot2, passer"),
        ("without=vut", "--change: is the VUT, which drives in a twin as it was recorded"),
    ],
)
def test_a_change_of_somebody_else_is_refused(
    change: str, why: str, made: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted((made / "twins").iterdir())
    assert main(["twins", str(made), "--change", change]) == 1
    assert why in capsys.readouterr().err
    assert sorted((made / "twins").iterdir()) == before


def test_a_wrong_change_is_wrong_usage(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["twins", str(made), "--change", "shift=ot1"]) == 2
    assert "shift=ID:SECONDS" in capsys.readouterr().err


def test_no_twin_is_made_of_frames_that_come_out_otherwise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def other(data: bytes) -> bytes:
        return data[:-2] + b"\x00" + data[-2:]

    run = record_world(tmp_path / "run", steps=30, frame=other)
    assert main(["twins", str(run), "--change", "without=ot1"]) == 1
    assert "drawn anew it doesn't have the recorded bytes" in capsys.readouterr().err
    assert list((run / "twins").iterdir()) == []


def test_a_twin_has_no_twins(made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twin = made / "twins" / "mirror.ot1"
    assert main(["twins", str(twin), "--change", "without=ot1"]) == 1
    assert "is a twin: ot1 on the other side of the VUT, of run-1" in capsys.readouterr().err


def test_twins_of_another_recording_are_replaced_by_force_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, other = (
        record_world(tmp_path / name, steps=steps) for name, steps in (("a", 30), ("b", 40))
    )
    command = ["twins", str(run), "--change", "control"]
    assert main(command) == 0
    (run / "bag").rename(tmp_path / "old")
    (other / "bag").rename(run / "bag")
    assert main(command) == 1
    assert "holds twins of another recording" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0
