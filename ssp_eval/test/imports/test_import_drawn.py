"""A recording of somebody's own bag, drawn anew by CARLA's client; and a server that is silent."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign_recordings import INFO, TrackDay, camera_info, jpeg, write_bag

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import read_seal
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cli import main
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_eval.audit.server import server_disclosures
from ssp_eval.data.provenance import COUNTERPART, read_provenance
from tests.support.carla.commands import left_as_found, refused, ssp
from tests.support.carla.counterpart import EMPTY_XODR, Counterpart
from tests.support.carla.picture import read_picture

pytestmark = pytest.mark.carla
IMAGE = absolute(CAMERA_IMAGE)
# Wide enough for what the counterpart writes into its pictures.
SIZE = (384, 96)
IMPORT = (
    "--vut",
    "/vut/odom",
    "--object",
    "ot1=/ot1/odom:car",
    "--camera",
    "/cam",
    "--domain",
    "physical",
    "--declared-by",
    "A. Engineer",
    "--declared-on",
    "2026-03-01",
    "--place",
    "north track",
)
LENS = ("--camera-info", "/info", "--mount", "1.5,0,1.4,2")


def wide(ns: int, image: Any) -> Any:
    return jpeg(ns, cv2.resize(image, SIZE, interpolation=cv2.INTER_NEAREST))


@pytest.fixture(scope="module")
def imports(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of an import with road and lens, of one without a road, and of one without a lens."""
    folder = tmp_path_factory.mktemp("imports")
    messages = day.messages(wide)
    messages.append(("/info", INFO, day.zero_ns, camera_info(day.zero_ns, 192.0, SIZE)))
    source = str(write_bag(folder / "day", messages))
    for name, given in (
        ("whole", (*LENS, "--site", "boulevard")),
        ("roadless", LENS),
        ("lensless", ("--site", "boulevard")),
    ):
        assert main(["import-bag", source, *IMPORT, *given, "--out", str(folder / name)]) == 0
    (folder / "map.xodr").write_text(EMPTY_XODR)
    return folder


def test_an_imported_track_day_is_drawn_anew(
    imports: Path, day: TrackDay, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    out, whole = tmp_path / "drawn", imports / "whole"
    with Counterpart() as server:
        camera = ("--map", imports / "map.xodr", "--camera", f"carla://{server.address}")
        done, roadless, lensless = ssp(
            ("draw", whole, *camera, "--out", out),
            ("draw", imports / "roadless", *camera, "--out", tmp_path / "none"),
            ("draw", imports / "lensless", *camera, "--out", tmp_path / "none"),
        )
        assert done[0] == 0, done[1]
        left_as_found(server)
    refused(roadless, "has no road", "ssp import-bag --site MAP")
    refused(lensless, "says nowhere where its camera stood")
    states = {s.stamp_ns: s for s in day.states["ot1"]}
    count = 0
    with BagReader(whole) as before, BagReader(out) as after:
        source, facts = read_provenance(before), read_provenance(after)
        assert check_bag(out).ok
        assert read_seal(after).sources[0].sha256 == source.bag_sha256
        for message in after.messages([IMAGE]):
            found = read_image(COMPRESSED_TYPE, message.data)
            told = read_picture(cv2.imdecode(np.frombuffer(found.data, np.uint8), 1))
            ((x, y, _),) = told.poses.values()
            wanted = states[found.stamp_ns - day.zero_ns].pose.to_parent(1.35, 0.0)
            assert (x, -y) == pytest.approx(wanted, abs=0.05)
            count += 1
    assert count == len(day.frames_ns)
    # No camera saw it, and both are one drive.
    assert facts.stand_in
    assert not source.stand_in
    assert facts.renderer == COUNTERPART
    assert facts.redrawing is not None
    assert facts.redrawing.of_sha256 == source.bag_sha256
    assert "vehicle.mercedes.coupe_2020" in server_disclosures(facts)["body of ot1"]
    assert not list(tmp_path.glob("*.drawing"))


def test_a_server_that_does_not_answer_leaves_nothing_behind(
    imports: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One server takes the connection and stays silent, as if it hung; one port is closed."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    given = ("draw", imports / "whole", "--map", imports / "map.xodr", "--out", tmp_path / "drawn")
    with socket.socket() as silent, socket.socket() as closed:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        closed.bind(("127.0.0.1", 0))
        addresses = [f"carla://127.0.0.1:{one.getsockname()[1]}" for one in (silent, closed)]
        hangs, nobody = ssp(*((*given, "--camera", address) for address in addresses))
    refused(hangs, "no answer within 8 s; is it running")
    refused(nobody, "no CARLA server at 127.0.0.1", "start one, or name its RPC port")
    for _, text in (hangs, nobody):
        assert len([line for line in text.splitlines() if "CARLA server" in line]) == 1
        assert "Traceback" not in text
    assert list(tmp_path.iterdir()) == []
