"""Sessions of several processes that CARLA's client draws, with the counterpart of a server here.

How each failure of a server ends a session is tested in one process (``test_carla_sessions``).
"""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core import names
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.steps import decode_tick
from ssp_core.run_file.model import load_run
from tests.support.carla.commands import left_as_found, ssp
from tests.support.carla.counterpart import Actor, Behaviour, Counterpart
from tests.support.carla.picture import read_picture
from tests.support.carla.tasks import MAP, compiled, equal_states, with_small_pictures
from tests.system.conftest import LONG, START_DEADLINE_S
from tests.system.recordings import succeed

pytestmark = [pytest.mark.ros, pytest.mark.system, pytest.mark.carla]


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return with_small_pictures(compiled("cut_in", tmp_path_factory.mktemp("carla") / "task"))


def drawn(task: Path, server: Counterpart) -> tuple[str, ...]:
    return str(task), "--seed", "11", "--camera", f"carla://{server.address}", "--json"


def test_a_session_that_carla_draws(task: Path, tmp_path: Path, start_session: Any) -> None:
    with Counterpart(Behaviour(xodr=MAP.read_text())) as server:
        session = start_session(*drawn(task, server), name="carla")
        result = session.finish()
        assert result["verdict"] == "valid", session.lines
        left_as_found(server)
    ours = ("run", task, "--seed", 11, "--out", tmp_path / "ours", "--in-process", "--record")
    # Our own camera's session is the one without a camera, byte by byte (test_in_process).
    succeed(*ours, "--no-camera")
    assert load_run(tmp_path / "carla" / "run.yaml").camera.renderer == "carla"  # type: ignore[union-attr]
    # What is drawn moves nothing.
    equal_states(tmp_path / "carla" / "bag", tmp_path / "ours" / "bag", ("vut", "ot1"))

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


class Watched(Counterpart):
    """A server that tells when it has sent many pictures."""

    many = 50

    def __init__(self, behaviour: Behaviour) -> None:
        super().__init__(behaviour)
        self.sent_many = threading.Event()

    def _send_picture(self, camera: Actor) -> None:
        super()._send_picture(camera)
        if self.pictures >= self.many:
            self.sent_many.set()


def test_a_server_that_is_gone_and_a_client_that_was_killed_end_the_run(
    task: Path, tmp_path: Path, start_session: Any
) -> None:
    """The one is the node's own reason; the other leaves the server frozen, for the next client."""
    (tmp_path / "long.yaml").write_text(LONG)
    with (
        Counterpart(Behaviour(xodr=MAP.read_text(), exit_at=130)) as gone,
        Watched(Behaviour(xodr=MAP.read_text())) as server,
    ):
        leaving = start_session(*drawn(task, gone), name="gone")
        ended = leaving.finish()
        killed = start_session(
            *drawn(task, server), "--faults", str(tmp_path / "long.yaml"), name="killed"
        )
        assert server.sent_many.wait(START_DEADLINE_S)
        killed.kill(names.FRONT_CAMERA)
        struck = killed.finish()
        assert server.settings != server.left_settings
        assert len(server.actors) > 2
        ((status, text),) = ssp(("carla", "probe", server.address, "--out", tmp_path / "probe"))
        assert status == 0, text
        assert "a client that was killed had left 2 actors" in " ".join(text.split())
        left_as_found(server)
    for session, result, words in (
        (leaving, ended, "CARLA server 127.0.0.1"),
        (killed, struck, "killed by SIGKILL"),
    ):
        assert result["verdict"] == "invalid_harness"
        (reason,) = [one for one in result["reasons"] if one.startswith("front_camera ")]
        assert words in reason, result["reasons"]
        assert 'File "' not in reason
        bag = session.folder / "bag"
        assert check_bag(bag).ok
        assert json.loads((bag / "verdict.json").read_text())["verdict"] == "invalid_harness"
        with BagReader(bag) as reader:
            assert reader.topics[names.absolute(names.CAMERA_IMAGE)].count > 10
