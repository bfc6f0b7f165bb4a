"""Scenes of a recording that is drawn anew: the world's states, or what objects reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.append import append_attachment
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.data.drawn import DRAWN_ATTACHMENT, Redrawing
from ssp_eval.data.provenance import CARLA, Provenance, read_provenance
from ssp_eval.draw.scenes import DrawableRecording, read_recorded, scenes
from ssp_ot_controller.camera.renderer.scene import Scene
from tests.support.bags.worlds import (
    CAMERA,
    STEP_NS,
    STEPS_PER_FRAME,
    TICK,
    cutting_in,
    record_world,
    small_world,
)

STEPS = 41
FRAMES_NS = [step * STEP_NS for step in range(0, STEPS, STEPS_PER_FRAME)]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_world(tmp_path_factory.mktemp("scenes") / "run", steps=STEPS) / "bag"


def redrawing_bytes() -> bytes:
    """The identity of a drawing."""
    told = Redrawing(
        of="run-1",
        of_sha256="sha256:" + "1" * 64,
        map_file="Town01.xodr",
        map_sha256="sha256:" + "2" * 64,
        map_said_by="--map",
        frames=4,
        left_out=2,
        software="ssp",
    )
    return told.model_dump_json(by_alias=True).encode()


def read_scenes(path: Path) -> tuple[DrawableRecording, list[tuple[int, Scene]]]:
    with BagReader(path) as bag:
        found = read_recorded(bag, read_provenance(bag))
        return found, list(scenes(found))


def without(path: Path, topic: str, target: Path) -> Path:
    with BagReader(path) as bag:
        topics = [name for name in bag.topics if name != topic]
    cut_bag(path, target, topics)
    return target


def test_each_frame_has_the_worlds_states_of_its_stamp_once(recorded: Path) -> None:
    found, told = read_scenes(recorded)
    assert list(found.frames_ns) == FRAMES_NS == [stamp_ns for stamp_ns, _ in told]
    for stamp_ns, scene in told:
        assert {s.object_id: s.pose for s in (scene.vut, *scene.others)} == {
            s.object_id: s.pose for s in cutting_in(stamp_ns // STEP_NS)
        }


def test_without_a_world_it_is_what_vut_and_objects_reported(
    recorded: Path, tmp_path: Path
) -> None:
    """A recording on a track has only reported states; traffic, which reports none, is absent."""
    _, told = read_scenes(without(recorded, TICK, tmp_path / "track"))
    assert [stamp_ns for stamp_ns, _ in told] == FRAMES_NS
    for stamp_ns, scene in told:
        truth = {s.object_id: s for s in cutting_in(stamp_ns // STEP_NS)}
        assert {s.object_id for s in scene.others} == {"ot1", "ot2"}
        assert scene.vut.pose == truth["vut"].pose
        assert [s.pose for s in scene.others] == [truth[s.object_id].pose for s in scene.others]


def test_a_frame_without_a_state_of_the_vut_is_left_out(recorded: Path, tmp_path: Path) -> None:
    bag = without(without(recorded, TICK, tmp_path / "track"), "/ssp/vut/state", tmp_path / "lost")
    found, told = read_scenes(bag)
    assert list(found.frames_ns) == FRAMES_NS
    assert told == []


def test_what_has_no_frames_is_refused(recorded: Path, tmp_path: Path) -> None:
    bag = without(recorded, "/ssp/vut/front_camera/image/compressed", tmp_path / "blind")
    with pytest.raises(InputError, match="has no frames"):
        read_scenes(bag)


def test_a_physical_session_that_was_drawn_is_a_stand_in(tmp_path: Path) -> None:
    """No real camera saw it, although real vehicles may have driven it."""
    bag = record_world(tmp_path / "run", steps=1, run=small_world(domain="physical", mode="live"))
    assert facts_of(bag / "bag").stand_in is False
    append_attachment(bag / "bag", DRAWN_ATTACHMENT, redrawing_bytes(), "application/json")
    facts = facts_of(bag / "bag")
    assert facts.stand_in is True
    assert facts.renderer == CARLA
    assert "without 2 frames at which no state of the VUT is known" in facts.origin
    with BagReader(bag / "bag") as reader, pytest.raises(InputError, match="drawn anew by CARLA"):
        read_recorded(reader, facts)


def test_twins_of_pictures_that_carla_drew_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """CARLA drew one session at once, and drew the session of our own camera anew."""
    drawn_by_carla = small_world(camera={**CAMERA, "renderer": "carla"})
    session = record_world(tmp_path / "session", steps=1, run=drawn_by_carla)
    anew = record_world(tmp_path / "anew", steps=1)
    append_attachment(anew / "bag", DRAWN_ATTACHMENT, redrawing_bytes(), "application/json")
    for run in (session, anew):
        assert main(["twins", str(run), "--change", "without=ot1"]) == 1
        said = " ".join(capsys.readouterr().err.split())
        assert "was drawn by CARLA, which promises no equal pixels" in said
        assert "run the task again with --camera raster" in said
        assert not (run / "twins").exists()


def facts_of(bag: Path) -> Provenance:
    with BagReader(bag) as reader:
        return read_provenance(reader)
