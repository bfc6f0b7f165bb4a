"""``ssp spec clip``: a synthetic clip and the K* that is bound to it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_eval.recordings.source_clip import bind_event, board_of, measure_clip
from ssp_ot_controller.camera.clip import write_clip
from ssp_ot_controller.camera.storyboards import (
    INTERACTIONS,
    LANE_M,
    LaneCounts,
    Storyboard,
    storyboard,
)
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.event_spec.graph import differences
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import read_log
from ssp_scenario_manager.event_spec.model import Event, WordField

SHA256 = "sha256:" + "a" * 64


def bound(event: Event, seed: int, lanes: tuple[int, int] | None = None) -> Event:
    board = board_of(event, seed, lanes)
    return bind_event(event, board, measure_clip(event, board), SHA256)


def test_the_command_writes_clip_truth_k_star_and_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["spec", "clip", "vru_crossing", "--lanes", "1+1", "--out", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    event, version = load_event(str(tmp_path / "vru_crossing.event.yaml"))
    assert version in told
    video = tmp_path / "vru_crossing.mp4"
    assert event.source.sha256 == sha256_file(video)
    assert check_event(event) == []
    road = event.topology
    assert (road.lanes_same_direction.value, road.lanes_opposite.value) == (1, 1)
    truth = json.loads((tmp_path / "vru_crossing.truth.json").read_text())
    assert [lane["direction"] for lane in truth["road"]["lanes"]] == ["forward", "backward"]
    capture = cv2.VideoCapture(str(video))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == truth["frame_count"]
    capture.release()
    (record,) = read_log(tmp_path / "vru_crossing.log.jsonl")
    assert (record.kind, record.details["sha256"]) == ("source", event.source.sha256)
    assert record.details["made_from"] == load_event("vru_crossing")[1]
    assert main(["spec", "clip", "vru_crossing", "--out", str(tmp_path)]) == 1
    assert "exists already" in capsys.readouterr().err
    assert sha256_file(video) == event.source.sha256


def test_interrupted_it_leaves_nothing_and_the_next_call_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = write_clip

    def interrupted(board: Storyboard, video: Path, advance: Callable[[], None]) -> None:
        left = [None] * 3

        def step() -> None:
            left.pop()
            if not left:
                raise KeyboardInterrupt

        drawn(board, video, step)

    out = tmp_path / "clips"
    command = ["spec", "clip", "cut_in", "--out", str(out)]
    monkeypatch.setattr("ssp_ot_controller.camera.clip.write_clip", interrupted)
    assert main(command) == 130
    assert not out.exists()
    monkeypatch.setattr(
        "ssp_ot_controller.camera.clip.write_clip", lambda _, video, __: video.write_bytes(b"clip")
    )
    assert main(command) == 0
    held = ["cut_in.event.yaml", "cut_in.log.jsonl", "cut_in.mp4"]
    assert sorted(file.name for file in out.iterdir()) == held
    monkeypatch.setattr("ssp_ot_controller.camera.clip.write_clip", interrupted)
    assert main([*command, "--force"]) == 130
    assert sorted(file.name for file in out.iterdir()) == held
    assert (out / "cut_in.mp4").read_bytes() == b"clip"


@pytest.mark.parametrize("name", INTERACTIONS)
def test_bound_to_its_own_clip_a_shipped_event_differs_in_the_hash_alone(name: str) -> None:
    shipped, _ = load_event(name)
    found = {item.field for item in differences(shipped, bound(shipped, 1))}
    assert found == {"source.sha256", "uncertainty.source.sha256.seal"}


@pytest.mark.parametrize("name", INTERACTIONS)
@pytest.mark.parametrize("seed", [2, 7, 1234])
def test_another_seed_is_another_event_that_holds_every_check(name: str, seed: int) -> None:
    shipped, _ = load_event(name)
    event = bound(shipped, seed)
    assert check_event(event) == []
    assert event.events != shipped.events
    trigger = event.events.trigger.evidence[0].frames
    assert trigger is not None
    source = event.uncertainty["motion.ot1.trigger"].source
    assert source == f"frames {trigger[0]}-{trigger[1]} of ssp-clip/1 {name} seed {seed}"


@pytest.mark.parametrize(("same", "opposite"), [(1, 1), (1, 0), (2, 1), (3, 2)])
def test_part_t_has_the_lanes_that_were_drawn(same: int, opposite: int) -> None:
    shipped, _ = load_event("lead_braking")
    board = storyboard("lead_braking", 1, LaneCounts(same, opposite))
    event = bound(shipped, 1, (same, opposite))
    assert check_event(event) == []
    road = event.topology
    assert road.lanes_same_direction.value == same
    assert road.lanes_opposite.value == opposite
    # What may vary in the event may still; a number outside that range is the clip's own.
    assert road.lanes_opposite.identity == (opposite == 0)
    oncoming = [actor for actor in board.others if actor.object_id == "oncoming_car"]
    outermost = {(same + opposite - 1) * LANE_M} if opposite else set()
    assert {actor.state(0.0).y_m for actor in oncoming} == outermost


def test_what_the_generator_cannot_draw_is_refused() -> None:
    shipped, _ = load_event("cut_in")
    with pytest.raises(InputError, match=r"1\+1 lanes"):
        board_of(shipped, 1, (1, 1))
    curve = shipped.topology.model_copy(update={"segment": WordField(value="curve", identity=True)})
    with pytest.raises(InputError, match="it draws straight"):
        board_of(shipped.model_copy(update={"topology": curve}), 1)


def test_a_wrong_number_of_lanes_is_wrong_usage(tmp_path: Path) -> None:
    assert main(["spec", "clip", "cut_in", "--lanes", "two", "--out", str(tmp_path / "x")]) == 2
    assert main(["spec", "clip", "cut_in", "--lanes", "1+1", "--out", str(tmp_path / "x")]) == 1
    assert not (tmp_path / "x").exists()
