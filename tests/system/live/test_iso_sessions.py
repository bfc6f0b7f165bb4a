"""Live sessions whose object speaks ISO 22133: our gateway leads one of ours, over real sockets."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from ssp_core import names
from ssp_core.bag.reading.reader import BagReader
from tests.system.live.hosts import (
    OBJECTS,
    Cut,
    Network,
    on,
    stands_after_the_link_is_back,
    stops_inside_the_bound,
)
from tests.system.live.scored import everybody_declares_simulated, is_admitted_and_scored
from tests.system.recordings import Recordings

PORT = 19_000
pytestmark = [pytest.mark.ros, pytest.mark.system]


def local_port() -> int:
    return PORT + 2 * (os.getpid() % 1000)


def body_at(host: str, port: int) -> tuple[str, ...]:
    """Return the options of an object whose firmware was never probed."""
    return ("--body", f"ot1=iso22133://{host}:{port}?waive=A. Tester")


def play_object(stage: Any, host: Sequence[str], *options: str) -> subprocess.Popen[Any]:
    """``ssp iso object`` of the session's run, once it listens."""
    command = [sys.executable, "-m", "ssp_core.cli", "iso", "object", "--log", str(stage.log)]
    run_file = str(stage.folder / "run" / "run.yaml")
    process: subprocess.Popen[Any] = stage.start(
        "object", [*command, "--run", run_file, *options], host
    )
    stage.wait_for(lambda: "listens at" in stage.said("object"), "the object to listen")
    return process


def ends_validly(stage: Any, run: subprocess.Popen[Any]) -> Path:
    """The folder of a session that is begun, when it is over; raw frames are in its bag."""
    stage.begin(run)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("valid", 0), result["reasons"]
    assert "waive=A. Tester" in result["bodies"]["ot1"]
    folder = Path(stage.folder / "run")
    with BagReader(folder / "bag") as bag:
        frames = bag.topics[names.absolute(names.iso_frames_topic("ot1"))]
    assert frames.count > 50
    return folder


def test_a_rehearsed_session_with_an_iso_object_is_admitted_and_scored(
    stage: Any, task: Callable[..., Path], recordings: Recordings, tmp_path: Path
) -> None:
    """All parts are rehearsed on one host; a cut link between two hosts follows below."""
    port = local_port()
    compiled = task(str(recordings.k_star("vru_crossing")), datum=True)
    run = stage.run_live(compiled, *body_at("127.0.0.1", port))
    parts = ("--play", "vut", "--play", "camera", "--play", "iso")
    stage.play("rehearsal", *parts, "--first-port", str(port), "--log", str(stage.log))
    stage.ask_doctor()
    physical = ends_validly(stage, run)
    assert stage.rows()[-1].speed_mps == 0.0
    stage.close()
    everybody_declares_simulated(physical)
    is_admitted_and_scored(recordings, "vru_crossing", physical, tmp_path)


def test_the_link_to_an_iso_object_is_cut_while_it_drives(
    network: Network, two_hosts: Any, task: Callable[..., Path]
) -> None:
    """The hosts speak only ISO 22133 with each other.

    The object stops by itself, and stays where it stands when its control centre is back.
    """
    stage = two_hosts
    compiled = task("cut_in", datum=True)
    run = stage.run_live(compiled, "--no-camera", *body_at(OBJECTS, 53241), host=on(network.a))
    played = play_object(stage, on(network.b), "--host", OBJECTS)
    stage.play("vut", "--play", "vut", host=on(network.a))
    # What the doctor says of such an object, and over two hosts: above, and test_two_hosts.
    stage.begin(run)
    stage.wait_for_motion(run, 5.0)
    cut = Cut(stage, network, played)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    reasons = " ".join(result["reasons"])
    assert "ot1" in reasons, reasons
    stops_inside_the_bound(stage, cut)
    assert "heartbeat_lost" in stage.said("object")
    stands_after_the_link_is_back(stage, network)


# -- what is wrong before anything moves -------------------------------------------------------


def unwaived(port: int) -> tuple[str, ...]:
    return ("--body", f"ot1=iso22133://127.0.0.1:{port}")


def test_an_object_without_a_probe_report_is_not_armed_and_that_is_the_reason(
    stage: Any, task: Callable[..., Path]
) -> None:
    port = local_port()
    run = stage.run_live(task("cut_in", datum=True), "--no-camera", *unwaived(port))
    parts = ("--play", "vut", "--play", "iso")
    stage.play("rehearsal", *parts, "--first-port", str(port), "--log", str(stage.log))
    stage.said_after(run, "can't be armed: it has no probe report")  # at the prompt
    stage.begin(run)
    result = stage.finish(run)
    assert result["status"] == 1
    assert result["reasons"][0].startswith("ot1: it has no probe report"), result["reasons"]
    assert "object_contradicts" not in stage.said("ssp_run")
    assert "session ARM" not in stage.said("ssp_run"), "something was told to arm"
    assert {row.speed_mps for row in stage.rows()} <= {0.0}


def test_an_address_where_is_unreachable_is_named_while_the_session_waits(
    stage: Any, task: Callable[..., Path]
) -> None:
    port = local_port()
    run = stage.run_live(task("cut_in", datum=True), "--no-camera", *unwaived(port))
    stage.play("vut", "--play", "vut")
    why = f"its test object isn't connected: 127.0.0.1:{port}: Connection refused"
    stage.said_after(run, why)  # above the prompt, before anybody types the word
    assert "session CONN" not in stage.said("ssp_run")
    stage.begin(run)
    stage.said_after(run, f"no state of ot1 arrives: {why}")


def test_without_a_datum_a_session_with_an_iso_object_does_not_begin(
    stage: Any, task: Callable[..., Path]
) -> None:
    arguments = ("--mode", "live", "--out", str(stage.folder / "run"), *unwaived(local_port()))
    command = [sys.executable, "-m", "ssp_core.cli", "run", str(task("cut_in")), *arguments]
    done = stage.start("ssp_run", command)
    assert done.wait(600.0) == 1
    assert "datum: is missing: where the site lies is unknown" in stage.said("ssp_run")
    assert not (stage.folder / "run" / "bag").exists()


def test_a_process_that_dies_before_anything_is_armed_is_the_reason(
    stage: Any, task: Callable[..., Path]
) -> None:
    """Its probe report can't be read, which the node of the objects finds when it starts."""
    port = local_port()
    missing = str(stage.folder / "none.json")
    body = ("--body", f"ot1=iso22133://127.0.0.1:{port}?report={missing}")
    compiled = str(task("cut_in", datum=True))
    arguments = ("--mode", "live", "--no-camera", "--odometry", "/ins/odometry", *body)
    folder = ("--out", str(stage.folder / "run"))
    command = [sys.executable, "-m", "ssp_core.cli", "run", compiled, *arguments, *folder]
    run = stage.start("ssp_run", command)
    result = stage.finish(run)
    assert result["verdict"] == "invalid_harness"
    assert "none.json" in " ".join(result["reasons"])
