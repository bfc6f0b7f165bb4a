"""Recordings whose pictures CARLA's client draws anew, with the counterpart of a server here."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import read_seal
from ssp_core.cdr.images import COMPRESSED_TYPE, read_image
from ssp_core.cdr.steps import decode_tick
from ssp_core.cli import main
from ssp_core.motion.state import ObjectState
from ssp_eval.audit.doubles import _shared
from ssp_eval.data.provenance import COUNTERPART, read_provenance
from ssp_eval.draw.cli import default_out
from tests.support.bags.worlds import CAMERA, IMAGE, TICK, record_world, small_world
from tests.support.carla.catalogue import BODIES
from tests.support.carla.commands import PATIENCE_S, left_as_found, refused, ssp
from tests.support.carla.counterpart import EMPTY_XODR, Actor, Behaviour, Counterpart
from tests.support.carla.picture import Written, read_picture

pytestmark = pytest.mark.carla
RENDERER = "/ssp/vut/front_camera/renderer"
STEPS = 41


@pytest.fixture(scope="module", autouse=True)
def state_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    # Wide enough for what the counterpart writes into its pictures.
    wide = small_world(camera={**CAMERA, "width_px": 384})
    run = record_world(tmp_path_factory.mktemp("recorded") / "run", steps=STEPS, run=wide)
    (run / "map.xodr").write_text(EMPTY_XODR)
    return run


def drawing(run: Path, server: Counterpart, out: Path) -> tuple[object, ...]:
    camera = f"carla://{server.address}"
    return ("draw", run, "--map", run / "map.xodr", "--camera", camera, "--out", out)


def pictures(bag: Path) -> dict[int, Written]:
    with BagReader(bag) as reader:
        found = [read_image(COMPRESSED_TYPE, m.data) for m in reader.messages([IMAGE])]
    return {
        one.stamp_ns: read_picture(cv2.imdecode(np.frombuffer(one.data, np.uint8), 1))
        for one in found
    }


def truth(bag: Path) -> dict[int, dict[str, ObjectState]]:
    with BagReader(bag) as reader:
        ticks = [decode_tick(message.data) for message in reader.messages([TICK])]
    return {tick.stamp_ns: {s.object_id: s for s in tick.objects} for tick in ticks}


def others(bag: Path) -> list[tuple[str, int, int, bytes]]:
    with BagReader(bag) as reader:
        return [
            (m.topic, m.log_time_ns, m.publish_time_ns, m.data)
            for m in reader.messages()
            if m.topic not in (IMAGE, RENDERER)
        ]


def test_a_recording_is_drawn_anew_and_nothing_else_changes(recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "drawn"
    with Counterpart(Behaviour()) as server:
        command = drawing(recorded, server, out)
        first, again = ssp((*command, "--json"), command)
        assert first[0] == 0, first[1]
        assert (again[0], "is there already" in again[1]) == (0, True)
        left_as_found(server)
    assert not list(tmp_path.glob("*.drawing"))
    assert others(out) == others(recorded / "bag")
    states = truth(recorded / "bag")
    found = pictures(out)
    assert list(found) == list(pictures_of(recorded / "bag"))
    for stamp_ns, told in found.items():
        places = sorted((x, -y) for x, y, _ in told.poses.values())
        wanted = []
        for name, state in states[stamp_ns].items():
            if name != "vut":
                ahead = {"ot1": 1.35, "ot2": 2.5 + 0.25, "passer": 0.0}[name]
                wanted.append(state.pose.to_parent(ahead, 0.0))
        assert np.array(places) == pytest.approx(np.array(sorted(wanted)), abs=0.002), stamp_ns
    told = json.loads(first[1].splitlines()[-1])
    with BagReader(recorded / "bag") as before, BagReader(out) as after:
        source, facts = read_provenance(before), read_provenance(after)
        assert check_bag(out).ok
        assert read_seal(after).sources[0].sha256 == source.bag_sha256 == told["of_sha256"]
    assert facts.redrawing is not None
    assert facts.redrawing.of_sha256 == source.bag_sha256
    assert facts.renderer == COUNTERPART
    assert f"drawn anew by CARLA from the states of {facts.redrawing.of}" in facts.origin
    # However they are ordered, these two are one recording.
    assert _shared(source, facts)
    assert _shared(facts, source)


def test_a_drawing_that_is_given_no_folder_has_the_name_of_its_recording(recorded: Path) -> None:
    assert default_out(recorded / "bag") == Path("out/draw-run")


def pictures_of(bag: Path) -> list[int]:
    with BagReader(bag) as reader:
        stamps = [read_image(COMPRESSED_TYPE, m.data).stamp_ns for m in reader.messages([IMAGE])]
    return sorted(set(stamps))


class Failing(Counterpart):
    """A server that loses a picture, or hangs, once a picture was kept."""

    def __init__(self, kept: Path, *, hangs: bool) -> None:
        super().__init__()
        self.kept, self.hangs, self.failed = kept, hangs, threading.Event()

    def _send_picture(self, camera: Actor) -> None:
        if not self.failed.is_set() and any(self.kept.glob("*.jpg")):
            if self.hangs:
                self.behaviour.stall_at = 1
            else:
                self.behaviour.lost = frozenset({self.pictures + 1})
            self.failed.set()
        super()._send_picture(camera)


def test_a_drawing_that_was_ended_goes_on(recorded: Path, tmp_path: Path) -> None:
    """A picture is lost; another server draws the rest, and each picture is drawn once."""
    out = tmp_path / "drawn"
    with Failing(tmp_path / "drawn.drawing", hangs=False) as server:
        (told,) = ssp(drawing(recorded, server, out))
        refused(told, "the picture of frame", "of 5 are kept, and the same command goes on")
        left_as_found(server)
    kept = {p.name: p.read_bytes() for p in (tmp_path / "drawn.drawing").glob("*.jpg")}
    assert 0 < len(kept) < 5
    assert not out.exists()
    with Counterpart(Behaviour(version="0.9.16", map_name="Carla/Maps/Town02")) as server:
        refused(ssp(drawing(recorded, server, out))[0], "isn't this one: map_name")
    with Counterpart(seed=3) as server:
        (done,) = ssp(drawing(recorded, server, out))
        assert done[0] == 0, done[1]
        left_as_found(server)
    with BagReader(out) as reader:
        drawn = {
            f"{one.stamp_ns:020d}.jpg": bytes(one.data)
            for one in (read_image(COMPRESSED_TYPE, m.data) for m in reader.messages([IMAGE]))
        }
    assert len(drawn) == 5
    assert {name: drawn[name] for name in kept} == kept
    assert not (tmp_path / "drawn.drawing").exists()


def test_a_drawing_that_was_killed_goes_on_where_it_was(recorded: Path, tmp_path: Path) -> None:
    """The server is left synchronous and with bodies; the next client of this machine clears up."""
    out = tmp_path / "drawn"
    with Failing(tmp_path / "drawn.drawing", hangs=True) as server:
        arguments = [str(one) for one in drawing(recorded, server, out)]
        client = subprocess.Popen([sys.executable, "-m", "ssp_core.cli", *arguments])
        assert server.failed.wait(PATIENCE_S)
        client.kill()
        client.wait()
        server.behaviour.stall_at = 0
        assert server.settings != server.left_settings
        assert len(server.actors) > 2
        assert list((tmp_path / "drawn.drawing").glob("*.jpg"))
        asked, done = ssp(("doctor", "--carla", server.address), drawing(recorded, server, out))
        refused(asked, "is synchronous and no client ticks it")
        assert done[0] == 0, done[1]
        left_as_found(server)
        assert server.weather == [-1.0] * 13 + [0.0]
    assert list(pictures(out)) == pictures_of(recorded / "bag")


FAILURES: tuple[tuple[Behaviour, str], ...] = (
    (Behaviour(version="0.9.15"), "the server is CARLA 0.9.15, the client 0.9.16"),
    (Behaviour(foreign=("walker.pedestrian.0001",)), "1 actors of somebody else"),
    (Behaviour(synchronous=True), "no client ticks it: a client died"),
    (Behaviour(xodr=EMPTY_XODR.replace("lat_0=0", "lat_0=1")), "compile it for this one"),
    (
        Behaviour(refused=frozenset(b.blueprint for b in BODIES if b.kind == "truck")),
        "has no body for a truck: vehicle.carlamotors.carlacola (not spawned)",
    ),
    (
        Behaviour(bodies={b.blueprint: replace(b, extent=(1.0, 0.0, 0.8)) for b in BODIES}),
        "its box is empty: 2.00 × 0.00 × 1.60 m",
    ),
    (Behaviour(vanish_at=("ot1", 10)), "refuses a command for ot1: unable to find actor"),
    (Behaviour(exit_at=10), "CARLA server"),
)


def test_each_failure_ends_the_drawing_with_its_reason_and_restores(
    recorded: Path, tmp_path: Path
) -> None:
    with ExitStack() as servers:
        found = [servers.enter_context(Counterpart(b, seed=k)) for k, (b, _) in enumerate(FAILURES)]
        commands = [drawing(recorded, s, tmp_path / f"out_{k}") for k, s in enumerate(found)]
        told = ssp(*commands)
        for server, said, (behaviour, words) in zip(found, told, FAILURES, strict=True):
            refused(said, words)
            assert "Traceback" not in said[1]
            if not behaviour.exit_at:
                left_as_found(server)
    assert not list(tmp_path.glob("out_?"))


def test_what_cannot_be_drawn_is_refused(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "drawn"
    given = ["--camera", "carla://localhost:2000", "--out", str(out)]
    other = tmp_path / "none.xodr"
    for arguments, words in (
        ([str(recorded), *given], "no CARLA server has that map"),
        ([str(recorded), "--camera", "raster"], "names no CARLA server"),
        ([str(recorded), *given, "--map", str(other)], "can't be read"),
        ([str(tmp_path), *given], "is neither a bag nor a folder with one"),
    ):
        assert main(["draw", *arguments]) == 1
        assert words in " ".join(capsys.readouterr().err.split()), arguments
    assert list(tmp_path.iterdir()) == []
