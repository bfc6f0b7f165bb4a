"""One recording given as two domains is found by its tracks, whatever file it lies in."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_recordings import TrackDay, jpeg, write_bag, write_table, write_video

from ssp_core.cli import main
from ssp_core.motion.state import ObjectState
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import Judgement, judge
from ssp_scenario_manager.event_spec.load import load_event

DOMAINS = ("synthetic", "simulation", "physical")
OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")


def measured(day: TrackDay, seed: int) -> TrackDay:
    """The same drive as another positioning system had measured it, to 2 cm."""
    rng = np.random.default_rng(seed)

    def with_noise(state: ObjectState) -> ObjectState:
        x_m, y_m = rng.normal(0.0, 0.02, 2)
        return replace(state, x_m=state.x_m + float(x_m), y_m=state.y_m + float(y_m))

    return replace(
        day, states={who: [with_noise(s) for s in states] for who, states in day.states.items()}
    )


def recorded(
    day: TrackDay, seed: int, pictures: int, path: Path, *, sqlite: bool = False, share: float = 1.0
) -> Path:
    """The bag of a drive as it was measured, with the pictures that one camera took.

    Args:
        day: true states.
        seed: of the measurement.
        pictures: number of the camera; each sees something else.
        path: of the bag.
        sqlite: its format.
        share: of the brightness that is kept; 1: the camera's own.
    """

    def filmed(ns: int, image: Any) -> Any:
        blocks = np.random.default_rng((pictures, ns)).integers(0, 255, (6, 8, 1))
        seen = np.broadcast_to(blocks.repeat(8, axis=0).repeat(8, axis=1), image.shape)
        return jpeg(ns, (share * seen).astype(np.uint8))

    return write_bag(path, measured(day, seed).messages(filmed), sqlite=sqlite)


def from_bag(source: Path, domain: str, out: Path) -> Path:
    declared = ("--domain", domain, "--declared-by", "A", "--declared-on", "2026-03-01")
    arguments = ("import-bag", source, *OBJECTS, *declared, "--place", "hall", "--out", out)
    assert main([str(one) for one in arguments]) == 0
    return out


def from_table(day: TrackDay, domain: str, folder: Path) -> Path:
    """A video with the states of that drive, at a lower rate."""
    video, table = write_video(folder / "a.mp4", 100), write_table(folder / "a.csv", day.states, 5)
    declared = ("--domain", domain, "--declared-by", "A", "--declared-on", "2026-03-01")
    arguments = (
        "import-video",
        video,
        "--states",
        table,
        "--vut",
        "vut",
        *declared,
        "--place",
        "hall",
        "--scenario",
        "cut_in",
        "--generator",
        "a camera",
        "--out",
        folder / "rec",
    )
    assert main([str(one) for one in arguments]) == 0
    return folder / "rec"


def audited(*bags: Path) -> Judgement:
    return judge([read_recording(bag) for bag in bags], load_event("cut_in")[0])


def same(judged: Judgement, index: int) -> list[str]:
    reasons = judged.audit.recordings[index].reasons
    every = [one for reason in reasons for one in (reason, *reason.consequences)]
    return [one.detail for one in every if one.code == "same_recording"]


@pytest.fixture(scope="module")
def others(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two recordings of two drives."""
    found, folder = [], tmp_path_factory.mktemp("others")
    for seed, domain in enumerate(DOMAINS[:2]):
        source = recorded(day, seed, seed, folder / f"{domain}_day")
        found.append(from_bag(source, domain, folder / domain))
    return found[0], found[1]


def test_another_measurement_is_another_recording(
    day: TrackDay, others: tuple[Path, Path], tmp_path: Path
) -> None:
    source = recorded(day, 7, 7, tmp_path / "day")
    judged = audited(*others, from_bag(source, "physical", tmp_path / "physical"))
    assert [same(judged, index) for index in range(3)] == [[], [], []]
    told = [entry.disclosures.get("tracks") for entry in judged.audit.recordings]
    assert told == [
        None,
        "another drive than synthetic",
        "another drive than synthetic; another drive than simulation",
    ]


def test_a_bag_in_another_format_is_the_same_recording(
    day: TrackDay, others: tuple[Path, Path], tmp_path: Path
) -> None:
    source = recorded(day, 1, 7, tmp_path / "day", sqlite=True)
    judged = audited(*others, from_bag(source, "physical", tmp_path / "physical"))
    (detail,) = same(judged, 2)
    assert detail.startswith("its tracks are those of the simulation recording (0.0 cm rms over ")


def test_the_pictures_of_another_domain_are_found_whatever_the_states_are(
    day: TrackDay, others: tuple[Path, Path], tmp_path: Path
) -> None:
    """Places with noise of 2 cm are those of another drive by their tracks."""
    source = recorded(day, 7, 1, tmp_path / "day")
    judged = audited(*others, from_bag(source, "physical", tmp_path / "physical"))
    (detail,) = same(judged, 2)
    assert re.fullmatch(r"\d\d of its pictures are those of the simulation recording", detail)


def test_pictures_that_were_encoded_anew_are_found_too(
    day: TrackDay, others: tuple[Path, Path], tmp_path: Path
) -> None:
    source = recorded(day, 7, 1, tmp_path / "day", share=0.9)
    judged = audited(*others, from_bag(source, "physical", tmp_path / "physical"))
    (detail,) = same(judged, 2)
    assert re.fullmatch(
        r"(\d\d) of \1 pictures are those of the simulation recording, encoded anew", detail
    )


def test_a_video_with_the_states_of_another_domain_is_the_same_recording(
    day: TrackDay, others: tuple[Path, Path], tmp_path: Path
) -> None:
    judged = audited(*others, from_table(measured(day, 1), "physical", tmp_path))
    (detail,) = same(judged, 2)
    assert "its tracks are those of the simulation recording" in detail
