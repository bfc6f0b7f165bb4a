"""Our own sessions and clips, turned into what others would record, measure the same event."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from foreign_recordings import (
    INFO,
    TrackDay,
    camera_info,
    event_of,
    imported,
    jpeg,
    number_of,
    starts,
    truth,
    write_bag,
    write_table,
    write_video,
)

from ssp_core.cli import main
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Camera, RunSpec, load_run
from ssp_core.vocabulary import PHASES, ObjectClass, Role
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.examine import examine
from ssp_ot_controller.camera.clip import write_clip
from ssp_ot_controller.camera.frames import Odometer
from ssp_ot_controller.camera.renderer.render import render
from ssp_ot_controller.camera.renderer.scene import Scene
from ssp_ot_controller.camera.storyboards import storyboard
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.site import find_shipped

OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")
ROLES = {"vut": Role.VUT, "ot1": Role.OT}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Task and run of the shipped cut-in on the boulevard."""
    folder = tmp_path_factory.mktemp("session")
    task = ("cut_in", "--site", "boulevard", "--target", "sumo", "--out", str(folder / "task"))
    assert main(["compile", *task]) == 0
    assert main(["run", str(folder / "task"), "--in-process", "--out", str(folder / "run")]) == 0
    return folder


@pytest.fixture(scope="module")
def session(folder: Path) -> TrackDay:
    """The states of that run, from its start on."""
    size = DEFAULT_SIZES[ObjectClass.CAR]
    with np.load(folder / "run" / "states.npz") as kept:
        columns = [str(name) for name in kept["columns"]]
        rows = {name: kept[f"{name}_true"].tolist() for name in ROLES}
    zero_ns = round(rows["vut"][0][0])
    states: dict[str, list[ObjectState]] = {}
    for name, values in rows.items():
        for row in values:
            of = dict(zip(columns, row, strict=True))
            ns = round(of.pop("stamp_ns")) - zero_ns
            one = ObjectState(name, ObjectClass.CAR, ROLES[name], stamp_ns=ns, size=size, **of)
            states.setdefault(name, []).append(one)
    return TrackDay(states)


def draw(run: RunSpec, session: TrackDay, size: tuple[int, int]) -> list[Any]:
    """The frames of a session through a camera of 90 degrees, 1.6 m ahead and 1.4 m up."""
    camera = Camera(
        width_px=size[0],
        height_px=size[1],
        hfov_deg=90.0,
        forward_m=1.6,
        height_m=1.4,
        pitch_down_rad=math.radians(2.0),
    )
    at = {name: {one.stamp_ns: one for one in rows} for name, rows in session.states.items()}
    odometer, found = Odometer(), []
    for index, ns in enumerate(session.frames_ns):
        states = tuple(rows[ns] for rows in at.values())
        odometer.update(states)
        scene = Scene(run.road, at["vut"][ns], states, odometer.snapshot(), {})
        found.append(render(scene, run.look, camera, index, run.seed))
    return found


def test_a_session_as_a_plain_bag_measures_the_same_event(
    session: TrackDay, tmp_path: Path
) -> None:
    source = write_bag(tmp_path / "day", session.messages(), sqlite=True)
    out = tmp_path / "rec"
    declared = ("--domain", "physical", "--site", "boulevard", "--event", "cut_in")
    assert main(["import-bag", str(source), *OBJECTS, *declared, "--out", str(out)]) == 0
    event, provenance = imported(out)
    assert starts(event) == pytest.approx(starts(truth(session)), abs=0.02)
    assert provenance.road is not None
    # Labels are planned from its states as from a session's own.
    assert main(["labels", "new", str(out), "--out", str(tmp_path / "labels.json")]) == 0
    labels = json.loads((tmp_path / "labels.json").read_text())["labels"]
    assert {label["phase"] for label in labels} == set(PHASES)
    (block,) = load_library(find_shipped("boulevard", "site")).blocks
    assert [lane.y_m for lane in provenance.road.lanes] == [lane.y_m for lane in block.lanes]


def test_the_audit_finds_nothing_but_what_nobody_declared(
    folder: Path, session: TrackDay, tmp_path: Path
) -> None:
    size = (640, 480)
    lens = camera_info(session.zero_ns, 320.0, size)
    drawn = draw(load_run(folder / "run" / "run.yaml"), session, size)
    frames = session.messages(lambda ns, image: jpeg(ns, drawn[number_of(image)]))
    source = write_bag(tmp_path / "day", [*frames, ("/info", INFO, session.zero_ns, lens)])
    given = (
        "--camera-info",
        "/info",
        "--mount",
        "1.6,0,1.4,2",
        "--domain",
        "physical",
        "--site",
        "boulevard",
        "--event",
        "cut_in",
    )
    log = (
        "--log-by",
        "B. Safety",
        "--safety-abort",
        "no",
        "--identity-switch",
        "no",
        "--site-change",
        "none",
        "--declared-by",
        "A",
        "--declared-on",
        "2026-03-01",
        "--place",
        "x",
    )
    event, version = load_event("cut_in")
    found = []
    for name, declared in (("declared", log), ("not", ())):
        out = tmp_path / name
        assert (
            main(["import-bag", str(source), *OBJECTS, *given, *declared, "--out", str(out)]) == 0
        )
        found.append(examine(read_recording(out), event, version))
    assert [finding.detail for finding in found[0].findings] == []
    unverified = [finding for finding in found[1].findings if finding.code == "unverified"]
    assert len(unverified) == len(found[1].findings) > 0


def test_a_session_as_a_video_with_a_table_measures_the_same_event(
    session: TrackDay, tmp_path: Path
) -> None:
    video = write_video(tmp_path / "clip.avi", len(session.frames_ns))
    table = write_table(tmp_path / "clip.csv", session.states)
    out = tmp_path / "rec"
    given = ("--states", str(table), "--domain", "simulation", "--out", str(out))
    assert main(["import-video", str(video), *given]) == 0
    event, _ = imported(out)
    assert starts(event) == pytest.approx(starts(truth(session)), abs=0.02)


def test_a_clip_with_its_truth_as_a_table_measures_the_clips_event(tmp_path: Path) -> None:
    whole = storyboard("cut_in", 1)
    small = whole.camera.model_copy(update={"width_px": 192, "height_px": 108})
    board = replace(whole, camera=small)
    video = tmp_path / "clip.mp4"
    write_clip(board, video)
    times = board.times()
    states: dict[str, list[ObjectState]] = {}
    for t_s in times:
        for one in board.states(t_s):
            states.setdefault(one.object_id, []).append(one)
    table = write_table(tmp_path / "clip.csv", states)
    # The clip's road as a site file: its lanes, and what a site must say.
    site = yaml.safe_load(find_shipped("boulevard", "site").read_text())
    road = board.road.model_dump(mode="json")
    block = site["blocks"][0]
    block |= {
        "origin": road["origin"],
        "pieces": [{"length_m": road["length_m"]}],
        "lanes": road["lanes"],
        "traffic": [],
        "crossing_x_m": None,
    }
    whole_road = {
        "block": "main",
        "from_s_m": 0.0,
        "to_s_m": road["length_m"],
        "from_l_m": -4.0,
        "to_l_m": 14.0,
    }
    site |= {"ot_reachable": [whole_road], "safe_stop_zones": [whole_road], "geofence": whole_road}
    (tmp_path / "clip.site.yaml").write_text(json.dumps(site))
    out = tmp_path / "rec"
    given = ("--object", "ot1=ot1", "--site", str(tmp_path / "clip.site.yaml"), "--rate", "24")
    assert (
        main(["import-video", str(video), "--states", str(table), *given, "--out", str(out)]) == 0
    )
    event, provenance = imported(out)
    series = [(t_s, {s.object_id: s for s in board.states(t_s)}) for t_s in times]
    assert starts(event) == pytest.approx(starts(event_of(series)), abs=1 / board.fps)
    assert provenance.road is not None
    assert provenance.road.lanes == board.road.lanes
