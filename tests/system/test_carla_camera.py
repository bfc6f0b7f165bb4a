"""Whole sessions that CARLA's client draws, with the counterpart of a server in this process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core import names
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.steps import decode_tick
from ssp_core.run_file.model import load_run
from ssp_scenario_manager.compile.task import load_task
from ssp_scenario_manager.maps.site import LIBRARY
from support.carla_counterpart import Behaviour, Counterpart
from support.carla_picture import read_picture

pytestmark = [pytest.mark.system, pytest.mark.carla]
MAP = LIBRARY / "maps" / "bend.xodr"
BLOCK = "road 1 forward [0-312 m]"
PATIENCE_S = 400.0


def ssp(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "ssp_core.cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
        env=os.environ.copy(),
    )


def compiled(event: str, folder: Path) -> Path:
    place = ("--map", MAP, "--choose", BLOCK, "--who", "A. Tester")
    done = ssp("compile", event, "--target", "sumo", *place, "--out", folder)
    assert done.returncode == 0, done.stderr
    assert load_task(folder).place.kind == "opendrive"
    return folder


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled("cut_in", tmp_path_factory.mktemp("carla") / "task")


def states(bag: Path, object_id: str) -> dict[int, bytes]:
    """States of the run by their number; before and after it they are sent as often as there
    was time.
    """
    reader = BagReader(bag)
    sent = [bytes(message.data) for message in reader.messages([f"/ssp/{object_id}/state"])]
    numbers = [reader.decode(one).sequence for one in reader.messages([f"/ssp/{object_id}/state"])]
    found = dict(zip(reversed(numbers), reversed(sent), strict=True))
    return {number: data for number, data in found.items() if number > 1}


def test_a_session_that_carla_draws(task: Path, tmp_path: Path) -> None:
    with Counterpart(Behaviour(xodr=MAP.read_text())) as server:
        drawn = ssp(
            "run",
            task,
            "--seed",
            11,
            "--camera",
            f"carla://{server.address}",
            "--out",
            tmp_path / "carla",
            "--json",
        )
        assert drawn.returncode == 0, drawn.stdout + drawn.stderr
        assert server.settings == server.left_settings
        assert len(server.actors) == 2
    assert json.loads(drawn.stdout)["verdict"] == "valid"
    ours = ssp("run", task, "--seed", 11, "--out", tmp_path / "raster", "--json")
    assert ours.returncode == 0, ours.stderr
    assert load_run(tmp_path / "carla" / "run.yaml").camera.renderer == "carla"  # type: ignore[union-attr]
    # What is drawn moves nothing.
    for one in ("vut", "ot1"):
        theirs = states(tmp_path / "carla" / "bag", one)
        mine = states(tmp_path / "raster" / "bag", one)
        both = theirs.keys() & mine.keys()
        assert len(both) > 500
        assert {number: theirs[number] for number in both} == {n: mine[n] for n in both}

    reader = BagReader(tmp_path / "carla" / "bag")
    (said,) = reader.messages([names.absolute(names.CAMERA_RENDERER)])
    record = json.loads(reader.decode(said).data)
    assert (record["version"], record["synchronous"], record["step_s"]) == ("0.9.16", True, 0.1)
    body = record["bodies"]["ot1"]
    ticks = {}
    for message in reader.messages([names.absolute(names.WORLD_TICK)]):
        tick = decode_tick(message.data)
        ticks[tick.stamp_ns] = {one.object_id: one for one in tick.objects}
    frames, count = [], 0
    for message in reader.messages([names.absolute(names.CAMERA_IMAGE)]):
        image = read_image(COMPRESSED_TYPE, message.data)
        told = read_picture(cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR))
        frames.append(told.frame)
        ((x, y, _),) = told.poses.values()
        ot1 = ticks[image.stamp_ns]["ot1"]
        size = body["size"]
        ahead = 0.5 * (size["front_m"] - size["rear_m"]) - body["box"]["forward_m"]
        wanted = ot1.pose.to_parent(ahead, 0.0)
        assert (x, -y) == pytest.approx(wanted, abs=0.002)
        count += 1
    assert count > 50
    assert frames == sorted(set(frames))


@pytest.mark.parametrize("event", ["vru_crossing", "lead_braking", "occluded_crossing"])
def test_each_other_event_is_valid_and_moves_as_without_carla(event: str, tmp_path: Path) -> None:
    task = compiled(event, tmp_path / "task")
    with Counterpart(Behaviour(xodr=MAP.read_text())) as server:
        drawn = ssp(
            "run",
            task,
            "--seed",
            11,
            "--camera",
            f"carla://{server.address}",
            "--out",
            tmp_path / "carla",
            "--json",
        )
        assert drawn.returncode == 0, drawn.stdout + drawn.stderr
        assert server.settings == server.left_settings
        walks = server.walks
    assert json.loads(drawn.stdout)["verdict"] == "valid"
    ours = ssp("run", task, "--seed", 11, "--no-camera", "--out", tmp_path / "ours", "--json")
    assert ours.returncode == 0, ours.stderr
    run = load_run(tmp_path / "carla" / "run.yaml")
    for one in ("vut", *(target.id for target in run.targets)):
        theirs = states(tmp_path / "carla" / "bag", one)
        mine = states(tmp_path / "ours" / "bag", one)
        both = theirs.keys() & mine.keys()
        assert len(both) > 500
        assert {number: theirs[number] for number in both} == {n: mine[n] for n in both}
    pedestrians = {t.id for t in run.targets if t.object_class == "pedestrian"}
    assert {role for role, _, _ in walks} == pedestrians
    if pedestrians:
        # Its feet are on the ground, and it stands before it walks.
        assert {feet_m for _, feet_m, _ in walks} == {0.0}
        speeds = [speed_mps for _, _, speed_mps in walks]
        assert min(speeds) == 0.0
        assert max(speeds) > 0.8


FAILURES: tuple[tuple[Behaviour, str], ...] = (
    (Behaviour(exit_at=100), "CARLA server"),
    (Behaviour(lost=frozenset({80})), "the picture of frame"),
    (Behaviour(vanish_at=("ot1", 110)), "ot1 is gone"),
)


@pytest.mark.parametrize(("behaviour", "words"), FAILURES)
def test_a_failure_ends_the_run_with_its_reason(
    behaviour: Behaviour, words: str, task: Path, tmp_path: Path
) -> None:
    behaviour.xodr = MAP.read_text()
    with Counterpart(behaviour) as server:
        done = ssp(
            "run",
            task,
            "--seed",
            11,
            "--camera",
            f"carla://{server.address}",
            "--out",
            tmp_path / "run",
            "--json",
        )
        assert done.returncode == 1, done.stdout
        if not behaviour.exit_at:
            assert server.settings == server.left_settings
            assert len(server.actors) == 2
    told = json.loads(done.stdout)
    assert told["verdict"] == "invalid_harness"
    (reason,) = [one for one in told["reasons"] if one.startswith("front_camera exited with")]
    assert words in reason.splitlines()[-1], told["reasons"]
    assert 'File "' not in reason
    assert BagReader(tmp_path / "run" / "bag").topics


def test_runs_that_carla_cannot_draw_are_refused_beforehand(task: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    for arguments, words in (
        ((task, "--mode", "realtime"), "CARLA draws and moves in lockstep only"),
        (("cut_in", "--site", "boulevard"), "no CARLA server has that map"),
    ):
        done = ssp("run", *arguments, "--camera", "carla://localhost:2000", "--out", out)
        assert done.returncode == 1
        assert words in done.stderr, done.stderr
        assert not out.exists()
    assert "names neither raster" in ssp("run", task, "--camera", "blender", "--out", out).stderr
