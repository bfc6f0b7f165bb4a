"""Manager and VUT on one host, the object on another, and the link between them cut mid-run."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.system.live.hosts import (
    OBJECTS,
    Cut,
    Network,
    on,
    stands_after_the_link_is_back,
    stops_inside_the_bound,
)

pytestmark = [pytest.mark.ros, pytest.mark.system]

BODY_PORT = "9001"


def test_the_link_is_cut_while_an_object_drives(
    network: Network, two_hosts: Any, task: Callable[[str], Path]
) -> None:
    stage = two_hosts
    run = stage.run_live(task("cut_in"), "--no-camera", host=on(network.a))
    played = start_object(stage, network)
    stage.play("vut", "--play", "vut", host=on(network.a))
    stage.ask_doctor(host=on(network.a))
    stage.begin(run)
    stage.wait_for_motion(run, 5.0)
    cut = Cut(stage, network, *played)
    result = stage.finish(run)
    assert (result["verdict"], result["status"]) == ("aborted", 1), result["reasons"]
    reasons = " ".join(result["reasons"])
    silence = ("object_silent", "reply_missing", "state_stale")
    assert any(name in reasons for name in silence), reasons
    stops_inside_the_bound(stage, cut)
    stands_after_the_link_is_back(stage, network)


def start_object(stage: Any, network: Network) -> tuple[subprocess.Popen[Any], ...]:
    """The processes of an object on its host: its body, and the node that leads it."""
    run_file = stage.folder / "run" / "run.yaml"
    parts = ("--play", "bodies", "--host", OBJECTS, "--first-port", BODY_PORT)
    bodies = stage.play("bodies", *parts, "--log", str(stage.log), host=on(network.b))
    command = [sys.executable, "-m", "ssp_ot_controller.ros.object_target", "--ros-args"]
    command += ["-r", "__node:=object_target", "-p", f"run_file:={run_file}"]
    command += ["-p", f"bodies:=ot1=udp://{OBJECTS}:{BODY_PORT}"]
    return bodies, stage.start("object_target", command, on(network.b))
