"""A server that is probed and asked: CARLA's own client in a process, and its counterpart here."""

from __future__ import annotations

import json
import socket
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.carla.probe_report import load_report
from ssp_core.cli import main
from tests.support.carla.catalogue import BODIES, Body
from tests.support.carla.commands import client, left_as_found, refused, ssp
from tests.support.carla.counterpart import EMPTY_XODR, Behaviour, Counterpart

pytestmark = pytest.mark.carla


def test_a_sound_server_passes_and_is_left_as_it_was(tmp_path: Path) -> None:
    report_file = tmp_path / "carla_probe.json"
    with Counterpart() as server:
        ((status, text),) = ssp(("carla", "probe", server.address, "--out", report_file, "--json"))
        assert status == 0, text
        left_as_found(server)
        assert server.weather == [-1.0] * 13 + [0.0]
    report = load_report(report_file)
    assert json.loads(text.splitlines()[-1]) == json.loads(report_file.read_text())
    rows = {row.check: row for row in report.rows}
    assert {row.outcome.value for row in report.rows} == {"pass", "info"}
    assert rows["frames"].measured == 0.0
    assert rows["box_in_picture"].measured is not None
    assert rows["box_in_picture"].measured < 1.0
    measured = {one.blueprint: one for one in report.bodies}
    bus = measured["vehicle.mitsubishi.fusorosa"]
    assert (bus.length_m, bus.forward_m, bus.right_m) == pytest.approx((10.28, -0.45, 0.12))
    assert bus.rests_at_m == pytest.approx(0.0, abs=1e-6)
    assert report.camera["motion_blur_intensity"] == "0.0"


def test_an_empty_box_is_told_and_not_taken(tmp_path: Path) -> None:
    flat = {b.blueprint: replace(b, extent=(0.9, 0.0, 0.8)) for b in BODIES if b.kind == "bicycle"}
    report_file = tmp_path / "probe.json"
    refused_bus = frozenset({"vehicle.mitsubishi.fusorosa"})
    with Counterpart(Behaviour(bodies=flat, refused=refused_bus)) as server:
        (done,) = ssp(("carla", "probe", server.address, "--out", report_file))
        refused(done, "bodies.cyclist")
        left_as_found(server)
    report = load_report(report_file)
    failed = {row.check: row.text for row in report.rows if row.outcome.value == "fail"}
    assert failed.keys() == {"bodies.cyclist", "bodies.bus"}
    assert (
        "vehicle.bh.crossbike: its box is empty: 1.80 × 0.00 × 1.60 m" in failed["bodies.cyclist"]
    )
    assert "fusorosa: the server doesn't spawn it" in failed["bodies.bus"]


def test_a_picture_beside_the_states_is_measured(tmp_path: Path) -> None:
    report_file = tmp_path / "probe.json"
    with Counterpart(Behaviour(moved_by=0.5)) as server:
        ssp(("carla", "probe", server.address, "--out", report_file))
    (row,) = (r for r in load_report(report_file).rows if r.check == "box_in_picture")
    assert row.measured is not None
    assert row.measured > 10.0


FAULTS: tuple[tuple[Behaviour, tuple[str, ...]], ...] = (
    (Behaviour(version="0.9.15"), ("CARLA 0.9.15, the client 0.9.16", "start a server")),
    (
        Behaviour(foreign=("vehicle.tesla.model3", "walker.pedestrian.0001")),
        ("2 actors of somebody else", "1 × vehicle.tesla.model3"),
    ),
    (
        Behaviour(synchronous=True),
        ("is synchronous and no client ticks it", "restart the server"),
    ),
    (Behaviour(version=""), ("the server is CARLA , the client 0.9.16",)),
)


def test_a_server_that_no_run_is_for_is_refused_before_anything_is_changed(tmp_path: Path) -> None:
    report_file = tmp_path / "probe.json"
    with ExitStack() as servers:
        found = [servers.enter_context(Counterpart(b, seed=k)) for k, (b, _) in enumerate(FAULTS)]
        commands: list[tuple[object, ...]] = []
        for server in found:
            commands.append(("carla", "probe", server.address, "--out", report_file))
            commands.append(("doctor", "--carla", server.address))
        told = ssp(*commands)
        for index, (_, words) in enumerate(FAULTS):
            probed, asked = told[2 * index : 2 * index + 2]
            refused(probed, *words)
            refused(asked, "fail carla 127.0.0.1:", *words)
            assert len(asked[1].splitlines()) == 1
        for server in found:
            left_as_found(server)
            assert "set_episode_settings" not in server.calls
    assert not report_file.exists()


def test_the_map_is_held_against_a_file(tmp_path: Path) -> None:
    same, other = tmp_path / "same.xodr", tmp_path / "other.xodr"
    same.write_bytes(b"\xef\xbb\xbf" + EMPTY_XODR.replace("\n", "\r\n").encode())
    other.write_text(EMPTY_XODR.replace("lat_0=0", "lat_0=1"))
    with Counterpart() as server:
        asked = ("doctor", "--carla", server.address, "--map")
        probed = ("carla", "probe", server.address, "--out", tmp_path / "p", "--map")
        accepted, *refusals = ssp(
            (*asked, same), (*asked, other), (*probed, other), (*asked, tmp_path / "none.xodr")
        )
    assert accepted[0] == 0, accepted[1]
    assert "a run would be accepted: CARLA 0.9.16, Carla/Maps/Town01, sha256:" in accepted[1]
    for told in refusals[:2]:
        refused(told, "Carla/Maps/Town01 has OpenDRIVE sha256:", "compile it for this one")
    refused(refusals[2], "none.xodr: can't be read: No such file")


_GENERATE = """
import carla, os, sys
client = carla.Client("127.0.0.1", int(sys.argv[1]))
client.set_timeout(60.0)
built = carla.OpendriveGenerationParameters()
world = client.generate_opendrive_world(open(sys.argv[2]).read(), built)
print(world.get_map().name, flush=True)
os._exit(0)  # CARLA's client may abort while it closes its sockets
"""


def test_a_world_that_carla_makes_of_our_exported_map_is_accepted_for_it(tmp_path: Path) -> None:
    """`docs/carla.md`, *A site in CARLA*: what CARLA's config.py -x does, by the real client."""
    exported, chart = tmp_path / "exported", tmp_path / "exported" / "boulevard.xodr"
    compiling = ("compile", "vru_crossing", "--site", "boulevard", "--target", "carla")
    assert main([*compiling, "--out", str(exported)]) == 0
    with Counterpart() as server:
        asked = ("doctor", "--carla", server.address, "--map", chart)
        refused(ssp(asked)[0], "has OpenDRIVE")
        made = client("-c", _GENERATE, str(server.port), str(chart), starts=3)
        assert made.endswith("OpenDriveMap\n")
        ((status, text),) = ssp(asked)
        assert (status, "a run would be accepted" in text) == (0, True), text


def test_no_server() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # and doesn't listen
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        for told in ssp(("carla", "probe", address), ("doctor", "--carla", address)):
            refused(told, f"no CARLA server at {address}: Connection refused; start one")


FAILURES: tuple[tuple[Behaviour, str], ...] = (
    (Behaviour(exit_at=60), "CARLA server"),
    (
        Behaviour(vanish_at=("ssp_probe", 300)),
        "refuses a command for ssp_probe: unable to find actor",
    ),
    (Behaviour(batch_error_at=300), "refuses a command for ssp_dropped: the actor is busy"),
    (Behaviour(lost=frozenset({30})), "the picture of frame"),
)


def test_a_failure_ends_the_probe_with_its_reason_and_restores(tmp_path: Path) -> None:
    with ExitStack() as servers:
        found = [servers.enter_context(Counterpart(b, seed=k)) for k, (b, _) in enumerate(FAILURES)]
        told = ssp(*(("carla", "probe", one.address, "--out", tmp_path / "p") for one in found))
        for one, said, (behaviour, words) in zip(found, told, FAILURES, strict=True):
            refused(said, words)
            if not behaviour.exit_at:
                left_as_found(one)
    assert list(tmp_path.iterdir()) == []


def test_the_picture_of_a_tick_is_the_picture_of_that_tick() -> None:
    """Pictures are lost, late by one or more, and out of order; none may pass for another's."""
    late = {k: 1 + k % 3 for k in range(25, 400, 23)}
    lost = frozenset(range(30, 400, 41)) - frozenset(late)
    with Counterpart(Behaviour(late=late, lost=lost), seed=5) as server:
        said = client("-m", "tests.support.carla.driver", server.address, "400")
        left_as_found(server)
        pictures = server.pictures
    told: dict[str, Any] = json.loads(said.splitlines()[-1])
    assert told["wrong"] == []
    missing = sum(1 for k in (*late, *lost) if k <= pictures)
    # The first pictures, until the camera's stream is connected, are none of the 400; what a busy
    # machine keeps too long is taken for lost.
    assert 360 - missing <= told["came"] <= 400 - missing + 2


def test_the_counterpart_is_strict() -> None:
    """A call that the real client never makes fails the test that makes it."""
    script = """
import carla, contextlib, sys
client = carla.Client("127.0.0.1", int(sys.argv[1]))
client.set_timeout(60.0)
with contextlib.suppress(RuntimeError):
    client.start_recorder("x")
"""
    server = Counterpart()
    with pytest.raises(AssertionError, match="start_recorder"), server:
        client("-c", script, str(server.port))


def test_bodies_differ_in_every_number() -> None:
    """So that no mistake of one axis is hidden by another."""
    body: Body
    for body in BODIES:
        if body.kind == "bus":
            assert 0.0 not in (*body.offset, *body.extent)
